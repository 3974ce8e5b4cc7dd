"""The inverse of a block-tridiagonal matrix of 2×2 blocks, where only its diagonal blocks are wanted."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpbtrf

from magyc_gtsam.factors.chain.rotations import Array


def inverse_blocks(band: Array, factor: Array) -> tuple[Array, Array, Array]:
    """The diagonal 2×2 blocks of the inverse: entries 00, 01, 11, (n,) each.

    They are (D_f + D_b − D)⁻¹ with the forward and the backward Schur complements, each read off one
    banded factorisation.

    Args:
        band: (4, 2n), lower form, diagonal first.
        factor: its Cholesky factor, likewise.
    """
    forward = _schur_blocks(factor)
    backward = _schur_blocks(dpbtrf(_reversed_band(band), lower=1)[0])
    s00 = forward[0] + backward[2][::-1] - band[0, ::2]
    s01 = forward[1] + backward[1][::-1] - band[1, ::2]
    s11 = forward[2] + backward[0][::-1] - band[0, 1::2]
    determinant = s00 * s11 - s01 * s01
    return s11 / determinant, -s01 / determinant, s00 / determinant


def _schur_blocks(factor: Array) -> tuple[Array, Array, Array]:
    """The 2×2 blocks L_nn L_nnᵀ of a banded Cholesky factor: their entries 00, 01, 11, (n,) each."""
    a, b, c = factor[0, ::2], factor[1, ::2], factor[0, 1::2]
    return a * a, a * b, b * b + c * c


def _reversed_band(band: Array) -> Array:
    """The band of the matrix with rows and columns in reverse order."""
    result = np.zeros(band.shape, order="F")
    size = band.shape[1]
    for below in range(4):
        result[below, : size - below] = band[below, : size - below][::-1]
    return result
