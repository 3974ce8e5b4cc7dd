"""One magnetometer sample as a factor on an attitude of an existing graph.

    m = A ᵇRₛᵀ Exp(ω τ) Rᵀ f + h

R is the attitude body→world from the graph, ᵇRₛ the mounting sensor→body, f the world's field in T, τ the delay by
which the magnetometer lags, ω the angular rate. A, h and f are keys in units that keep a graph's variables of order
one: A is dimensionless where f is in tesla; h and f are in `field_unit` tesla (µT by default), which is also the unit
of the residual.

With A = I and f, h known this is GTSAM's `MagFactor1`, `MagPoseFactorPose3` and `MagFactor`; with the attitude known
and a scale for A it is `MagFactor3`, which GTSAM does not wrap.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.chain.rotations import exponential_matrices, skew
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Noise, Residual, check_delay, check_kind, custom_factor, measured
from magyc_gtsam.factors.units import (
    check_field,
    check_model,
    check_noise,
    check_rates,
    check_readings,
    check_unit,
)
from magyc_gtsam.factors.variables import Array, Variable, attitude, direction, mounting, scalar, vector

MICROTESLA = 1e-6
_NO_ROTATION = (
    2e-3  # distance of an element from that of the nearest rotation; with three decimals it is below 1e-3
)


def body_field(body_R_sensor: Array, rotation: Array, field: Array) -> tuple[Array, Array, Array]:
    """Return the field in the sensor's frame ᵇRₛᵀ Rᵀ f (3,), and its derivatives on R (3, 9) and on f (3, 3)."""
    to_sensor = body_R_sensor.T
    turn = to_sensor @ rotation.reshape(3, 3).T
    # ∂(ᵇRₛᵀ Rᵀ f)_i / ∂R_jk = (ᵇRₛᵀ)_ik f_j
    return turn @ field, (field[None, :, None] * to_sensor[:, None, :]).reshape(3, 9), turn


def known_field(
    name: str, field: ArrayLike | None, field_key: int | None, field_unit: float, *, strength: bool = False
) -> Array | None:
    """Return the world's field in `field_unit`, or None where `field_key` holds it.

    Args:
        name: name of the factor, for error messages.
        field: (3,) T; where `strength` is set also a number, the field's strength.
        field_key: key of the field as a variable.
        field_unit: T per unit of the keys.
        strength: whether a number is accepted.
    """
    check_unit(field_unit)
    if (field is None) == (field_key is None):
        raise MagycError(
            f"{name}: the world's field is either known, `field` in T, or a variable, `field_key`; got "
            f"{'neither' if field is None else 'both'}"
        )
    if field is None:
        return None
    shape = () if strength and np.ndim(field) == 0 else (3,)
    known = measured(f"{name}: field", field, shape)
    check_field(name, float(np.linalg.norm(known)))
    return known / field_unit


def check_rotation(name: str, rotation: gtsam.Rot3) -> None:
    """Raise an error for a rotation that is no `Rot3`, or one of a matrix that is no rotation, which GTSAM takes."""
    check_kind(name, rotation, gtsam.Rot3, "a gtsam.Rot3, for example gtsam.Rot3(matrix) of a (3, 3) matrix")
    matrix = rotation.matrix()
    if not np.abs(matrix - gtsam.Rot3.ClosestTo(matrix).matrix()).max() <= _NO_ROTATION:
        raise MagycError(
            f"{name} {np.round(matrix, 4).tolist()}; it must be a rotation: rows of length 1, at right angles and of "
            "determinant 1; round with gtsam.Rot3.ClosestTo(matrix); if an axis is reversed, reverse it in the readings"
        )


def sensor_rotation(body_R_sensor: gtsam.Rot3 | None, name: str = "body_R_sensor") -> Array:
    """Return ᵇRₛ (3, 3), sensor→body; None is the identity."""
    if body_R_sensor is None:
        return np.eye(3)
    check_rotation(name, body_R_sensor)
    return body_R_sensor.matrix()


def given_keys(*pairs: tuple[int | None, Variable]) -> list[tuple[int, Variable]]:
    """Return the optional keys that were given, with their readers."""
    return [(key, variable) for key, variable in pairs if key is not None]


def in_unit(name: str, noise: Noise, field_unit: float) -> Noise:
    """Check a standard deviation in T and return it in `field_unit`; check a noise model, which is in `field_unit`."""
    if isinstance(noise, gtsam.noiseModel.Base):
        check_model(name, _sigmas(noise) * field_unit)
        return noise
    check_noise(name, noise)
    return noise / field_unit


def _sigmas(noise: gtsam.noiseModel.Base) -> Array:
    """Return the standard deviations of a noise model; of a robust one those that it weighs."""
    inner = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
    if isinstance(inner, gtsam.noiseModel.Diagonal):
        return np.asarray(inner.sigmas())
    return np.sqrt(np.diag(inner.covariance())) if isinstance(inner, gtsam.noiseModel.Gaussian) else np.empty(0)


