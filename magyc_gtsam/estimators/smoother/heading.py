"""A known heading as a fact, which informs the yaw component of the misalignment between the chips.

A level motion does not observe that component. The heading of the sensor's x axis is known at some stamps k, from two
GNSS antennas, a gyrocompass, or the course of a vehicle without leeway. With the vertical p, the field's direction g
and the x axis a in the integrated world,

    φ = atan2(−p · (g × a), g · a − (g · p)(a · p)),   y(θ) = mean_k (φ(t_k) + declination − heading_k) ~ N(0, σ²),
    σ² = σ_heading² + σ_scatter² + σ_vertical²,

where φ is interpolated between windows, and σ_heading is the standard deviation of the constant heading error, such as
the angle between the sensor's x axis and the axis whose heading is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.fit import Fit, colour_of
from magyc_gtsam.estimators.smoother.options import KnownHeading
from magyc_gtsam.estimators.smoother.vertical import (
    UprightFact,
    near,
    upright,
    vertical_of,
    vertical_sigma,
)
from magyc_gtsam.factors.chain.rotations import Array, cross
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording

_APART = 5.0  # s, longest distance of two windows between which the heading is interpolated
_LEAST = 8  # stamps
_TILT = 1e-5  # rad, step of a derivative


class _Between(NamedTuple):
    """Stamps between windows `before` and `before` + 1 (k,), their relative position (k,), and their heading (k,)."""

    before: np.ndarray
    share: Array
    heading: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class HeadingFact(UprightFact):
    """The fact y(θ) ~ N(0, σ²).

    Attributes:
        known: sigma and declination.
        time: (k,) s, ascending.
        heading: (k,) rad, of the sensor's x axis, clockwise from true north.
    """

    known: KnownHeading
    time: Array
    heading: Array
    name = "heading"

    @property
    def sentence(self) -> str:
        """See `UprightFact`."""
        return (
            f"the heading by the field and by {self.known.channel!r} differ by {np.degrees(self.measured):.1f}° on "
            f"average ({self.contradiction:.1f} sigmas), which is not used: it must be the heading of the sensor's x "
            "axis in degrees, and a course over ground is not that of a vehicle that drifts; correct it, or give it a "
            "larger sigma"
        )

    def linearised(self, fit: Fit) -> HeadingFact:
        """See `UprightFact`."""
        found = upright(self.vertical, fit)
        if found is None:
            return self
        up, counts, turn = found
        g, ahead = fit.state.direction, fit.chain.windows.rotation[0]
        level = np.linalg.norm(cross(ahead, up), axis=0) > 0.5  # otherwise the axis is nearly vertical
        windows = fit.chain.windows
        stamps = self._between(windows.time - windows.delay, counts & level)
        if len(stamps.before) < _LEAST:
            return self
        wrapped = _azimuth(g, ahead, up)
        azimuth = np.unwrap(wrapped)
        there = (1 - stamps.share) * azimuth[stamps.before] + stamps.share * azimuth[stamps.before + 1]
        away = np.exp(1j * (there + self.known.declination - stamps.heading))
        centre = float(np.angle(away.mean()))
        apart = np.angle(away * np.exp(-1j * centre))
        kept = near(apart, np.ones(len(apart), dtype=bool)).astype(float)
        kept *= np.minimum(fit.weights.window[stamps.before], fit.weights.window[stamps.before + 1])
        kept /= kept.sum()
        measured = float(np.angle(np.exp(1j * (centre + kept @ apart))))
        scatter = float(kept @ (apart - kept @ apart) ** 2)
        weight = np.bincount(stamps.before, kept * (1 - stamps.share), g.shape[1])
        weight += np.bincount(stamps.before + 1, kept * stamps.share, g.shape[1])
        tilts = [_azimuth(g, ahead, up + _TILT * axis[:, None]) - wrapped for axis in np.eye(3)]
        lever = np.einsum("n,in,ijn->j", weight, np.angle(np.exp(1j * np.array(tilts))) / _TILT, turn)
        spread = scatter * colour_of(apart[None, kept > 0]) / np.count_nonzero(kept)
        sigma = float(np.sqrt(self.known.sigma**2 + spread + vertical_sigma(self.vertical, lever) ** 2))
        across = cross(up, g)
        slopes = weight * across / np.einsum("in,in->n", across, across)
        return self.at_minimum(fit, slopes, measured, 0.0, sigma)

    def _between(self, time: Array, counts: np.ndarray) -> _Between:
        before = np.searchsorted(time, self.time, side="right") - 1
        inside = (before >= 0) & (before < len(time) - 1)
        before, at, heading = before[inside], self.time[inside], self.heading[inside]
        length = time[before + 1] - time[before]
        kept = (length < _APART) & counts[before] & counts[before + 1]
        return _Between(before[kept], ((at - time[before]) / length)[kept], heading[kept])


def _azimuth(field: Array, ahead: Array, up: Array) -> Array:
    """Return (n,) rad, the angle clockwise from the horizontal field to `ahead`, both (3, n), about `up` (3, n)."""
    turned = np.einsum("in,in->n", up, cross(field, ahead))
    along = np.einsum("in,in->n", field, ahead) - np.einsum("in,in->n", field, up) * np.einsum(
        "in,in->n", ahead, up
    ) / np.einsum("in,in->n", up, up)
    return np.arctan2(-turned / np.sqrt(np.einsum("in,in->n", up, up)), along)


def heading_fact(recording: Recording, known: KnownHeading | None) -> tuple[HeadingFact, ...]:
    """Return the fact, not yet linearised; empty if no heading is known.

    Raises:
        MagycError: the recording does not have the channel, or has no signed vertical.
    """
    if known is None:
        return ()
    channel = recording.channels.get(known.channel)
    if channel is None or np.ndim(channel) != 1:
        names = ", ".join(sorted(recording.channels)) or "none"
        raise MagycError(
            f"heading: the recording has no channel {known.channel!r} with one value a row; its channels: {names}"
        )
    vertical = vertical_of(recording)
    if vertical is None or not vertical.signed:
        raise MagycError(
            "heading: without an accelerometer nothing says which way is up; add one to the recording, or omit the "
            "heading"
        )
    kept = np.isfinite(channel)
    heading = np.radians(np.asarray(channel, dtype=float)[kept])
    return (HeadingFact(vertical=vertical, known=known, time=recording.time[kept], heading=heading),)
