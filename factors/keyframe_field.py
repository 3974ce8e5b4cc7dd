"""All magnetometer samples around one keyframe, compressed into one small factor on (R, A, h, b[, f]).

R is the keyframe's attitude (body→world). The gyroscope turns it to every sample's time, ΔR_s(b), so that

    m_s = A p_s + h,    p_s = ᵇRₛᵀ ΔR_s(b)ᵀ v,    v = Rᵀ f the field in the body frame at the keyframe,

and with δ = b − b₀ to first order ΔR_s(b) = Exp(K_s δ) ΔR_s, K_s = −∫ ΔR dt, as GTSAM preintegrates. Then

    p_s = G_s y,    y = (v, δ₁v, δ₂v, δ₃v),    G_s (3, 12),

and each axis i of the residual A G_s y + h − m_s is linear in the 40 numbers (A_i ⊗ y, h_i, 1) with the
coefficients (vec G_s, 1, m_s,i). Hence Σ‖r_s‖² stays exactly the same when the rows (vec G_s, 1, m_s) of all
samples are replaced by the triangular factor of their QR decomposition: at most 40 rows, which look like
samples themselves.

What the gyroscope's noise adds inside a block is not a variable; it widens the block's standard deviation.
Keep blocks short (a second or so) and the keyframe near their middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import (
    Array,
    Residual,
    Variable,
    custom_factor,
    direction,
    gyro_bias,
    measured,
    standard_deviation,
    vector,
)
from magyc_gtsam.factors.pose import MICROTESLA, attitude, body_field, check_unit, sensor_rotation
from magyc_gtsam.factors.robust import robustify, tuning_constant
from magyc_gtsam.factors.rotations import Spinor, exponential, increments, matrices, multiply, skew
from magyc_gtsam.factors.soft_iron import SYMMETRIC_UNITS, unvech

COLUMNS = 40  # vec G 36, 1, m 3
_SMALLEST = 1e-12  # T; columns are scaled by at least this
_IDENTITY = np.eye(3)
_EARTH_FIELD = 50e-6  # T, only to widen a block's sigma where the field is a variable


@dataclass(frozen=True, eq=False)
class KeyframeField:
    """The magnetometer around one keyframe.

    Attributes:
        design: (k, 3, 12) G, of k samples or of the k ≤ 40 rows that stand for them.
        share: (k,) coefficient of the hard iron: 1 for a sample.
        field: (k, 3) T, measured.
        bias: (3,) rad/s, b₀, where the gyroscope was integrated.
        samples: number of magnetometer samples.
        spread: s², the variance of the samples' mean rotation about the keyframe is σ_g² times it.
    """

    design: Array
    share: Array
    field: Array
    bias: Array
    samples: int
    spread: float

    @classmethod
    def from_samples(
        cls,
        magnetometer: tuple[ArrayLike, ArrayLike],
        gyroscope: tuple[ArrayLike, ArrayLike],
        keyframe: float,
        *,
        bias: ArrayLike = (0.0, 0.0, 0.0),
        body_R_sensor: gtsam.Rot3 | None = None,
        interval_mean: bool = False,
    ) -> KeyframeField:
        """Integrate the gyroscope from the keyframe to every magnetometer sample.

        Args:
            magnetometer: time (n,) s and field (n, 3) T in the sensor's frame. Subtract a known delay from
                the stamps.
            gyroscope: time (g,) s, strictly ascending, across all those times and the keyframe's; angular
                rate (g, 3) rad/s in the body frame, values AT their stamps.
            keyframe: s, the time of the attitude, best in the samples' middle.
            bias: (3,) rad/s, where to linearise, best the graph's own estimate.
            body_R_sensor: magnetometer→body.
            interval_mean: the rates are means since the previous stamp instead.

        Raises:
            MagycError: wrong shapes, values that are not finite, or a gyroscope that does not cover the block.
        """
        when = measured("magnetometer time", magnetometer[0], (None,))
        field = measured("magnetic field", magnetometer[1], (len(when), 3))
        time = measured("gyroscope time", gyroscope[0], (None,))
        rate = measured("angular rate", gyroscope[1], (len(time), 3))
        b = measured("bias", bias, (3,))
        if not len(when):
            raise MagycError("keyframe field: no magnetometer sample; close a block after the first one")
        start, end = min(keyframe, when.min()), max(keyframe, when.max())
        if len(time) < 2 or (np.diff(time) <= 0).any() or not time[0] <= start <= end <= time[-1]:
            covered = f"{time[0]:g} to {time[-1]:g} s" if len(time) else "nothing"
            raise MagycError(
                f"keyframe field from {start:g} to {end:g} s needs ascending gyroscope samples across it, "
                f"got {covered}"
            )
        turn, lever, spread = _about(keyframe, when, time, rate, b, interval_mean)
        transposed = sensor_rotation(body_R_sensor).T @ turn.swapaxes(1, 2)
        # p = ᵇRₛᵀ ΔRᵀ (v − [K δ]× v), its part in δ_k being −ᵇRₛᵀ ΔRᵀ [K e_k]× v.
        tilts = -transposed[:, None] @ skew(lever.swapaxes(1, 2))
        design = np.concatenate([transposed, tilts.swapaxes(1, 2).reshape(-1, 3, 9)], axis=2)
        return cls(design, np.ones(len(when)), field, b, len(when), spread)

    def compressed(self) -> KeyframeField:
        """At most 40 rows with the same sum of squares for every R, A, h, b and f."""
        if len(self.share) <= COLUMNS:
            return self
        rows = np.column_stack([self.design.reshape(-1, 36), self.share, self.field])
        scale = np.maximum(np.abs(rows).max(axis=0), _SMALLEST)  # tesla beside numbers of order one
        root = np.linalg.qr(rows / scale, mode="r") * scale
        return KeyframeField(
            root[:, :36].reshape(-1, 3, 12), root[:, 36], root[:, 37:], self.bias, self.samples, self.spread
        )

    def error(
        self, unit: float, v: Array, a: Array, h: Array, b: Array, want_jacobians: bool = False
    ) -> tuple[Array, list[Array]]:
        """A G y + h − m in units of `unit` T: (k, 3), and its Jacobians on v, a (6), h and b, (k, 3, columns).

        `v` is the field in the body frame at the keyframe; v and h are in `unit`.
        """
        moved = b - self.bias
        seen = self.design @ np.concatenate([v, np.outer(moved, v).ravel()])
        soft_iron = unvech(a)
        residual = seen @ soft_iron + self.share[:, None] * h - self.field / unit
        if not want_jacobians:
            return residual, []
        on_seen = soft_iron @ self.design
        parts = on_seen.reshape(-1, 3, 4, 3)
        on_v = parts[:, :, 0] + np.einsum("kiba,b->kia", parts[:, :, 1:], moved)
        on_a = np.einsum("eij,kj->kie", SYMMETRIC_UNITS, seen)
        return residual, [on_v, on_a, self.share[:, None, None] * _IDENTITY, parts[:, :, 1:] @ v]


def keyframe_field_factor(
    attitude_key: int,
    soft_iron_key: int,
    hard_iron_key: int,
    block: KeyframeField,
    noise: float,
    *,
    gyro_bias_key: int | None = None,
    field: ArrayLike | None = None,
    field_key: int | None = None,
    gyroscope_noise: float = 0.0,
    robust: str | None = None,
    tuning: float | None = None,
    field_unit: float = MICROTESLA,
) -> gtsam.CustomFactor:
    """One factor over all samples around a keyframe, on (R, A, h[, b][, f]).

    Args:
        attitude_key: `Pose3`, `Rot3` or `Rot2`, body→world; or `Unit3`, the field's direction in the body
            frame, where `field` is a strength.
        soft_iron_key: 6-vector, vech of the soft iron.
        hard_iron_key: 3-vector or `Point3`, `field_unit`.
        block: of `KeyframeField.from_samples`.
        noise: T, standard deviation per sample and axis.
        gyro_bias_key: the graph's `imuBias.ConstantBias`, a `Point3` or 3-vector in rad/s; None keeps the
            bias at which the block was integrated.
        field: (3,) T, the world's field, or its strength, a number.
        field_key: 3-vector or `Point3` in `field_unit`, where the world's field is a variable.
        gyroscope_noise: rad/s per sample and axis, which widens `noise` by what it adds inside the block.
        robust: name of a kernel that weighs every sample by itself; the samples are then not compressed.
        tuning: of the kernel; default 95 % efficiency.
        field_unit: T per unit of the keys h and f.

    Raises:
        MagycError: neither or both of `field` and `field_key`, or numbers that are not finite.
    """
    check_unit(field_unit)
    if (field is None) == (field_key is None):
        raise MagycError("keyframe field: give either `field`, in T, or `field_key`, the key that holds it")
    known = None if field is None else np.asarray(field, dtype=float) / field_unit
    if known is not None and (known.shape not in ((), (3,)) or not np.isfinite(known).all()):
        raise MagycError(f"keyframe field: field {field!r} is neither three finite numbers nor a strength, in T")
    by_direction = known is not None and known.ndim == 0
    scale = known if known is not None else np.empty(0)  # the field or its strength; a variable if empty
    rows = block if robust is not None else block.compressed()
    strength = _EARTH_FIELD if known is None else float(np.linalg.norm(known)) * field_unit
    added = gyroscope_noise * strength * np.sqrt(block.samples * block.spread)
    sigma = float(np.hypot(standard_deviation(noise), added)) / field_unit
    constant = None if robust is None else tuning_constant(robust, 3, tuning)

    def error(first: Array, a: Array, h: Array, *rest: Array) -> Residual:
        *variables, want = rest
        b = variables[0] if gyro_bias_key is not None else block.bias
        if by_direction:
            v, on_first, turn = first * scale, scale * _IDENTITY, _IDENTITY
        else:
            v, on_first, turn = body_field(_IDENTITY, first, scale if field_key is None else variables[-1])
        residual, parts = rows.error(field_unit, v, a, h, b, bool(want))
        residual = residual / sigma
        jacobians: Sequence[Array] = []
        if want:
            on_v, on_a, on_h, on_b = parts
            wanted = [on_v @ on_first, on_a, on_h]
            wanted += [on_b] if gyro_bias_key is not None else []
            wanted += [on_v @ turn] if field_key is not None else []
            jacobians = [jacobian / sigma for jacobian in wanted]
        if robust is not None:
            residual, jacobians = robustify(robust, residual, jacobians, constant)
        return residual.ravel(), [jacobian.reshape(residual.size, -1) for jacobian in jacobians]

    keys = [attitude_key, soft_iron_key, hard_iron_key]
    read: list[Variable] = [direction if by_direction else attitude, vector(6), vector(3)]
    if gyro_bias_key is not None:
        keys, read = [*keys, gyro_bias_key], [*read, gyro_bias]
    if field_key is not None:
        keys, read = [*keys, field_key], [*read, vector(3)]
    return custom_factor("keyframe field", 1.0, keys, read, 3 * len(rows.share), error)


def _about(
    keyframe: float, when: Array, time: Array, rate: Array, bias: Array, interval_mean: bool
) -> tuple[Array, Array, float]:
    """ΔR (n, 3, 3) and K (n, 3, 3) s from the keyframe to the times `when`, and `KeyframeField.spread`."""
    first = max(int(np.searchsorted(time, min(keyframe, when.min()), side="right")) - 1, 0)
    last = int(np.searchsorted(time, max(keyframe, when.max()))) + 1
    time, rate = time[first:last], rate[first:last]
    stamps = np.unique(np.concatenate([time, when, [keyframe]]))
    step = np.diff(stamps)
    if interval_mean:
        turn = (rate[np.searchsorted(time, stamps[1:])] - bias) * step[:, None]
    else:
        if len(stamps) > len(time):
            rate = np.stack([np.interp(stamps, time, axis) for axis in rate.T], axis=1)
        turn = increments(stamps, rate, bias)
    rotation = matrices(_products(exponential(turn))).T.reshape(-1, 3, 3)
    lever = np.zeros_like(rotation)
    np.cumsum((rotation[1:] + rotation[:-1]) * (-0.5 * step[:, None, None]), axis=0, out=lever[1:])
    at, here = np.searchsorted(stamps, when), int(np.searchsorted(stamps, keyframe))
    back = rotation[here].T
    # The share of samples that lie beyond each step, seen from the keyframe.
    below = np.searchsorted(np.sort(at), np.arange(1, len(stamps)), side="left") / len(when)
    beyond = np.where(np.arange(len(step)) < here, below, 1.0 - below)
    spread = float(np.mean(np.diff(time)) * (step @ beyond**2))
    return back @ rotation[at], back @ (lever[at] - lever[here]), spread


def _products(steps: Spinor) -> Spinor:
    """All products from the identity on, as `rotations.chain`, by doubling: fewer calls for some hundred steps."""
    p, q = np.insert(steps[0], 0, 1.0), np.insert(steps[1], 0, 0.0)
    reach = 1
    while reach < len(p):
        p[reach:], q[reach:] = multiply((p[:-reach], q[:-reach]), (p[reach:], q[reach:]))
        reach *= 2
    return p, q
