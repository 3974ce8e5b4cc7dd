"""First-order effect of an angular-rate error on the windows and links of a field chain.

An error ω of the rate rotates the integrated world by φ = −∫ R ω dt. The link between two windows becomes g' =
Exp(Δφ̄) g, with φ̄ the mean over a window; because the sensor turns inside a window, its mean field gains A mean_j
Rⱼᵀ [g]× (φⱼ − φ̄).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.gyroscope_track import GyroscopeTrack
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rotations import Array, cross

_AT_ONCE = 50_000  # numbers per axis processed at once, so that they stay in the processor's cache


class RateColumns(NamedTuple):
    """Unwhitened derivatives per unit of the error: of the windows (k, 3, n) T, of the links (k, 3, n − 1) rad."""

    window: Array
    link: Array


@dataclass(frozen=True, eq=False)
class RateDerivatives:
    """The integrated gyroscope, prepared for derivatives with respect to an error of its rate.

    Attributes:
        samples: samples of both sensors.
        turn: (3, 3, G) sensor → integrated world at the gyroscope's samples.
        before, share: (M,) gyroscope sample before each magnetometer sample, and the share of the step to the next
            one.
        window_of, count: (M,) window of each magnetometer sample, (n,) samples of each window.
        back: (3, 3, M) integrated world → sensor at the gyroscope sample next to each magnetometer sample.
    """

    samples: Preintegration
    turn: Array
    before: np.ndarray
    share: Array
    window_of: np.ndarray
    count: np.ndarray
    back: Array

    @classmethod
    def of(cls, samples: Preintegration, rate: Array, delay: float) -> RateDerivatives:
        """Integrate the true rate (3, G) in rad/s, with the magnetometer taken `delay` s earlier."""
        time, when = samples.gyroscope_time, samples.magnetometer_time - delay
        track = GyroscopeTrack.integrate(time, rate.T, interval_mean=samples.interval_mean)
        turn = track.matrices.reshape(3, 3, -1)
        next_ = np.searchsorted(time, when)
        before = np.clip(next_ - 1, 0, len(time) - 2)
        share = np.clip((when - time[before]) / samples.step[before], 0.0, 1.0)
        nearest = np.clip(next_, 0, len(time) - 1)
        count = np.diff(np.append(samples.starts, len(when)))
        back = np.ascontiguousarray(np.swapaxes(turn, 0, 1).take(nearest, axis=-1))
        return cls(samples, turn, before, share, np.repeat(np.arange(len(count)), count), count, back)

    def columns(self, windows: FieldWindows, soft_iron: Array, direction: Array, error: Array) -> RateColumns:
        """Return the derivatives of a chain's residuals with respect to the values of rate errors.

        Args:
            windows: the integrated windows of the samples.
            soft_iron: (3, 3) times the field strength, T.
            direction: (3, n) of the field in the integrated world.
            error: (k, 3, G) rad/s per unit, at the gyroscope's samples.
        """
        window, link = np.empty((len(error), 3, len(windows))), np.empty((len(error), 3, len(windows) - 1))
        if compiled.loops:
            self._compiled(direction, error, window, link)
            return RateColumns(np.einsum("ij,pjn->pin", soft_iron, window), link)
        at_once = max(_AT_ONCE // self.turn.shape[-1], 1)
        for first in range(0, len(error), at_once):
            part = slice(first, first + at_once)
            self._onto(direction, error[part], window[part], link[part])
        return RateColumns(np.einsum("ij,pjn->pin", soft_iron, window), link)

    def _compiled(self, direction: Array, error: Array, window: Array, link: Array) -> None:
        samples = self.samples
        inputs = (
            self.turn,
            samples.step,
            np.array([0.0, 1.0] if samples.interval_mean else [0.5, 0.5]),
            self.before,
            samples.starts,
            self.share,
            self.back,
            direction,
            error,
        )
        compiled.loops.rate_errors(len(self.count), *map(compiled.given, inputs), window, link)

    def _onto(self, direction: Array, error: Array, window: Array, link: Array) -> None:
        """Write the effect of errors on the windows (in units of the soft iron) and on the links into `window` and
        `link`.
        """
        samples, starts = self.samples, self.samples.starts
        turned = turned_by(self.turn, error)
        angle = np.zeros_like(turned)
        steps = turned[..., 1:] if samples.interval_mean else 0.5 * (turned[..., 1:] + turned[..., :-1])
        steps *= -samples.step
        np.cumsum(steps, axis=-1, out=angle[..., 1:])
        inside = angle.take(self.before, axis=-1)
        ahead = angle.take(self.before + 1, axis=-1)
        ahead -= inside
        ahead *= self.share
        inside += ahead
        mean = np.add.reduceat(inside, starts, axis=-1) / self.count
        link[:] = cross(np.diff(mean).swapaxes(0, 1), direction[:, None, :-1]).swapaxes(0, 1)
        inside -= mean.take(self.window_of, axis=-1)
        window[:] = np.add.reduceat(turned_by(self.back, self._swing(direction, inside)), starts, axis=-1)
        window /= self.count

    def _swing(self, direction: Array, inside: Array) -> Array:
        """Return g × φ (k, 3, M) for a direction (3, n) per window and angles (k, 3, M)."""
        x, y, z = direction.take(self.window_of, axis=-1)
        result = np.empty_like(inside)
        result[:, 0] = y * inside[:, 2] - z * inside[:, 1]
        result[:, 1] = z * inside[:, 0] - x * inside[:, 2]
        result[:, 2] = x * inside[:, 1] - y * inside[:, 0]
        return result


def turned_by(rotation: Array, columns: Array) -> Array:
    """Return columns (p, 3, n) rotated by (3, 3, n)."""
    result: Array = np.einsum("pjn,jin->pin", columns, np.swapaxes(rotation, 0, 1))
    return result