def magnetometer_factor(
    attitude_key: int,
    soft_iron_key: int,
    hard_iron_key: int,
    measurement: ArrayLike,
    noise: Noise,
    *,
    field: ArrayLike | None = None,
    field_key: int | None = None,
    mounting_key: int | None = None,
    delay_key: int | None = None,
    delay: float = 0.0,
    angular_rate: ArrayLike | None = None,
    body_R_sensor: gtsam.Rot3 | None = None,
    field_unit: float = MICROTESLA,
) -> gtsam.CustomFactor:
    """Return a factor of one measured field on (R, A, h[, f][, ᵇRₛ][, τ]).

    Args:
        attitude_key: R, body→world: `Pose3`, `Rot3`, `NavState`, `Pose2` or `Rot2`.
        soft_iron_key: A, 6-vector, vech of the soft iron.
        hard_iron_key: h, 3-vector or `Point3`, `field_unit`.
        measurement: (3,) T, sensor frame.
        noise: standard deviation per axis in T, or a noise model of the 3 rows in `field_unit`, such as
            `robust_noise`.
        field: (3,) T, world frame, e.g. `magyc_gtsam.world_field.world_magnetic_field(...).vector` in a
            north-east-down world. Where f is a variable, use the known field in its prior (`world_field_prior`)
            instead.
        field_key: f as a variable, 3-vector or `Point3`, `field_unit`.
        mounting_key: ᵇRₛ as a variable, `Rot3` (`mounting_prior`); without it `body_R_sensor` is held.
        delay_key: τ as a variable, s, double or 1-vector (`delay_prior`); without it `delay` is held.
        delay: s by which the magnetometer lags the attitude's time.
        angular_rate: (3,) rad/s at the measurement, body frame, less its bias; needed where there is a delay.
        body_R_sensor: sensor→body.
        field_unit: T per unit of the keys h and f.

    Raises:
        MagycError: arguments that do not fit together, implausible units, or values that are not finite.
    """
    name = "magnetometer"
    known = known_field(name, field, field_key, field_unit)
    m, fixed = measured("measurement", measurement, (3,)) / field_unit, sensor_rotation(body_R_sensor)
    check_readings(name, m * field_unit)
    check_delay(name, delay)
    late = delay_key is not None or delay != 0
    if late and angular_rate is None:
        raise MagycError(f"{name}: a delay needs `angular_rate` at the measurement, (3,) rad/s")
    rate = measured("angular rate", np.zeros(3) if angular_rate is None else angular_rate, (3,))
    check_rates(name, rate)
    spin = skew(rate)
    extra = given_keys((field_key, vector(3)), (mounting_key, mounting), (delay_key, scalar))
    optional = [key for key, _ in extra]

    def error(rotation: Array, a: Array, h: Array, *rest: Array) -> Residual:
        *more, want_jacobians = rest
        found: dict[int | None, Array] = dict(zip(optional, more, strict=True))
        f = found[field_key] if known is None else known
        body_R = fixed if mounting_key is None else found[mounting_key].reshape(3, 3)
        turned = np.eye(3)
        if late:
            tau = float(found[delay_key][0]) if delay_key is not None else delay
            turned = exponential_matrices((rate * tau)[:, None])[:, :, 0]
        in_body = turned @ (rotation.reshape(3, 3).T @ f)
        seen = body_R.T @ in_body
        soft_iron = unvech(a)
        residual = soft_iron @ seen + h - m
        if not want_jacobians:
            return residual, []
        to_sensor = soft_iron @ body_R.T @ turned
        jacobians = [
            np.einsum("j,ik->ijk", f, to_sensor).reshape(3, 9),
            (SYMMETRIC_UNITS @ seen).T,
            np.eye(3),
        ]
        if field_key is not None:
            jacobians.append(to_sensor @ rotation.reshape(3, 3).T)
        if mounting_key is not None:
            jacobians.append(np.einsum("j,ik->ijk", in_body, soft_iron).reshape(3, 9))
        if delay_key is not None:
            jacobians.append((soft_iron @ body_R.T @ spin @ in_body)[:, None])
        return residual, jacobians

    variables: list[Variable] = [attitude, vector(6), vector(3), *(variable for _, variable in extra)]
    keys = [attitude_key, soft_iron_key, hard_iron_key, *optional]
    return custom_factor(name, in_unit(name, noise, field_unit), keys, variables, 3, error)


def scaled_magnetometer_factor(
    direction_key: int,
    scale_key: int,
    hard_iron_key: int,
    measurement: ArrayLike,
    rotation: gtsam.Rot3,
    noise: Noise,
    *,
    body_R_sensor: gtsam.Rot3 | None = None,
    field_unit: float = MICROTESLA,
) -> gtsam.CustomFactor:
    """Return GTSAM's `MagFactor3`, m = s ᵇRₛᵀ Rᵀ d + h: known attitude; unknown scale, direction and bias.

    Args:
        direction_key: d, `Unit3`, world frame.
        scale_key: s, double or 1-vector, `field_unit`.
        hard_iron_key: h, 3-vector or `Point3`, `field_unit`.
        measurement: (3,) T, sensor frame.
        rotation: R, body→world.
        noise: standard deviation per axis in T, or a noise model of the 3 rows in `field_unit`.
        body_R_sensor: sensor→body.
        field_unit: T per unit of s and h.
    """
    name = "scaled magnetometer"
    check_unit(field_unit)
    m, to_sensor = measured("measurement", measurement, (3,)) / field_unit, sensor_rotation(body_R_sensor).T
    check_readings(name, m * field_unit)
    check_rotation(f"{name}: rotation", rotation)
    turn = to_sensor @ rotation.matrix().T

    def error(d: Array, s: Array, h: Array, want_jacobians: bool) -> Residual:
        seen = turn @ d
        residual = s * seen + h - m
        return residual, [s * turn, seen[:, None], np.eye(3)] if want_jacobians else []

    keys: Sequence[int] = (direction_key, scale_key, hard_iron_key)
    variables = [direction, scalar, vector(3)]
    return custom_factor(name, in_unit(name, noise, field_unit), keys, variables, 3, error)
