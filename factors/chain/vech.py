"""Symmetric matrices as vectors: l = vech(C), the upper triangle row by row."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError

UPPER = np.triu_indices(3)  # rows and columns of the entries of a vector
ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")  # their names
MULTIPLICITY = np.where(
    UPPER[0] == UPPER[1], 1.0, 2.0
)  # entries of the matrix that each entry of a vector stands for
_WHOLE = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # index of each entry of the matrix in the vector

SYMMETRIC_UNITS = np.zeros((6, 3, 3))
"""The six symmetric unit matrices E_j: unvech(l) = Σ l_j E_j."""
SYMMETRIC_UNITS[np.arange(6), UPPER[0], UPPER[1]] = 1.0
SYMMETRIC_UNITS[np.arange(6), UPPER[1], UPPER[0]] = 1.0
SYMMETRIC_UNITS.flags.writeable = False


def vech(matrix: ArrayLike) -> Array:
    """Return the upper triangle of symmetric matrices (..., 3, 3), row by row: (..., 6)."""
    array = np.asarray(matrix, dtype=np.float64)
    if array.shape[-2:] != (3, 3):
        raise MagycError(f"vech: shape {array.shape}, expected (..., 3, 3)")
    return array[..., UPPER[0], UPPER[1]]


def unvech(vector6: ArrayLike) -> Array:
    """Return the symmetric matrices (..., 3, 3) of their upper triangles (..., 6); the inverse of `vech`."""
    array = np.asarray(vector6, dtype=np.float64)
    if array.shape[-1:] != (6,):
        raise MagycError(f"unvech: shape {array.shape}, expected (..., 6)")
    return array.take(_WHOLE, axis=-1)
