"""Square root of the information that a stated covariance of soft and hard iron contains."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import real_array
from magyc_gtsam.factors.units import check_readings
from magyc_gtsam.factors.variables import Array

_SINGULAR = 1e-9  # smallest eigenvalue of the correlations
# Largest difference of the two triangles, in correlations. Rounding stays far below it even where an inverse is nearly
# singular; correlations below it may as well be 0.
_ASYMMETRY = 1e-3


def root_information(name: str, covariance: ArrayLike, field_unit: float) -> Array:
    """Return W (9, 9) with WᵀW the inverse of a covariance, the hard iron in `field_unit`.

    Args:
        name: name of the factor, for error messages.
        covariance: (9, 9) or larger, of vech(soft iron) and hard iron in T; further rows and columns are ignored.
        field_unit: T.

    Raises:
        MagycError: no numbers, another shape, not symmetric, singular, or a hard iron that is not in T.
    """
    try:
        stated = real_array(covariance)
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: covariance is not an array of numbers ({error})") from None
    if stated.ndim != 2 or min(stated.shape) < 9:
        raise MagycError(
            f"{name}: a covariance of shape {stated.shape}, expected (9, 9) or larger; some methods give "
            "none, `smoother` does"
        )
    unit = np.concatenate([np.ones(6), np.full(3, field_unit)])
    spread = stated[:9, :9] / unit / unit[:, None]
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    correlation = spread / scale / scale[:, None]
    if np.isfinite(spread).all():
        _check_symmetric(name, stated, np.abs(correlation - correlation.T))
    if not np.isfinite(spread).all() or np.linalg.eigvalsh(correlation)[0] < _SINGULAR:
        raise MagycError(
            f"{name}: the covariance is singular, as where the soft iron's determinant is fixed at 1; "
            "calibrate with `field_strength` given, or leave that constraint to the graph"
        )
    check_readings(f"{name}: standard deviation of the hard iron", scale[6:] * field_unit)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(correlation)) / scale)


def _check_symmetric(name: str, stated: Array, difference: Array) -> None:
    if difference.max() > _ASYMMETRY:
        i, j = (int(at) for at in np.unravel_index(difference.argmax(), difference.shape))
        raise MagycError(
            f"{name}: a covariance that is not symmetric: {stated[i, j]:.4g} in row {i}, column {j}, but "
            f"{stated[j, i]:.4g} in row {j}, column {i}; fill both triangles"
        )
