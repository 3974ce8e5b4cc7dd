"""Banded Cholesky factors: solutions for many columns at a time, and the diagonal blocks of an inverse."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpbtrf, ztbtrs

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array, Complex


@dataclass(frozen=True, eq=False)
class BandFactor:
    """A Cholesky factor L in the form that the solutions need.

    Attributes:
        columns: (m, 4) its columns from the diagonal down.
        inverse: (m,) reciprocals of its diagonal D.
    """

    columns: Array
    inverse: Array

    @classmethod
    def of(cls, factor: Array) -> BandFactor:
        """Take the factor L (4, m), in lower form with the diagonal first."""
        return cls(np.ascontiguousarray(factor.T), 1 / factor[0])

    @cached_property
    def unit(self) -> Complex:
        """U (4, m) of L = U D, complex, with unit diagonal."""
        unit = np.empty(self.columns.shape[::-1], complex, order="F")
        unit.imag = 0.0
        np.multiply(self.columns.T, self.inverse, out=unit.real)
        return unit


def forward_solved(factor: BandFactor, border: Array) -> Array:
    """Return L⁻¹ c (k, 2n) for columns c, given by the two tangents of each window (k, 2, n).

    In numpy two columns are solved at a time, as real and imaginary part: LAPACK processes one column after the other
    in a short loop of calls, so that a complex column costs little more than a real one. The unit diagonal saves a
    division per entry.
    """
    count, _, n = border.shape
    if compiled.loops:
        result = np.empty((count, 2 * n))
        compiled.loops.forward(n, factor.columns, factor.inverse, compiled.given(border), result)
        return result
    pairs, rest = -(-count // 2), count // 2
    both = np.empty((pairs, n, 2), complex)
    if rest < pairs:
        both.imag[-1] = 0.0
    for a in (0, 1):  # one tangent at a time; both together would loop over two numbers
        both.real[:, :, a], both.imag[:rest, :, a] = border[:pairs, a], border[pairs:, a]
    both = both.reshape(pairs, 2 * n)
    ztbtrs(factor.unit, both.T, uplo="L", diag="U", overwrite_b=1)
    result = np.empty((count, 2 * n))
    np.multiply(both.real, factor.inverse, out=result[:pairs])
    np.multiply(both.imag[:rest], factor.inverse, out=result[pairs:])
    return result


def backward_solved(factor: BandFactor, columns: Array) -> Array:
    """Return L⁻ᵀ c (k, 2, n) for columns c (k, 2n), in the same way."""
    count, size = columns.shape
    if compiled.loops:
        result = np.empty((count, 2, size // 2))
        compiled.loops.backward(size // 2, factor.columns, factor.inverse, compiled.given(columns), result)
        return result
    pairs, rest = -(-count // 2), count // 2
    both = np.empty((pairs, size), complex)
    if rest < pairs:
        both.imag[-1] = 0.0
    np.multiply(columns[:pairs], factor.inverse, out=both.real)
    np.multiply(columns[pairs:], factor.inverse, out=both.imag[:rest])
    ztbtrs(factor.unit, both.T, uplo="L", trans="T", diag="U", overwrite_b=1)
    both = both.reshape(pairs, -1, 2)
    result = np.empty((count, 2, size // 2))
    for a in (0, 1):
        result[:pairs, a], result[pairs:, a] = both.real[:, :, a], both.imag[:rest, :, a]
    return result


def inverse_blocks(band: Array, factor: Array) -> tuple[Array, Array, Array]:
    """Return the diagonal 2×2 blocks of the inverse: entries 00, 01, 11, (n,) each.

    They are (D_f + D_b − D)⁻¹ with the forward and the backward Schur complements D_f and D_b, each taken from one
    banded factorisation.

    Args:
        band: (4, 2n), lower form, diagonal first.
        factor: its Cholesky factor, in the same form.
    """
    forward = _schur_blocks(factor)
    backward = _schur_blocks(dpbtrf(_reversed_band(band), lower=1)[0])
    s00 = forward[0] + backward[2][::-1] - band[0, ::2]
    s01 = forward[1] + backward[1][::-1] - band[1, ::2]
    s11 = forward[2] + backward[0][::-1] - band[0, 1::2]
    determinant = s00 * s11 - s01 * s01
    return s11 / determinant, -s01 / determinant, s00 / determinant


def _schur_blocks(factor: Array) -> tuple[Array, Array, Array]:
    """Return the 2×2 blocks L_nn L_nnᵀ of a banded Cholesky factor: their entries 00, 01, 11, (n,) each."""
    a, b, c = factor[0, ::2], factor[1, ::2], factor[0, 1::2]
    return a * a, a * b, b * b + c * c


def _reversed_band(band: Array) -> Array:
    """Return the band of the matrix with rows and columns in reverse order."""
    result = np.zeros(band.shape, order="F")
    size = band.shape[1]
    for below in range(4):
        result[below, : size - below] = band[below, : size - below][::-1]
    return result
