"""A block of magnetometer samples as one factor on (R, A, h[, b][, f][, ᵇRₛ][, τ])."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.chain.rotations import skew
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Residual, check_kind, custom_factor
from magyc_gtsam.factors.kernels import robustify, tuning_constant
from magyc_gtsam.factors.keyframe_field import KeyframeField
from magyc_gtsam.factors.one_thread import one_thread
from magyc_gtsam.factors.pose import MICROTESLA, given_keys, known_field, sensor_rotation
from magyc_gtsam.factors.units import check_noise, check_rate_noise
from magyc_gtsam.factors.variables import (
    Array,
    Variable,
    attitude,
    direction,
    gyro_bias,
    mounting,
    reader,
    rotated,
    scalar,
    vector,
)

_EARTH_FIELD = 50e-6  # T, used only to widen a block's sigma where the field is a variable
_TURNS = skew(np.eye(3)).transpose(2, 0, 1)  # [p]× = Σ p_e [e]×; the matrices' columns are the first axis
_MEDIAN = 1.5382  # median of the norm of three independent standard normal variables


@dataclass(eq=False)
class BlockDetails:
    """The parts of a `keyframe_field_factor`, for code that manages it in a graph.

    Attributes:
        attitude_key, soft_iron_key, hard_iron_key, field_key: as given.
        block: its rows, compressed where no kernel needs the samples.
        mean_turn: (3, 3), mean over the samples of the matrix that turns the field from the body frame at the
            keyframe to the sensor's frame.
        mean_field: (3,) T, mean of the readings.
        sigma: T, standard deviation of a sample, widened by the gyroscope.
        field: (3,) T, or a strength; None where it is a variable.
        field_unit: T per unit of the keys.
        robust: the kernel's name.
        gyro_bias_key: as given.
        gyro_bias: how its node is read, in body axes.
        more_keys: whether it has keys besides attitude, soft and hard iron and bias.
        width: factor of the kernel's tuning constant, at least 1: a kernel starts wide and narrows as the graph
            settles (`NativeFactors`, `runners.Incremental`).
        misfit: median whitened norm of the samples at the last evaluation, 1 where the model fits; NaN before, and
            where there is no kernel.
        freed: returns the same factor with its mounting as the variable of a key; None where the mounting already is
            one, or where the attitude key holds a direction.
        on_mounting: (rows, 3) whitened Jacobian on the held mounting, at the last linearisation; None before, and
            where `freed` is None.
    """

    attitude_key: int
    soft_iron_key: int
    hard_iron_key: int
    field_key: int | None
    block: KeyframeField
    mean_turn: Array
    mean_field: Array
    sigma: float
    field: Array | None
    field_unit: float
    robust: str | None
    gyro_bias_key: int | None
    gyro_bias: Variable
    more_keys: bool
    width: float = 1.0
    misfit: float = float("nan")
    freed: Callable[[int], gtsam.CustomFactor] | None = None
    on_mounting: Array | None = None

    @cached_property
    def _read_bias(self) -> Callable[[gtsam.Values], tuple[Array, Array | None]]:
        assert self.gyro_bias_key is not None
        return reader("keyframe field", self.gyro_bias, self.gyro_bias_key)

    def bias_at(self, point: gtsam.Values) -> Array:
        """Return the gyroscope bias (3,) in rad/s, body axes, at which the block is evaluated."""
        return self.block.bias if self.gyro_bias_key is None else self._read_bias(point)[0]

    @cached_property
    def field_over_noise(self) -> float:
        """Ratio of a known field's strength to the standard deviation of the mean of all samples."""
        assert self.field is not None
        return float(np.linalg.norm(self.field)) * math.sqrt(self.block.samples) / self.sigma

    @cached_property
    def lever(self) -> float:
        """Root mean square, over the samples, of the angle in rad by which a bias of 1 rad/s turns the field; in s."""
        return float(np.linalg.norm(self.block.design[:, :, 3:12])) / math.sqrt(2 * self.block.samples)

    def held_keys(self, keys: Sequence[int]) -> list[int]:
        """Return those of the factor's keys that a prior holds: field, mounting and delay."""
        free = (self.attitude_key, self.soft_iron_key, self.hard_iron_key, self.gyro_bias_key)
        return [key for key in keys if key not in free]

    @property
    def on_direction(self) -> bool:
        """Whether the attitude key holds the field's direction in the body frame."""
        return self.field is not None and self.field.ndim == 0


