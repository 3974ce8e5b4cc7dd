"""The forward filter of a field chain, read off its banded factorisation : what is new in each window."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dtbtrs

from magyc_gtsam.factors.chain.chain_values import Reduced
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rate_columns import turned_by
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError

_VAGUE = 1e-4  # rad⁻², information of a direction before anything was seen of it


class ForwardFilter(NamedTuple):
    """The forward filter of a factorised chain.

    before, after (3, 2, n − 1): whitened link Jacobians on its two directions; factor: banded Cholesky factor;
    below (2, 2, n − 1): its off-diagonal blocks L_{n,n−1}; ahead (2, 2, n): covariance of the predictions;
    seen (3, 2, n): window Jacobians; scatter, whitener (3, 3, n): innovation covariance and its inverse root.
    """

    before: Array
    after: Array
    factor: Array
    below: Array
    ahead: Array
    seen: Array
    scatter: Array
    whitener: Array

    @classmethod
    def of(cls, chain: FieldChain, reduced: Reduced, link_weight: Array | None = None) -> ForwardFilter:
        """Of a chain linearised at `reduced`, whose links had robust weights (n − 1,)."""
        n = len(chain.windows)
        scale = chain.link_scale if link_weight is None else chain.link_scale * np.sqrt(link_weight)
        factor = reduced.factor
        below = np.empty((2, 2, n - 1))
        below[0, 0], below[0, 1] = factor[2, :-2:2], factor[1, 1:-2:2]
        below[1, 0], below[1, 1] = factor[3, :-2:2], factor[2, 1:-2:2]
        information: Array = np.zeros((n, 2, 2))
        information[1:] = np.moveaxis(-np.einsum("acn,bcn->abn", below, below), 2, 0)
        information[1:, [0, 1], [0, 1]] += scale[:, None] ** 2
        information[:, [0, 1], [0, 1]] += _VAGUE
        ahead: Array = np.asarray(np.linalg.inv(information), dtype=float).transpose(1, 2, 0)
        seen = reduced.on_direction
        scatter = np.eye(3)[:, :, None] + np.einsum("ian,abn,jbn->ijn", seen, ahead, seen)
        finite = bool(np.isfinite(scatter).all())
        if finite:
            value, vector = np.linalg.eigh(np.moveaxis(scatter, 2, 0))
        if not finite or value.min() <= 0:
            raise MagycError("the innovations of the model have no finite covariance: a term is out of range")
        whitener = np.moveaxis((vector / np.sqrt(value)[:, None]) @ np.swapaxes(vector, 1, 2), 0, 2)
        return cls(
            -reduced.basis[:, :, :-1] * scale,
            reduced.basis[:, :, 1:] * scale,
            factor,
            below,
            ahead,
            seen,
            scatter,
            whitener,
        )

    def __call__(self, window: Array, link: Array | None) -> Array:
        """Whitened innovations (p, 3, n) of windows (p, 3, n) and links (p, 3, n − 1), whitened by their sigmas."""
        predicted, _ = self._passed(window, link)
        ahead = turned_by(self.ahead, predicted)
        for i in range(3):
            window[:, i] -= self.seen[i, 0] * ahead[:, 0] + self.seen[i, 1] * ahead[:, 1]
        return turned_by(self.whitener, window)

    def filtered(self, window: Array, link: Array) -> tuple[Array, Array]:
        """Tangent steps (2, n) to the filtered directions, and their covariance (2, 2, n)."""
        predicted, _ = self._passed(window[None], link[None])
        vector = predicted[0] + np.einsum("ian,in->an", self.seen, window)
        information = np.linalg.inv(np.moveaxis(self.ahead, 2, 0))
        information += np.moveaxis(np.einsum("ian,ibn->abn", self.seen, self.seen), 2, 0)
        covariance = np.moveaxis(np.linalg.inv(information), 0, 2)
        return -np.einsum("abn,bn->an", covariance, vector), covariance

    def _passed(self, window: Array, link: Array | None) -> tuple[Array, Array]:
        """The predictions' information vectors (p, 2, n), and z = L⁻¹ c."""
        p, _, n = window.shape
        right = np.zeros((p, n, 2))
        for a in (0, 1):
            right[:, :, a] = _along(self.seen[:, a], window)
            if link is not None:
                right[:, 1:, a] += _along(self.after[:, a], link)
                right[:, :-1, a] += _along(self.before[:, a], link)
        half, _ = dtbtrs(self.factor, right.reshape(p, 2 * n).T, uplo="L")
        half = half.T.reshape(p, n, 2)
        predicted = np.zeros((p, 2, n))
        for a in (0, 1):
            predicted[:, a, 1:] = -(self.below[a, 0] * half[:, :-1, 0] + self.below[a, 1] * half[:, :-1, 1])
            if link is not None:
                predicted[:, a, 1:] += _along(self.after[:, a], link)
        return predicted, half


def _along(vector: Array, columns: Array) -> Array:
    """(p, n) products of vectors (3, n) with columns (p, 3, n); faster than einsum."""
    result: Array = vector[0] * columns[:, 0]
    result += vector[1] * columns[:, 1]
    result += vector[2] * columns[:, 2]
    return result
