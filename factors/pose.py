"""Magnetometer on an attitude of a graph that exists already: `Pose3`, `Rot3` or (heading only) `Rot2`.

    m = A (ᵇRₛᵀ Rᵀ f) + h

R body→world from the graph, ᵇRₛ sensor→body, f the world's field in T, known or a variable of its own.
A, h and f are keys in units that keep a graph's variables of order one: A as it is where f is known in
tesla, h and f in `field_unit` tesla (µT unless said otherwise), which is also the unit of the residual.

With A = I and f, h known this is GTSAM's `MagFactor1`, `MagPoseFactorPose3` and `MagFactor`; with the
attitude known and a scale for A it is `MagFactor3`, which GTSAM does not wrap.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import (
    Array,
    Noise,
    Residual,
    Variable,
    custom_factor,
    direction,
    measured,
    vector,
)
from magyc_gtsam.factors.rotations import skew
from magyc_gtsam.factors.soft_iron import SYMMETRIC_UNITS, unvech

MICROTESLA = 1e-6

_TURNS = skew(np.eye(3))


def attitude(values: gtsam.Values, key: int) -> tuple[Array, Array]:
    """A key that holds a `Pose3`, `Rot3` or `Rot2`, read as the rotation matrix row by row (9,)."""
    try:
        rotation, columns = values.atPose3(key).rotation().matrix(), slice(0, 6)
    except RuntimeError:
        try:
            rotation, columns = values.atRot3(key).matrix(), slice(0, 3)
        except RuntimeError:
            rotation, columns = gtsam.Rot3.Yaw(values.atRot2(key).theta()).matrix(), slice(2, 3)
    tangent = np.zeros((9, 6))  # R Exp(φ) = R + R [φ]×, in the body frame as GTSAM has it
    tangent[:, :3] = (rotation @ _TURNS).reshape(3, 9).T
    return rotation.ravel(), tangent[:, columns]


def scalar(values: gtsam.Values, key: int) -> tuple[Array, None]:
    """A key that holds a double, read as (1,)."""
    return np.array([values.atDouble(key)]), None


def body_field(body_R_sensor: Array, rotation: Array, field: Array) -> tuple[Array, Array, Array]:
    """The field in the sensor's frame ᵇRₛᵀ Rᵀ f (3,), and its derivatives on R (3, 9) and on f (3, 3)."""
    to_sensor = body_R_sensor.T
    turn = to_sensor @ rotation.reshape(3, 3).T
    # ∂(ᵇRₛᵀ Rᵀ f)_i / ∂R_jk = (ᵇRₛᵀ)_ik f_j
    return turn @ field, (field[None, :, None] * to_sensor[:, None, :]).reshape(3, 9), turn


def known_field(field: ArrayLike | None, keys: Sequence[int], count: int, field_unit: float) -> Array | None:
    """The world's field in `field_unit`, or None where the key after the first `count` ones holds it."""
    check_unit(field_unit)
    if (field is None) == (len(keys) == count):
        raise MagycError(
            f"the world's field must be known (`field`, then {count} keys) or a variable (no `field`, "
            f"{count + 1} keys); got {len(keys)} keys and {'no field' if field is None else 'a field'}"
        )
    return None if field is None else measured("field", field, (3,)) / field_unit


def check_unit(field_unit: float) -> None:
    """Refuse a unit that is no positive number of T."""
    if not (np.isfinite(field_unit) and field_unit > 0):
        raise MagycError(f"field_unit {field_unit}; it must be finite and above 0 T")


def sensor_rotation(body_R_sensor: gtsam.Rot3 | None) -> Array:
    """ᵇRₛ (3, 3), sensor→body; None is the identity."""
    return np.eye(3) if body_R_sensor is None else body_R_sensor.matrix()


def in_unit(noise: Noise, field_unit: float) -> Noise:
    """A standard deviation in T in `field_unit`; a noise model stays as it is."""
    return noise if isinstance(noise, gtsam.noiseModel.Base) else noise / field_unit


