"""Linear algebra of small matrices, without the overhead of `np.linalg`, which exceeds its cost."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.linalg.lapack import dgesdd, dgesv, dpotrf, dsyevd, dtrtri

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import SingularError


def solved(matrix: Array, right: Array) -> Array:
    """Return the solution x (k,) of matrix (k, k) · x = right (k,).

    Raises:
        SingularError: the matrix is singular.
    """
    if not len(right):
        return right
    _, _, result, failed = dgesv(matrix, right)
    if failed:
        raise SingularError("the solution")
    return np.asarray(result)


@cache
def _identity(size: int) -> Array:
    return np.eye(size)


def inverse(matrix: Array) -> Array:
    """Return the inverse of a matrix (k, k).

    Raises:
        SingularError: the matrix is singular.
    """
    _, _, result, failed = dgesv(matrix, _identity(len(matrix)))
    if failed:
        raise SingularError("the solution")
    return np.asarray(result)


def inverse_root(matrix: Array) -> Array | None:
    """Return the inverse (k, k) of the Cholesky factor of a symmetric matrix; None if it is not positive definite.

    The inverse of the matrix is its transpose times itself.
    """
    if not len(matrix):
        return matrix  # LAPACK prints an error of it
    root, failed = dpotrf(matrix, lower=1)
    return None if failed else np.asarray(dtrtri(root, lower=1)[0])


def eigenvectors(matrix: Array) -> tuple[Array, Array]:
    """Return the ascending eigenvalues (k,) of a symmetric matrix (k, k), and its eigenvectors in columns.

    Raises:
        SingularError: the matrix is not finite.
    """
    value, vector, failed = dsyevd(matrix, lower=1)
    if failed:
        raise SingularError("the eigenvalues")
    return value, vector


def singular_vectors(matrix: Array) -> tuple[Array, Array]:
    """Return the descending singular values (k,) of a matrix (k, k), and its right singular vectors as rows.

    Raises:
        SingularError: the matrix is not finite.
    """
    _, value, vector, failed = dgesdd(matrix)
    if failed:
        raise SingularError("the singular values")
    return value, vector
