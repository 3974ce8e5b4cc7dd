"""Priors of a graph: on a calibration, the world's field, the mounting and the delay, and random walks between nodes.

The variance of changes such as those of an ageing battery, a moved payload or a warming sensor grows with time; it is
stated as a standard deviation after one hour (per √hour). Priors and walks are GTSAM's own factors, so that no Python
runs inside the optimiser, except those that keep an inverse soft iron, l = vech(C), away from C = 0.

Several nodes also keep iSAM2 fast where the calibration is constant: iSAM2 visits every factor of every variable that
an update affects, so that one pair of keys under n factors costs n per update (docs/slam.md).
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, unvech, vech
from magyc_gtsam.factors.covariance import root_information
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import (
    Noise,
    Residual,
    check_delay,
    checked_keys,
    custom_factor,
    measured,
    standard_deviation,
    standard_deviations,
)
from magyc_gtsam.factors.numbers import is_positive
from magyc_gtsam.factors.pose import MICROTESLA, check_rotation
from magyc_gtsam.factors.units import (
    check_bias_walk,
    check_elapsed,
    check_field,
    check_late,
    check_readings,
    check_turn,
    check_unit,
)
from magyc_gtsam.factors.variables import Array, vector

_HELD_MOUNTING = 1e-5  # rad
_HELD_DELAY = 1e-6  # s
_ASYMMETRY = 1e-6  # largest asymmetry of a soft iron, relative to its largest element: that of rounded numbers


def world_field_prior(
    field_key: int, field: ArrayLike, sigma: ArrayLike, *, field_unit: float = MICROTESLA
) -> gtsam.PriorFactorPoint3:
    """Return a native prior on the world's field as a variable (`Point3`, `field_unit`).

    Args:
        field_key: key of f.
        field: (3,) T in the graph's world frame, e.g. of the World Magnetic Model.
        sigma: T, one or three; the model is good to about 0.15 µT plus the contribution of the crust, which is 0.1 to
            1 µT on most of the sea floor and far more beside steel.
        field_unit: T per unit of the key.

    Raises:
        MagycError: no key, wrong shapes or units, or numbers that are not finite.
    """
    name = "world field prior"
    (key,) = checked_keys(name, [field_key], 1)
    check_unit(field_unit)
    deviation = standard_deviations(name, sigma, 3)
    check_readings(f"{name}: standard deviation", deviation)
    known = measured("field", field, (3,))
    check_field(name, float(np.linalg.norm(known)))
    noise = gtsam.noiseModel.Diagonal.Sigmas(deviation / field_unit)
    return gtsam.PriorFactorPoint3(key, known / field_unit, noise)


def mounting_prior(
    mounting_key: int, body_R_sensor: gtsam.Rot3 | None = None, sigma: float = _HELD_MOUNTING
) -> gtsam.PriorFactorRot3:
    """Return a native prior on the mounting as a variable (`Rot3`, sensor→body).

    Args:
        mounting_key: key of ᵇRₛ.
        body_R_sensor: nominal mounting; None is the identity.
        sigma: rad per axis; the default holds the mounting. On a vehicle that stays level a rotation of the mounting
            about the vertical is equivalent to a rotation of the heading; only another source of heading separates
            the two.

    Raises:
        MagycError: no key, no rotation, or a standard deviation that is not above 0 or above a quarter turn.
    """
    (key,) = checked_keys("mounting prior", [mounting_key], 1)
    rotation = gtsam.Rot3() if body_R_sensor is None else body_R_sensor
    check_rotation("mounting prior: body_R_sensor", rotation)
    deviation = standard_deviation(sigma, "mounting prior")
    check_turn("mounting prior", deviation)
    noise = gtsam.noiseModel.Isotropic.Sigma(3, deviation)
    return gtsam.PriorFactorRot3(key, rotation, noise)


def delay_prior(delay_key: int, delay: float = 0.0, sigma: float = _HELD_DELAY) -> gtsam.PriorFactorDouble:
    """Return a native prior on the delay as a variable (double, s).

    Args:
        delay_key: key of τ.
        delay: s by which the magnetometer lags.
        sigma: s; the default holds the delay.

    Raises:
        MagycError: no key, a delay that is not finite or above 10 s, or a standard deviation that is not above 0 or
            above 1 s.
    """
    (key,) = checked_keys("delay prior", [delay_key], 1)
    check_delay("delay prior", delay)
    deviation = standard_deviation(sigma, "delay prior")
    check_late("delay prior", delay, deviation)
    noise = gtsam.noiseModel.Isotropic.Sigma(1, deviation)
    return gtsam.PriorFactorDouble(key, float(delay), noise)


def calibration_prior(
    soft_iron_key: int,
    hard_iron_key: int,
    soft_iron: ArrayLike,
    hard_iron: ArrayLike,
    covariance: ArrayLike,
    *,
    field_unit: float = MICROTESLA,
) -> gtsam.LinearContainerFactor:
    """Return a known calibration as a native prior on (A, h), with all correlations.

    Args:
        soft_iron_key, hard_iron_key: 6-vector; 3-vector or `Point3` in `field_unit`.
        soft_iron: (3, 3), scaled to the true field (`magyc_gtsam.calibrate(..., field_strength=...)`).
        hard_iron: (3,) T.
        covariance: (9, 9) or larger, of vech(soft iron) and hard iron in T; further rows and columns are ignored.
        field_unit: T per unit of the key h.

    Raises:
        MagycError: keys that are none or the same, a soft iron that is not finite, not symmetric or not positive
            definite, a covariance that is not symmetric or is singular, such as that of a soft iron of determinant 1,
            or a hard iron that is not in T.
    """
    keys = checked_keys("calibration prior", [soft_iron_key, hard_iron_key], 2)
    check_unit(field_unit)
    iron = measured("calibration prior: soft iron", soft_iron, (3, 3))
    if np.abs(iron - iron.T).max() > _ASYMMETRY * np.abs(iron).max():
        raise MagycError(
            f"calibration prior: soft iron {iron.tolist()}; it must be symmetric, since its key holds the upper "
            "triangle only; a rotation beside it is a mounting"
        )
    least = float(np.linalg.eigvalsh(iron)[0])
    if least <= 0:
        raise MagycError(
            f"calibration prior: soft iron with an eigenvalue of {least:.4g}; it must be positive definite, all above "
            "0: a sensor with an axis reversed or axes exchanged needs them put right in its readings first"
        )
    offset = measured("calibration prior: hard iron", hard_iron, (3,))
    check_readings("calibration prior: hard iron", offset)
    root = root_information("calibration prior", covariance, field_unit)
    point = gtsam.Values()
    point.insert(keys[0], vech(iron))
    point.insert(keys[1], offset / field_unit)
    noise = gtsam.noiseModel.Unit.Create(9)
    linear = gtsam.JacobianFactor(keys[0], root[:, :6], keys[1], root[:, 6:], np.zeros(9), noise)
    return gtsam.LinearContainerFactor(linear, point)


def norm_error(l: Array, want_jacobians: bool = False) -> Residual:  # noqa: E741
    """Return ‖l‖ − 1 (1,) and its Jacobian lᵀ/‖l‖ (1, 6), eqs. (9) and (10) of the MAGYC paper."""
    norm = float(np.sqrt(l @ l))
    if norm == 0:
        raise MagycError("norm prior: it has no derivative at l = 0; start from another soft iron")
    return np.array([norm - 1.0]), [l[None, :] / norm] if want_jacobians else []


def determinant_error(l: Array, want_jacobians: bool = False) -> Residual:  # noqa: E741
    """Return det C − 1 (1,) and its Jacobian (1, 6): the cofactors, those off the diagonal doubled."""
    c = unvech(l)
    cofactors = np.cross(c[[1, 2, 0]], c[[2, 0, 1]])
    residual = np.array([c[0] @ cofactors[0] - 1.0])
    return residual, [np.tensordot(SYMMETRIC_UNITS, cofactors)[None, :]] if want_jacobians else []


def norm_prior(soft_iron_key: int, noise: Noise) -> gtsam.CustomFactor:
    """Return the factor ‖l‖ = 1 on a 6-vector, eq. (9); without it C = 0, d = 0 solves residual (7)."""
    return custom_factor("norm prior", noise, [soft_iron_key], [vector(6)], 1, norm_error)


def determinant_prior(soft_iron_key: int, noise: Noise) -> gtsam.CustomFactor:
    """Return the factor det C = 1 on a 6-vector, the scale fixed by the authors' later package."""
    return custom_factor("determinant prior", noise, [soft_iron_key], [vector(6)], 1, determinant_error)