def magnetometer_factor(
    keys: Sequence[int],
    measurement: ArrayLike,
    noise: Noise,
    *,
    field: ArrayLike | None = None,
    body_R_sensor: gtsam.Rot3 | None = None,
    field_unit: float = MICROTESLA,
) -> gtsam.CustomFactor:
    """One measured field on (R, A, h) with the world's field known, or on (R, A, h, f).

    Args:
        keys: of R (`Pose3`, `Rot3`, `Rot2`, body→world), A (6-vector, vech of the soft iron), h (3-vector or
            `Point3`, `field_unit`) and, where `field` is None, f (3-vector or `Point3`, `field_unit`).
        measurement: (3,) T, sensor frame.
        noise: standard deviation per axis in T, or a noise model of the 3 rows in `field_unit`, such as
            `robust_noise`.
        field: (3,) T, world frame, e.g. `magyc_gtsam.world_field.world_magnetic_field(...).vector` in a
            north-east-down world. With f a variable it is that variable's prior (`world_field_prior`).
        body_R_sensor: sensor→body.
        field_unit: T per unit of the keys h and f.

    Raises:
        MagycError: keys and `field` that do not fit together, or values that are not finite.
    """
    known = known_field(field, keys, 3, field_unit)
    m, mounting = measured("measurement", measurement, (3,)) / field_unit, sensor_rotation(body_R_sensor)

    def error(rotation: Array, a: Array, h: Array, *rest: Array) -> Residual:
        *variable, want_jacobians = rest
        seen, on_rotation, on_field = body_field(mounting, rotation, variable[0] if known is None else known)
        soft_iron = unvech(a)
        residual = soft_iron @ seen + h - m
        if not want_jacobians:
            return residual, []
        jacobians = [soft_iron @ on_rotation, (SYMMETRIC_UNITS @ seen).T, np.eye(3)]
        return residual, jacobians if known is not None else [*jacobians, soft_iron @ on_field]

    variables: list[Variable] = [attitude, vector(6), vector(3)] + ([vector(3)] if known is None else [])
    return custom_factor("magnetometer", in_unit(noise, field_unit), keys, variables, 3, error)


def scaled_magnetometer_factor(
    keys: Sequence[int],
    measurement: ArrayLike,
    rotation: gtsam.Rot3,
    noise: Noise,
    *,
    body_R_sensor: gtsam.Rot3 | None = None,
    field_unit: float = MICROTESLA,
) -> gtsam.CustomFactor:
    """GTSAM's `MagFactor3`, m = s ᵇRₛᵀ Rᵀ d + h: the attitude known, scale, direction and bias unknown.

    Args:
        keys: of s (double, `field_unit`), d (`Unit3`, world frame) and h (3-vector or `Point3`, `field_unit`).
        measurement: (3,) T, sensor frame.
        rotation: R, body→world.
        noise: standard deviation per axis in T, or a noise model of the 3 rows in `field_unit`.
        body_R_sensor: sensor→body.
        field_unit: T per unit of s and h.
    """
    check_unit(field_unit)
    m, to_sensor = measured("measurement", measurement, (3,)) / field_unit, sensor_rotation(body_R_sensor).T
    turn = to_sensor @ rotation.matrix().T

    def error(s: Array, d: Array, h: Array, want_jacobians: bool) -> Residual:
        seen = turn @ d
        residual = s * seen + h - m
        return residual, [seen[:, None], s * turn, np.eye(3)] if want_jacobians else []

    variables = [scalar, direction, vector(3)]
    return custom_factor("scaled magnetometer", in_unit(noise, field_unit), keys, variables, 3, error)


def world_field_prior(
    key: int, field: ArrayLike, sigma: ArrayLike, *, field_unit: float = MICROTESLA
) -> gtsam.PriorFactorPoint3:
    """Native prior on the world's field as a variable (`Point3`, `field_unit`).

    Args:
        key: of f.
        field: (3,) T in the graph's world frame, e.g. of the World Magnetic Model.
        sigma: T, one or three; the model is good to about 0.15 µT plus what the crust adds, which is 0.1 to
            1 µT on most of the sea floor and far more beside steel.
        field_unit: T per unit of the key.
    """
    deviation = np.broadcast_to(np.asarray(sigma, dtype=float), (3,)) / field_unit
    if not (np.isfinite(deviation).all() and (deviation > 0).all()):
        raise MagycError(f"world field prior: standard deviation {sigma!r}; it must be finite and above 0 T")
    noise = gtsam.noiseModel.Diagonal.Sigmas(deviation)
    return gtsam.PriorFactorPoint3(key, measured("field", field, (3,)) / field_unit, noise)
