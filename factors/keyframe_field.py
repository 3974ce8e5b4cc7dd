"""All magnetometer samples around one keyframe, rotated to it by the gyroscope and compressed.

R is the keyframe's attitude (body→world). The gyroscope propagates it to every sample's time by ΔR_s(b), so that

    m_s = A p_s + h,    p_s = ᵇRₛᵀ ΔR_s(b, τ)ᵀ v,    v = Rᵀ f the field in the body frame at the keyframe,

and with δ = b − b₀ and the delay τ − τ₀ to first order ΔR_s = Exp(K_s δ) ΔR_s(b₀) Exp(−ω_s (τ − τ₀)),
K_s = −∫ ΔR dt, as GTSAM preintegrates. Then

    p_s = G_s y,    y = (v, δ₁v, δ₂v, δ₃v, (τ − τ₀) v),    G_s (3, 15),

and each axis i of the residual B G_s y + h − m_s is linear in the 49 numbers (B_i ⊗ y, h_i, 1) with the coefficients
(vec G_s, 1, m_s,i), for any 3 × 3 matrix B: the soft iron A, or A rotated by a mounting that is a variable. Hence
Σ‖r_s‖² is unchanged when the rows (vec G_s, 1, m_s) of all samples are replaced by the triangular factor of their QR
decomposition: at most 49 rows, 40 where the delay is held, which have the form of samples.

The gyroscope's noise inside a block is not a variable; it widens the block's standard deviation.
Keep blocks short (a second or so) and the keyframe near their middle.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from magyc_gtsam.factors.chain.gyroscope_track import GyroscopeTrack
from magyc_gtsam.factors.chain.preintegration import interruptions
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import check_delay, measured
from magyc_gtsam.factors.numbers import is_finite
from magyc_gtsam.factors.one_thread import one_thread
from magyc_gtsam.factors.pose import sensor_rotation
from magyc_gtsam.factors.units import check_rates, check_readings, check_steps
from magyc_gtsam.factors.variables import Array

_DELAY = 12  # first column of y that depends on the delay
_IDENTITY = np.eye(3)
_REST = {axes: np.eye(axes)[1:, :, None] for axes in (4, 5)}  # unit vectors of y's weights but the first, 1


@dataclass(frozen=True, eq=False)
class KeyframeField:
    """The magnetometer samples around one keyframe.

    Attributes:
        design: (k, 3, 12) G of k samples or of their compressed rows; (k, 3, 15) with the delay in y.
        share: (k,) coefficient of the hard iron: 1 for a sample.
        field: (k, 3) T, measured.
        bias: (3,) rad/s in the body frame, b₀, at which the gyroscope was integrated.
        samples: number of magnetometer samples.
        spread: s²; σ_g² times it is the variance of the samples' mean rotation about the keyframe.
        body_R_sensor: (3, 3) ᵇRₛ, the mounting contained in G.
        delay: s, τ₀, by which the stamps were moved.
        time: s, mean stamp of the samples after the delay is subtracted.
        angular_rate: (k, 3) rad/s of the samples in the sensor's frame, less b₀; None for compressed rows.
        span: s, first and last stamp of the samples after the delay is subtracted.
    """

    design: Array
    share: Array
    field: Array
    bias: Array
    samples: int
    spread: float
    body_R_sensor: Array = dataclasses.field(default_factory=lambda: np.eye(3))
    delay: float = 0.0
    time: float = 0.0
    angular_rate: Array | None = None
    span: tuple[float, float] = (0.0, 0.0)

    @classmethod
    @one_thread
    def from_samples(
        cls,
        magnetometer: tuple[ArrayLike, ArrayLike],
        gyroscope: tuple[ArrayLike, ArrayLike],
        keyframe: float,
        *,
        bias: ArrayLike = (0.0, 0.0, 0.0),
        body_R_sensor: gtsam.Rot3 | None = None,
        delay: float = 0.0,
        interval_mean: bool = False,
    ) -> KeyframeField:
        """Integrate the gyroscope from the keyframe to every magnetometer sample.

        Samples beyond a pause of the gyroscope, as seen from the keyframe, are left out: a step of more than 0.5 s and
        of ten median steps.

        Args:
            magnetometer: time (n,) s and field (n, 3) T in the sensor's frame.
            gyroscope: time (g,) s, strictly ascending, across all those times and the keyframe's; angular
                rate (g, 3) rad/s in the body frame, values AT their stamps.
            keyframe: s, the time of the attitude, best in the samples' middle.
            bias: (3,) rad/s in the body frame, linearisation point, best the graph's own estimate.
            body_R_sensor: magnetometer→body.
            delay: s by which the magnetometer lags the gyroscope; the stamps are moved by it.
            interval_mean: the rates are means since the previous stamp instead.

        Raises:
            MagycError: wrong shapes or units (stamps too), values that are not finite, a gyroscope that does
                not cover the block or pauses at the keyframe.
        """
        check_delay("keyframe field", delay)
        when = measured("magnetometer time", magnetometer[0], (None,)) - delay
        field = measured("magnetic field", magnetometer[1], (len(when), 3))
        time = measured("gyroscope time", gyroscope[0], (None,))
        rate = measured("angular rate", gyroscope[1], (len(time), 3))
        if isinstance(bias, gtsam.imuBias.ConstantBias):
            raise MagycError("keyframe field: `bias` is a ConstantBias; give its gyroscope part, bias.gyroscope()")
        b = measured("bias", bias, (3,))
        check_readings("keyframe field", field)
        check_rates("keyframe field", rate)
        check_rates("keyframe field: bias", b)
        if not is_finite(keyframe):
            raise MagycError(
                f"keyframe field: the keyframe at {keyframe!r:.40}; its time must be a finite number of s"
            )
        if not len(when):
            raise MagycError("keyframe field: no magnetometer sample; close a block after the first one")
        start, end = min(keyframe, when.min()), max(keyframe, when.max())
        if len(time) < 2 or (np.diff(time) <= 0).any() or not time[0] <= start <= end <= time[-1]:
            covered = f"{time[0]:.3f} to {time[-1]:.3f} s" if len(time) else "nothing"
            raise MagycError(
                f"keyframe field from {start:.3f} to {end:.3f} s needs ascending gyroscope samples across it, "
                f"got {covered}; add the gyroscope's samples up to the one after the keyframe first"
            )
        check_steps("keyframe field", time)
        near = _without_pause(keyframe, when, time)
        when, field = when[near], field[near]
        turn, lever, spin, spread = _about(keyframe, when, time, rate, b, interval_mean)
        mounting = sensor_rotation(body_R_sensor)
        design = np.empty((3, 4, 3, len(when)))  # samples last, so that each operation runs along them
        design[:, 0] = (mounting.T @ turn.swapaxes(0, 1).reshape(3, -1)).reshape(3, 3, -1)
        # p = ᵇRₛᵀ ΔRᵀ (v − [K δ]× v), its part in δ_k being −ᵇRₛᵀ ΔRᵀ [K e_k]× v.
        _cross(lever.swapaxes(0, 1)[None], design[:, None, 0], out=design[:, 1:])
        return cls(
            design.reshape(3, _DELAY, -1).transpose(2, 0, 1), np.ones(len(when)), field, b, len(when), spread, mounting,
            delay, float(when.mean()), spin @ mounting, (float(when.min()), float(when.max())),
        )  # fmt: skip

    def with_delay(self) -> KeyframeField:
        """Return the same samples with the delay among the components of y."""
        if self.design.shape[2] > _DELAY:
            return self
        if self.angular_rate is None:
            raise MagycError(
                "keyframe field: rows without angular rates cannot have a delay; give the samples' own"
            )
        # d/dτ ΔR(t − τ)ᵀ = [ω]× ΔRᵀ
        slips = np.cross(self.angular_rate[:, :, None], self.design[:, :, :3], axis=1)
        return replace(self, design=np.concatenate([self.design, slips], axis=2))

    def compressed(self) -> KeyframeField:
        """Return at most 40 rows with the same sum of squares for every R, A, h, b and f; at most 49 with the delay
        in y.
        """
        design = self.design
        columns = 3 * design.shape[2]
        if len(self.share) <= columns + 4:
            return self
        rows = np.concatenate([design.transpose(1, 2, 0).reshape(columns, -1), self.share[None], self.field.T])
        root = np.triu(lapack.dgeqrf(rows.T, overwrite_a=True)[0][: len(rows)])  # errors scale with the column
        by_column = np.ascontiguousarray(root[:, :columns].reshape(-1, columns // 3).T)  # layout of `_columns`
        return replace(
            self,
            design=by_column.T.reshape(-1, 3, columns // 3),
            share=root[:, columns],
            field=root[:, columns + 1 :],
            angular_rate=None,
        )

    def error(
        self,
        unit: float,
        v: Array,
        iron: Array,
        h: Array,
        b: Array,
        delay: float | None = None,
        want_jacobians: bool = False,
    ) -> tuple[Array, list[Array]]:
        """Return B G y + h − m (k, 3) in units of `unit` T, and the parts from which its Jacobians are assembled.

        Args:
            unit: T.
            v: (3,) `unit`, the field in the body frame at the keyframe.
            iron: (3, 3) B, the soft iron times the rotation from the mounting in G to the present one.
            h: (3,) `unit`.
            b: (3,) rad/s.
            delay: s; None holds it at the block's own.
            want_jacobians: if False, the list is empty.

        Returns:
            The residual, and a list: G y (k, 3), of which row i of B yields component i of the residual; then the
                Jacobians on v (3, k, 3), on b (3, k, 3) and, where `delay` is given, on τ (1, k, 3), with the columns
                along the first axis.
        """
        columns, axes, k = self._columns, len(self._columns) // 3, len(self.share)
        weight = np.zeros(axes)  # y = weight ⊗ v
        weight[0], weight[1:4] = 1.0, b - self.bias
        if delay is not None:
            weight[4] = delay - self.delay
        if not want_jacobians:
            seen = (np.outer(weight, v).ravel() @ columns).reshape(k, 3)
            return seen @ iron.T + self.share[:, None] * h - self.field / unit, []
        y = np.empty((axes + 3, axes, 3))  # y, and its Jacobians on v and on all of `weight` but its first entry
        np.outer(weight, v, out=y[0])
        np.multiply(_IDENTITY[:, None], weight[:, None], out=y[1:4])
        np.multiply(_REST[axes], v, out=y[4:])
        seen = y.reshape(len(y), -1) @ columns
        on = (seen.reshape(-1, 3) @ iron.T).reshape(-1, k, 3)
        residual = on[0] + self.share[:, None] * h - self.field / unit
        return residual, [seen[0].reshape(k, 3), on[1:4], on[4:7], *([] if delay is None else [on[7:]])]

    @cached_property
    def _columns(self) -> Array:
        """The design as (12 or 15, k · 3), with the coefficients of each component of y in one row."""
        return np.ascontiguousarray(self.design.reshape(-1, self.design.shape[2]).T)


def _without_pause(keyframe: float, when: Array, time: Array) -> NDArray[np.bool_]:
    """Return which of the times `when` (n,) the gyroscope connects with the keyframe without a pause.

    Raises:
        MagycError: the keyframe lies in a pause, or none of the times is connected with it.
    """
    holes = interruptions(time)
    first, last = np.r_[time[0], time[holes + 1]], np.r_[time[holes], time[-1]]  # of each stretch without a pause
    own = int(np.searchsorted(first, keyframe, side="right")) - 1
    near = (when >= first[own]) & (when <= last[own])
    if keyframe > last[own] or not near.any():
        raise MagycError(
            f"keyframe field: the gyroscope pauses between the keyframe at {keyframe:.3f} s and the samples of the "
            "magnetometer; leave this block out"
        )
    return near


def _about(
    keyframe: float, when: Array, time: Array, rate: Array, bias: Array, interval_mean: bool
) -> tuple[Array, Array, Array, float]:
    """Integrate the gyroscope from the keyframe to the times `when`.

    Returns:
        ΔR (3, 3, n), K (3, 3, n) in s, the bias-free rate (n, 3) in rad/s, and `KeyframeField.spread`.
    """
    first = max(int(np.searchsorted(time, min(keyframe, when.min()), side="right")) - 1, 0)
    last = max(int(np.searchsorted(time, max(keyframe, when.max()))) + 1, first + 2)
    first = min(first, len(time) - 2)  # a block at a single stamp still needs one step of the gyroscope
    time, rate = time[first:last], rate[first:last]
    asked = np.append(when, keyframe)
    at = np.searchsorted(time, asked)
    stamps = time
    if (time[at] != asked).any():  # magnetometer samples between those of the gyroscope
        stamps = np.unique(np.concatenate([time, asked]))
        at = np.searchsorted(stamps, asked)
    track = GyroscopeTrack.integrate(time, rate, bias, interval_mean=interval_mean, stamps=stamps)
    here, at = int(at[-1]), at[:-1]
    back = track.matrices[:, here].reshape(3, 3).T
    turn = (back @ track.matrices[:, at].reshape(3, -1)).reshape(3, 3, -1)
    lever = (back @ (track.lever[:, at] - track.lever[:, here, None]).reshape(3, -1)).reshape(3, 3, -1)
    # The share of samples that lie beyond each step, as seen from the keyframe.
    beyond = np.cumsum(np.bincount(at, minlength=len(stamps)))[:-1] / len(when)
    beyond[here:] = 1.0 - beyond[here:]
    spread = float((time[-1] - time[0]) / (len(time) - 1) * (track.step @ (beyond * beyond)))
    return turn, lever, track.angular_rate[at] - bias, spread


def _cross(first: Array, second: Array, out: Array) -> None:
    """Write first × second, along the axis before the last, into `out`."""
    x, y, z = first[..., 0, :], first[..., 1, :], first[..., 2, :]
    u, v, w = second[..., 0, :], second[..., 1, :], second[..., 2, :]
    out[..., 0, :] = y * w - z * v
    out[..., 1, :] = z * u - x * w
    out[..., 2, :] = x * v - y * u