@one_thread
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
    mounting_key: int | None = None,
    delay_key: int | None = None,
    body_R_gyroscope: gtsam.Rot3 | None = None,
    gyroscope_noise: float = 0.0,
    robust: str | None = None,
    tuning: float | None = None,
    field_unit: float = MICROTESLA,
) -> gtsam.CustomFactor:
    """Return one factor over all samples of a block.

    Args:
        attitude_key: R, body→world at the keyframe: `Pose3`, `Rot3`, `NavState`, `Pose2`, `Rot2`; or, where `field`
            is a strength, the field's direction in the body frame (`Unit3`).
        soft_iron_key: A, 6-vector, vech of the soft iron.
        hard_iron_key: h, 3-vector or `Point3`, `field_unit`.
        block: as returned by `KeyframeField.from_samples` or `KeyframeBuffer.close`.
        noise: T per sample and axis.
        gyro_bias_key: b, 3-vector, `Point3` or `ConstantBias`, in the axes of the body, or in others with
            `body_R_gyroscope`; without it the block stays integrated at its own bias.
        field: (3,) T, the world's field, or its strength, a number.
        field_key: f as a variable, 3-vector or `Point3`, `field_unit`.
        mounting_key: ᵇRₛ as a variable, `Rot3` (`mounting_prior`); without it the block's own is held.
        delay_key: τ as a variable, s, double or 1-vector (`delay_prior`); without it the block's own is held.
        body_R_gyroscope: from the axes of the bias node to the body's; None is the identity. With GTSAM's
            `setBodyPSensor` the node is in the IMU's axes, and this is `body_P_sensor.rotation()`. The rates and the
            bias of the block stay in body axes.
        gyroscope_noise: rad/s per sample and axis; `noise` is widened by its contribution inside the block.
        robust: name of a kernel that weights every sample separately; the samples are then not compressed.
        tuning: constant of the kernel; default 95 % efficiency.
        field_unit: T per unit of the keys h and f.

    Raises:
        MagycError: neither or both of `field` and `field_key`, `tuning` without `robust`, `body_R_gyroscope` without
            `gyro_bias_key`, implausible units, or numbers that are not finite.
    """
    name = "keyframe field"
    if isinstance(noise, gtsam.noiseModel.Base):
        raise MagycError(
            f"{name}: `noise` is a noise model; give the standard deviation of a sample in T, a number, which the "
            "block whitens by itself (for outliers `robust`)"
        )
    check_kind(f"{name}: `block`", block, KeyframeField, "what KeyframeBuffer.close returns")
    if tuning is not None and robust is None:
        raise MagycError(f"{name}: `tuning` without `robust`; name the kernel")
    if body_R_gyroscope is not None and gyro_bias_key is None:
        raise MagycError(
            f"{name}: `body_R_gyroscope` without `gyro_bias_key`; it turns the bias node only: give the key, or leave "
            "it out and rotate the block's rates and bias into body axes"
        )
    check_noise(name, noise)
    check_rate_noise(name, gyroscope_noise)
    known = known_field(name, field, field_key, field_unit, strength=True)
    strength = _EARTH_FIELD if known is None else float(np.linalg.norm(known)) * field_unit
    added = gyroscope_noise * strength * np.sqrt(block.samples * block.spread)
    whole_sigma = float(np.hypot(noise, added))
    sigma = whole_sigma / field_unit
    constant = None if robust is None else tuning_constant(robust, 3, tuning)
    bias = gyro_bias
    if body_R_gyroscope is not None:
        bias = rotated(gyro_bias, sensor_rotation(body_R_gyroscope, f"{name}: body_R_gyroscope"))
    extra = given_keys(
        (gyro_bias_key, bias), (field_key, vector(3)), (mounting_key, mounting), (delay_key, scalar)
    )
    late = delay_key is not None
    whole = block.with_delay() if late else block
    rows = whole.compressed() if robust is None else whole
    share = rows.share / rows.samples  # compression keeps the columns' products, and so the samples' means
    mean_turn = (share @ rows.design.reshape(len(share), -1)).reshape(3, -1)[:, :3]
    details = BlockDetails(
        attitude_key, soft_iron_key, hard_iron_key, field_key, rows, mean_turn, share @ rows.field, whole_sigma,
        None if known is None else known * field_unit, field_unit, robust, gyro_bias_key,
        bias, len(extra) > (gyro_bias_key is not None),
    )  # fmt: skip
    if mounting_key is None and not details.on_direction:

        def freed(key: int) -> gtsam.CustomFactor:
            return keyframe_field_factor(
                attitude_key, soft_iron_key, hard_iron_key, rows, noise, gyro_bias_key=gyro_bias_key, field=field,
                field_key=field_key, mounting_key=key, delay_key=delay_key, body_R_gyroscope=body_R_gyroscope,
                gyroscope_noise=gyroscope_noise, robust=robust, tuning=tuning, field_unit=field_unit,
            )  # fmt: skip

        details.freed = freed
    mounted = rows.body_R_sensor
    on_h = np.eye(3)[:, None] * (rows.share / sigma)[:, None]
    optional = [key for key, _ in extra]

    def error(first: Array, a: Array, h: Array, *rest: Array) -> Residual:
        *more, want = rest
        found: dict[int | None, Array] = dict(zip(optional, more, strict=True))
        b = rows.bias if gyro_bias_key is None else found[gyro_bias_key]
        tau = float(found[delay_key][0]) if late else None
        f = found[field_key] if known is None else known
        rotation = None
        if details.on_direction:
            v = first * f
        else:
            rotation = first.reshape(3, 3)
            v = rotation.T @ f
        soft_iron = unvech(a)
        turned = None if mounting_key is None else found[mounting_key].reshape(3, 3).T @ mounted
        iron = soft_iron if turned is None else soft_iron @ turned
        residual, parts = rows.error(field_unit * sigma, v, iron / sigma, h / sigma, b, tau, bool(want))
        jacobians: list[Array] = []  # each (columns, k, 3)
        if want:
            seen, on_v, on_b, *on_tau = parts
            if rotation is None:
                jacobians.append(on_v * f)
            else:
                jacobians.append((f[:, None, None, None] * on_v).reshape(9, -1, 3))
            # Jacobians on the soft iron, and on a held mounting: A Exp(φ)ᵀ p = A p + A [p]× φ, p = G y.
            units = SYMMETRIC_UNITS
            if details.freed is not None:
                units = np.concatenate([units, _TURNS @ soft_iron])
            on_iron = (seen if turned is None else seen @ turned.T) @ (units / sigma)
            jacobians += [on_iron[:6], on_h]
            if gyro_bias_key is not None:
                jacobians.append(on_b)
            if field_key is not None and rotation is not None:
                jacobians.append(np.tensordot(rotation, on_v, 1))
            if mounting_key is not None:
                # B = A Sᵀ S₀: ∂B_ij/∂S_kl = A_il (S₀)_kj
                at_rest = (seen @ mounted.T).T
                on_mounting = at_rest[:, None, :, None] * (soft_iron / sigma)[None, :, None, :]
                jacobians.append(on_mounting.reshape(9, -1, 3))
            jacobians += on_tau
            if details.freed is not None:
                jacobians.append(on_iron[6:])
        if robust is not None and constant is not None:
            norms = np.sqrt(np.einsum("ki,ki->k", residual, residual))
            details.misfit = float(np.median(norms)) / _MEDIAN
            by_sample = [jacobian.transpose(1, 2, 0) for jacobian in jacobians]
            residual, by_sample = robustify(robust, residual, by_sample, constant * details.width)
            flat = [jacobian.reshape(residual.size, -1) for jacobian in by_sample]
        else:
            flat = [jacobian.reshape(-1, residual.size).T for jacobian in jacobians]
        if want and details.freed is not None:
            details.on_mounting = flat.pop()
        return residual.ravel(), flat

    keys = [attitude_key, soft_iron_key, hard_iron_key, *optional]
    read = [direction if details.on_direction else attitude, vector(6), vector(3), *(how for _, how in extra)]
    return custom_factor(name, 1.0, keys, read, 3 * len(rows.share), error, details=details)
