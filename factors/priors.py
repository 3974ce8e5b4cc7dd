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
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Noise, Residual, custom_factor, measured
from magyc_gtsam.factors.numbers import is_finite, is_positive
from magyc_gtsam.factors.pose import MICROTESLA, check_unit
from magyc_gtsam.factors.units import check_field, check_readings
from magyc_gtsam.factors.variables import Array, vector

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
    """
    return gtsam.BetweenFactorVector(
        first_key, second_key, np.zeros(6), _grown((first_key, second_key), sigma, 6, elapsed)
    )


def hard_iron_walk(
    first_key: int, second_key: int, elapsed: float, sigma: ArrayLike, *, field_unit: float = MICROTESLA
) -> gtsam.BetweenFactorPoint3:
    """Return a random walk between two hard irons (3-vectors or `Point3`, `field_unit`).

    Args:
        first_key, second_key: keys of the two nodes.
        elapsed: s between the two nodes.
        sigma: T per √hour, one or three.
        field_unit: T per unit of the keys.
    """
    check_readings("hard iron walk", sigma)
    return gtsam.BetweenFactorPoint3(
        first_key,
        second_key,
        np.zeros(3),
        _grown((first_key, second_key), np.asarray(sigma, dtype=float) / field_unit, 3, elapsed),
    )


def gyro_bias_walk(first_key: int, second_key: int, elapsed: float, sigma: ArrayLike) -> gtsam.BetweenFactorPoint3:
    """Return a random walk between two gyroscope biases (3-vectors or `Point3`).

    A graph whose bias is an `imuBias.ConstantBias` has its own walk (`CombinedImuFactor`,
    `BetweenFactorConstantBias`) and needs no other.

    Args:
        first_key, second_key: keys of the two nodes.
        elapsed: s between the two nodes.
        sigma: rad/s per √hour, one or three.
    """
    return gtsam.BetweenFactorPoint3(
        first_key, second_key, np.zeros(3), _grown((first_key, second_key), sigma, 3, elapsed)
    )


def _grown(keys: tuple[int, int], sigma: ArrayLike, size: int, elapsed: float) -> gtsam.noiseModel.Diagonal:
    """Return the noise model of a walk of `sigma` per √hour after `elapsed` s."""
    if keys[0] == keys[1]:
        raise MagycError(
            "random walk: it joins two nodes, and both keys are the same; give the key of the next node"
        )
    deviation: Array = np.broadcast_to(np.asarray(sigma, dtype=float), (size,)) * np.sqrt(
        (elapsed if is_positive(elapsed) else 0.0) / _HOUR
    )
    if not (np.isfinite(deviation).all() and (deviation > 0).all()):
        raise MagycError(
            f"random walk of {np.asarray(sigma).tolist()} per √hour over {elapsed!r:.40} s; both must be finite "
            "and above 0 (a calibration that does not change needs one node, or a walk too small to matter)"
        )
    return gtsam.noiseModel.Diagonal.Sigmas(deviation)
