"""Banded factors: many columns at a time, and the diagonal blocks of an inverse."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpbtrf, ztbtrs

from magyc_gtsam.factors.chain.rotations import Array


def solved(factor: Array, columns: Array, transposed: bool = False) -> Array:
    """L⁻¹ c, or L⁻ᵀ c, of columns c (k, m), a row each.

    Two at a time, as real and imaginary part: LAPACK takes one column after the other through a short loop of calls,
    so that a complex one costs little more than a real one.

    Args:
        factor: (4, m) Cholesky factor L, lower form, diagonal first; complex where it is used often.
    """
    pairs = -(-len(columns) // 2)
    both = np.zeros((pairs, columns.shape[1]), complex)
    both.real, both.imag[: len(columns) - pairs] = columns[:pairs], columns[pairs:]
    ztbtrs(factor.astype(complex, copy=False), both.T, uplo="L", trans="T" if transposed else "N", overwrite_b=1)
    result: Array = np.concatenate([both.real, both.imag[: len(columns) - pairs]])
    return result


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