_HOUR = 3600.0


def soft_iron_walk(first_key: int, second_key: int, elapsed: float, sigma: ArrayLike) -> gtsam.BetweenFactorVector:
    """Return a random walk between two soft irons (6-vectors).

    Args:
        first_key, second_key: keys of the two nodes.
        elapsed: s between the two nodes.
        sigma: change per √hour of each entry, one or six; 1e-3 is a tenth of a percent in an hour.

    Raises:
        MagycError: keys that are none or the same, numbers that are not above 0, or more than 32 years.
    """
    first, second = _two_nodes(first_key, second_key)
    return gtsam.BetweenFactorVector(first, second, np.zeros(6), _grown(sigma, 6, elapsed))


def hard_iron_walk(
    first_key: int, second_key: int, elapsed: float, sigma: ArrayLike, *, field_unit: float = MICROTESLA
) -> gtsam.BetweenFactorPoint3:
    """Return a random walk between two hard irons (3-vectors or `Point3`, `field_unit`).

    Args:
        first_key, second_key: keys of the two nodes.
        elapsed: s between the two nodes.
        sigma: T per √hour, one or three.
        field_unit: T per unit of the keys.

    Raises:
        MagycError: as `soft_iron_walk`, or `sigma` in another unit.
    """
    first, second = _two_nodes(first_key, second_key)
    check_unit(field_unit)
    deviation = standard_deviations("hard iron walk", sigma, 3)
    check_readings("hard iron walk", deviation)
    return gtsam.BetweenFactorPoint3(first, second, np.zeros(3), _grown(deviation / field_unit, 3, elapsed))


