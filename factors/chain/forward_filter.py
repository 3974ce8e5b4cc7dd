"""The forward filter of a field chain, taken from its banded factorisation, and the innovations of its windows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.banded import BandFactor, forward_solved
from magyc_gtsam.factors.chain.chain_values import Reduced
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError

_VAGUE = 1e-4  # rad⁻², information of a direction before any observation
_AT_ONCE = 50_000  # numbers per axis filtered at once, so that they stay in the processor's cache


class ForwardFilter(NamedTuple):
    """The forward filter of a factorised chain.

    before, after (3, 2, n − 1): whitened link Jacobians on its two directions; factor: banded Cholesky factor; unit:
    the factor in the form that the solutions need; below (2, 2, n − 1): its off-diagonal blocks L_{n,n−1}; ahead (2,
    2, n): covariance of the predictions; seen (3, 2, n): window Jacobians; scatter, whitener (3, 3, n): innovation
    covariance and its inverse square root; from_half (2, 3, n − 1), from_link (3, 3, n − 1): contributions to the
    whitened innovations from L⁻¹ c of the preceding window and from the link to it, with the input along the first
    axis.
    """

    before: Array
    after: Array
    factor: Array
    unit: BandFactor
    below: Array
    ahead: Array
    seen: Array
    scatter: Array
    whitener: Array
    from_half: Array
    from_link: Array

    @classmethod
    def of(cls, chain: FieldChain, reduced: Reduced, link_weight: Array | None = None) -> ForwardFilter:
        """Build the filter of a chain linearised at `reduced`, whose links had robust weights (n − 1,)."""
        n = len(chain.windows)
        scale = chain.link_scale if link_weight is None else chain.link_scale * np.sqrt(link_weight)
        factor = reduced.factor
        below = np.empty((2, 2, n - 1))
        below[0, 0], below[0, 1] = factor[2, :-2:2], factor[1, 1:-2:2]
        below[1, 0], below[1, 1] = factor[3, :-2:2], factor[2, 1:-2:2]
        information: Array = np.zeros((2, 2, n))
        information[..., 1:] = -np.einsum("acn,bcn->abn", below, below)
        information[[0, 1], [0, 1], 1:] += scale**2
        information[[0, 1], [0, 1]] += _VAGUE
        ahead = _inverse(information)
        seen = reduced.on_direction
        seen_ahead = np.einsum("ian,abn->ibn", seen, ahead)
        scatter = np.eye(3)[:, :, None] + np.einsum("ibn,jbn->ijn", seen_ahead, seen)
        whitener = _whitener(seen, ahead)
        before, after = -reduced.basis[:, :, :-1] * scale, reduced.basis[:, :, 1:] * scale
        gain = np.einsum("ijn,jbn->ibn", whitener[..., 1:], seen_ahead[..., 1:])
        return cls(
            np.ascontiguousarray(before),
            np.ascontiguousarray(after),
            factor,
            BandFactor.of(factor),
            below,
            ahead,
            np.ascontiguousarray(seen),
            scatter,
            whitener,
            np.einsum("ian,abn->bin", gain, below),
            -np.einsum("ian,jan->jin", gain, after),
        )

    def of_units(self, window_scale: Array, link_scale: Array) -> ForwardFilter:
        """Return the same filter for windows in T and links in rad, given the reciprocal sigmas (n,) and (n − 1,)."""
        return self._replace(
            before=self.before * link_scale,
            after=self.after * link_scale,
            seen=self.seen * window_scale,
            whitener=self.whitener * window_scale,
            from_link=self.from_link * link_scale,
        )

    def __call__(self, window: Array, link: Array | None) -> Array:
        """Return the whitened innovations (p, 3, n) of windows (p, 3, n) and links (p, 3, n − 1), whitened by their
        sigmas.
        """
        p, _, n = window.shape
        result = np.empty((p, 3, n))
        if compiled.loops:
            data, own = (window, link, self.seen, self.before, self.after), (self.unit.columns, self.unit.inverse)
            parts = (*data, *own, self.whitener, self.from_half, self.from_link)
            compiled.loops.innovations(n, *map(compiled.given, parts), result)
            return result
        rows = max(_AT_ONCE // n, 1)
        for first in range(0, p, rows):
            part = slice(first, first + rows)
            some, innovation, links = window[part], result[part], None if link is None else link[part]
            half = self._half(some, links)[:, :, :-1]
            _onto(self.whitener, some, innovation)
            innovation[..., 1:] += _onto(self.from_half, half)
            if links is not None:
                innovation[..., 1:] += _onto(self.from_link, links)
        return result

    def filtered(self, window: Array, link: Array) -> tuple[Array, Array]:
        """Return the tangent steps (2, n) to the filtered directions, and their covariance (2, 2, n)."""
        predicted = np.einsum("ian,in->an", self.seen, window)
        half = self._half(window[None], link[None])[0]
        predicted[:, 1:] += np.einsum("ian,in->an", self.after, link)
        predicted[:, 1:] -= np.einsum("abn,bn->an", self.below, half[:, :-1])
        information = np.linalg.inv(np.moveaxis(self.ahead, 2, 0))
        information += np.moveaxis(np.einsum("ian,ibn->abn", self.seen, self.seen), 2, 0)
        covariance = np.moveaxis(np.linalg.inv(information), 0, 2)
        return -np.einsum("abn,bn->an", covariance, predicted), covariance

    def _half(self, window: Array, link: Array | None) -> Array:
        """Return L⁻¹ c (p, 2, n)."""
        right = _onto(self.seen, window)
        if link is not None:
            right[..., 1:] += _onto(self.after, link)
            right[..., :-1] += _onto(self.before, link)
        half = forward_solved(self.unit, right).reshape(len(right), -1, 2)
        return np.ascontiguousarray(np.swapaxes(half, 1, 2))


def _whitener(seen: Array, ahead: Array) -> Array:
    """Return the inverse square root (3, 3, n) of I + S P Sᵀ, of Jacobians S (3, 2, n) and covariances P (2, 2, n).

    With B = I + P SᵀS, which has the same eigenvalues but for one of 1, it is I − S (B + √B)⁻¹ P Sᵀ. The root of a
    matrix of two by two is (B + √|B| I) / √(tr B + 2 √|B|) (Cayley and Hamilton).

    Raises:
        MagycError: I + S P Sᵀ is not positive definite, or its rounding is no less than I, the readings' own noise.
    """
    unit = np.eye(2)[:, :, None]
    with np.errstate(over="ignore", invalid="ignore"):
        square = np.einsum("ian,ibn->abn", seen, seen)
        more = np.einsum("abn,bcn->acn", ahead, square)
        trace = more[0, 0] + more[1, 1]
        determinant = 1 + trace + _determinant(ahead) * _determinant(square)
    of_noise = (trace > -2) & (trace * np.finfo(float).eps < 1)
    if not (np.isfinite(determinant) & (determinant > 0) & of_noise).all():
        raise MagycError("the innovations of the model have no finite covariance: a term is out of range")
    root, both = np.sqrt(determinant), unit + more
    share = _inverse(both + (both + root * unit) / np.sqrt(2 + trace + 2 * root))
    less = np.einsum("ian,abn->ibn", seen, np.einsum("abn,bcn->acn", share, ahead))
    result: Array = np.eye(3)[:, :, None] - np.einsum("ibn,jbn->ijn", less, seen)
    return result


def _determinant(matrix: Array) -> Array:
    """Return the determinants (n,) of matrices (2, 2, n)."""
    result: Array = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    return result


def _inverse(matrix: Array) -> Array:
    """Return the inverses of matrices (2, 2, n)."""
    adjugate = np.array([[matrix[1, 1], -matrix[0, 1]], [-matrix[1, 0], matrix[0, 0]]])
    result: Array = adjugate / _determinant(matrix)
    return result


def _onto(matrix: Array, columns: Array, out: Array | None = None) -> Array:
    """Return the products (p, b, n) of columns (p, a, n) with matrices (a, b, n)."""
    result: Array = np.einsum("pan,abn->pbn", columns, matrix, out=out)
    return result
