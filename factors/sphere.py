"""Sphere-constrained measurement of the Autocal paper, eq. (7): r = K x̂ + h − m, x̂ a `Unit3`.

The field strength is absorbed into K = F·A. The paper takes K upper triangular, because without a gyroscope a
rotation of K is equivalent to a rotation of the directions; with a gyroscope, K is symmetric.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Noise, Residual, custom_factor, measured
from magyc_gtsam.factors.variables import Array, direction, vector

_FULL_UNITS = np.eye(9).reshape(9, 3, 3)

SHAPES = {
    "symmetric": SYMMETRIC_UNITS,
    "triangular": np.triu(SYMMETRIC_UNITS),
    "full": _FULL_UNITS,
}
"""Unit matrices U_j of each form of K = Σ k_j U_j, (6 or 9, 3, 3), in row-major order of the entries."""


def sphere_error(
    units: Array, measurement: Array, x: Array, k: Array, h: Array, want_jacobians: bool = False
) -> Residual:
    """Return residual (7) (3,), and its Jacobians (18) to (20) on x̂, k and h: (3, 3), (3, len(k)), (3, 3)."""
    matrix = (k @ units.reshape(len(k), 9)).reshape(3, 3)
    residual = matrix @ x + h - measurement
    return residual, [matrix, (units @ x).T, np.eye(3)] if want_jacobians else []


def sphere_factor(
    direction_key: int,
    soft_iron_key: int,
    hard_iron_key: int,
    measurement: ArrayLike,
    noise: Noise,
    *,
    shape: str = "symmetric",
) -> gtsam.CustomFactor:
    """Return a factor of one measured field m = K x̂ + h on (x̂, k, h).

    Args:
        direction_key: x̂, `Unit3`.
        soft_iron_key: k, 6-vector, or 9-vector for "full".
        hard_iron_key: h, 3-vector or `Point3`.
        measurement: (3,), in the unit of K and h.
        noise: standard deviation per axis, or a noise model of 3 rows, e.g. `robust_noise`.
        shape: form of K, "symmetric", "triangular" (upper) or "full".

    Raises:
        MagycError: unknown shape, or a measurement that is not three finite numbers.
    """
    if not isinstance(shape, str) or shape not in SHAPES:
        raise MagycError(f"sphere factor: shape {shape!r} unknown; there are {', '.join(SHAPES)}")
    units, m = SHAPES[shape], measured("measurement", measurement, (3,))

    def error(x: Array, k: Array, h: Array, want_jacobians: bool) -> Residual:
        return sphere_error(units, m, x, k, h, want_jacobians)

    keys = (direction_key, soft_iron_key, hard_iron_key)
    return custom_factor("sphere", noise, keys, [direction, vector(len(units)), vector(3)], 3, error)
