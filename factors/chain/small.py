"""Solutions of small linear systems, without the overhead of `np.linalg.solve`, which exceeds their cost."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgesv

from magyc_gtsam.factors.chain.rotations import Array


def solved(matrix: Array, right: Array) -> Array:
    """Return the solution x (k,) of matrix (k, k) · x = right (k,).

    Raises:
        np.linalg.LinAlgError: the matrix is singular.
    """
    if not len(right):
        return right
    _, _, result, failed = dgesv(matrix, right)
    if failed:
        raise np.linalg.LinAlgError("Singular matrix")
    return np.asarray(result)
