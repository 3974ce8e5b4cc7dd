"""Random walks of a slowly changing calibration, between nodes at intervals.

The variance of changes such as those of an ageing battery, a moved payload or a warming sensor grows with time; it is
stated as a standard deviation after one hour (per √hour). The factors are GTSAM's own `BetweenFactor`s, so that no
Python runs inside the optimiser.

Several nodes also keep iSAM2 fast where the calibration is constant: iSAM2 visits every factor of every variable that
an update affects, so that one pair of keys under n factors costs n per update (docs/slam.md).
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_positive
from magyc_gtsam.factors.pose import MICROTESLA
from magyc_gtsam.factors.units import check_readings
from magyc_gtsam.factors.variables import Array

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
