"""Native priors on a known calibration, the world's field, the mounting and the delay."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import measured
from magyc_gtsam.factors.numbers import is_finite, is_positive
from magyc_gtsam.factors.pose import MICROTESLA, check_unit
from magyc_gtsam.factors.units import check_field, check_readings

_HELD_MOUNTING = 1e-5  # rad
_HELD_DELAY = 1e-6  # s


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
    """
    deviation = np.broadcast_to(np.asarray(sigma, dtype=float), (3,)) / field_unit
    if not (np.isfinite(deviation).all() and (deviation > 0).all()):
        raise MagycError(f"world field prior: standard deviation {sigma!r}; it must be finite and above 0 T")
    check_readings("world field prior: standard deviation", sigma)
    known = measured("field", field, (3,))
    check_field("world field prior", float(np.linalg.norm(known)))
    return gtsam.PriorFactorPoint3(field_key, known / field_unit, gtsam.noiseModel.Diagonal.Sigmas(deviation))


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
    """
    if not is_positive(sigma):
        raise MagycError(f"mounting prior: standard deviation {sigma!r}; it must be finite and above 0 rad")
    rotation = gtsam.Rot3() if body_R_sensor is None else body_R_sensor
    return gtsam.PriorFactorRot3(mounting_key, rotation, gtsam.noiseModel.Isotropic.Sigma(3, sigma))


def delay_prior(delay_key: int, delay: float = 0.0, sigma: float = _HELD_DELAY) -> gtsam.PriorFactorDouble:
    """Return a native prior on the delay as a variable (double, s).

    Args:
        delay_key: key of τ.
        delay: s by which the magnetometer lags.
        sigma: s; the default holds the delay.
    """
    if not (is_finite(delay) and is_positive(sigma)):
        raise MagycError(
            f"delay prior: {delay!r} s with standard deviation {sigma!r}; both must be finite, sigma above 0"
        )
    return gtsam.PriorFactorDouble(delay_key, float(delay), gtsam.noiseModel.Isotropic.Sigma(1, sigma))


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
        MagycError: a singular covariance, such as that of a soft iron of determinant 1, or a hard iron that is not in
            T.
    """
    check_unit(field_unit)
    offset = measured("hard iron", hard_iron, (3,))
    check_readings("calibration prior: hard iron", offset)
    stated = np.asarray(covariance, dtype=float)
    if stated.ndim != 2 or min(stated.shape) < 9:
        raise MagycError(
            f"calibration prior: a covariance of shape {stated.shape}, expected (9, 9) or larger; some methods give "
            "none, `smoother` does"
        )
    unit = np.concatenate([np.ones(6), np.full(3, field_unit)])
    spread = stated[:9, :9] / unit / unit[:, None]
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    correlation = spread / scale / scale[:, None]
    if not np.isfinite(spread).all() or np.linalg.eigvalsh(correlation)[0] < 1e-9:
        raise MagycError(
            "calibration prior: the covariance is singular, as where the soft iron's determinant is fixed at 1; "
            "calibrate with `field_strength` given, or leave that constraint to the graph"
        )
    root = np.linalg.inv(np.linalg.cholesky(correlation)) / scale
    point = gtsam.Values()
    point.insert(soft_iron_key, vech(soft_iron))
    point.insert(hard_iron_key, offset / field_unit)
    noise = gtsam.noiseModel.Unit.Create(9)
    linear = gtsam.JacobianFactor(soft_iron_key, root[:, :6], hard_iron_key, root[:, 6:], np.zeros(9), noise)
    return gtsam.LinearContainerFactor(linear, point)
