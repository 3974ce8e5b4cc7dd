"""The soft iron's inverse as a vector l = vech(C), and the priors that keep it away from C = 0."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Array, Noise, Residual, custom_factor, vector

_UPPER = np.triu_indices(3)

SYMMETRIC_UNITS = np.zeros((6, 3, 3))
"""The six symmetric unit matrices E_j: unvech(l) = Σ l_j E_j."""
SYMMETRIC_UNITS[np.arange(6), _UPPER[0], _UPPER[1]] = 1.0
SYMMETRIC_UNITS[np.arange(6), _UPPER[1], _UPPER[0]] = 1.0
SYMMETRIC_UNITS.flags.writeable = False


def vech(matrix: ArrayLike) -> Array:
    """Upper triangle of symmetric matrices (..., 3, 3), row by row: (..., 6)."""
    array = np.asarray(matrix, dtype=np.float64)
    if array.shape[-2:] != (3, 3):
        raise MagycError(f"vech: shape {array.shape}, expected (..., 3, 3)")
    return array[..., _UPPER[0], _UPPER[1]]


def unvech(vector6: ArrayLike) -> Array:
    """Symmetric matrices (..., 3, 3) from their upper triangles (..., 6); the inverse of `vech`."""
    array = np.asarray(vector6, dtype=np.float64)
    if array.shape[-1:] != (6,):
        raise MagycError(f"unvech: shape {array.shape}, expected (..., 6)")
    result = np.empty((*array.shape[:-1], 3, 3))
    result[..., _UPPER[0], _UPPER[1]] = array
    result[..., _UPPER[1], _UPPER[0]] = array
    return result


def norm_error(l: Array, want_jacobians: bool = False) -> Residual:  # noqa: E741
    """Eq. (9) and (10) of the MAGYC paper: ‖l‖ − 1 (1,), Jacobian lᵀ/‖l‖ (1, 6)."""
    norm = float(np.sqrt(l @ l))
    if norm == 0:
        raise MagycError("norm prior: it has no derivative at l = 0; start from another soft iron")
    return np.array([norm - 1.0]), [l[None, :] / norm] if want_jacobians else []


def determinant_error(l: Array, want_jacobians: bool = False) -> Residual:  # noqa: E741
    """det C − 1 (1,), Jacobian (1, 6): the cofactors, those off the diagonal twice."""
    c = unvech(l)
    cofactors = np.cross(c[[1, 2, 0]], c[[2, 0, 1]])
    residual = np.array([c[0] @ cofactors[0] - 1.0])
    return residual, [np.tensordot(SYMMETRIC_UNITS, cofactors)[None, :]] if want_jacobians else []


def norm_prior(key: int, noise: Noise) -> gtsam.CustomFactor:
    """Factor ‖l‖ = 1 on a 6-vector, eq. (9); without it C = 0, d = 0 solves residual (7)."""
    return custom_factor("norm prior", noise, [key], [vector(6)], 1, norm_error)


def determinant_prior(key: int, noise: Noise) -> gtsam.CustomFactor:
    """Factor det C = 1 on a 6-vector, the scale that the authors' later package fixes."""
    return custom_factor("determinant prior", noise, [key], [vector(6)], 1, determinant_error)
