"""Sphere-constrained measurement of the Autocal paper, eq. (7): r = K x̂ + h − m, x̂ a `Unit3`.

The field strength is folded into K = F·A. The paper takes K upper triangular, because without a
gyroscope a rotation of K cannot be told from one of the directions; with one, K is symmetric.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Array, Noise, Residual, custom_factor, direction, measured, vector
from magyc_gtsam.factors.soft_iron import SYMMETRIC_UNITS

_FULL_UNITS = np.eye(9).reshape(9, 3, 3)

SHAPES = {
    "symmetric": SYMMETRIC_UNITS,
    "triangular": np.triu(SYMMETRIC_UNITS),
    "full": _FULL_UNITS,
}
"""Unit matrices U_j of each form of K = Σ k_j U_j, (6 or 9, 3, 3); entries run row by row."""


def sphere_error(
    units: Array, measurement: Array, k: Array, h: Array, x: Array, want_jacobians: bool = False
) -> Residual:
    """Eq. (7) and its Jacobians (18) to (20) on k, h and x̂: (3,), and (3, len(k)), (3, 3), (3, 3)."""
    matrix = (k @ units.reshape(len(k), 9)).reshape(3, 3)
    residual = matrix @ x + h - measurement
    return residual, [(units @ x).T, np.eye(3), matrix] if want_jacobians else []


def sphere_factor(
    keys: Sequence[int], measurement: ArrayLike, noise: Noise, *, shape: str = "symmetric"
) -> gtsam.CustomFactor:
    """One measured field m = K x̂ + h on (k, h, x̂).

    Args:
        keys: of k (6-vector, or 9 for "full"), h (3-vector or `Point3`) and x̂ (`Unit3`).
        measurement: (3,), in the unit of K and h.
        noise: standard deviation per axis, or a noise model of 3 rows, e.g. `robust_noise`.
        shape: of K, "symmetric", "triangular" (upper) or "full".

    Raises:
        MagycError: unknown shape, or a measurement that is not three finite numbers.
    """
    if shape not in SHAPES:
        raise MagycError(f"sphere factor: shape {shape!r} unknown; there are {', '.join(SHAPES)}")
    units, m = SHAPES[shape], measured("measurement", measurement, (3,))

    def error(k: Array, h: Array, x: Array, want_jacobians: bool) -> Residual:
        return sphere_error(units, m, k, h, x, want_jacobians)

    return custom_factor("sphere", noise, keys, [vector(len(units)), vector(3), direction], 3, error)