def gyro_bias_walk(first_key: int, second_key: int, elapsed: float, sigma: ArrayLike) -> gtsam.BetweenFactorPoint3:
    """Return a random walk between two gyroscope biases (3-vectors or `Point3`).

    A graph whose bias is an `imuBias.ConstantBias` has its own walk (`CombinedImuFactor`,
    `BetweenFactorConstantBias`) and needs no other.

    Args:
        first_key, second_key: keys of the two nodes.
        elapsed: s between the two nodes.
        sigma: rad/s per √hour, one or three.

    Raises:
        MagycError: as `soft_iron_walk`, or `sigma` above 10 rad/s.
    """
    first, second = _two_nodes(first_key, second_key)
    deviation = standard_deviations("gyro bias walk", sigma, 3)
    check_bias_walk("gyro bias walk", deviation)
    return gtsam.BetweenFactorPoint3(first, second, np.zeros(3), _grown(deviation, 3, elapsed))


def _two_nodes(first_key: int, second_key: int) -> tuple[int, int]:
    """Return the keys of a walk, checked."""
    name = "random walk"
    (first,), (second,) = checked_keys(name, [first_key], 1), checked_keys(name, [second_key], 1)
    if first == second:
        raise MagycError(f"{name}: it joins two nodes, and both keys are the same; give the key of the next node")
    return first, second


def _grown(sigma: ArrayLike, size: int, elapsed: float) -> gtsam.noiseModel.Diagonal:
    """Return the noise model of a walk of `sigma` per √hour after `elapsed` s."""
    if not is_positive(elapsed):
        raise MagycError(
            f"random walk over {elapsed!r:.40} s; it must be a number, finite and above 0 (a calibration that does not "
            "change needs one node, or a walk too small to matter)"
        )
    check_elapsed("random walk", elapsed)
    deviation = standard_deviations("random walk per √hour", sigma, size) * np.sqrt(elapsed / _HOUR)
    return gtsam.noiseModel.Diagonal.Sigmas(deviation)
