"""What is new to a fit in columns that its model lacks, and by how much each of them moves the parameters.

At its minimum a field chain leaves r = J δ − X β, with columns X of the reading and of the gyroscope's links that are
not in the model, all whitened. With P what is left of a column when directions and parameters have explained of it
what they can,

    G = Xᵀ P X,   s = −Xᵀ P r,   β̂ = G⁻¹ s,    and where X stays out, each unit of β moves θ by S = H⁻¹ Jᵀ X.

Products are all that is needed, and the elimination of the fit has half of them: with L Lᵀ the directions' matrix, C
the directions' Jacobian against columns and Z = L⁻¹ C, directions leave XᵀX − ZᵀZ. Columns and parameters are taken
through the same steps, so that their joint matrix has no negative direction but for rounding, for which all have a
trace of information of their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dtrtrs

from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.factors.chain.banded import solved
from magyc_gtsam.factors.chain.rotations import Array

_ROUNDING = (
    1e-12  # of a column's square before anything explains it, the information it is given; rounding is 1e-15
)


class Columns(NamedTuple):
    """Unmodelled columns per unit: of the windows (k, 3, n) T, of the links (k, 3, n − 1) rad; None is zero."""

    window: Array | None
    link: Array | None

    def less(self, other: Columns) -> Columns:
        """By how much each differs from another's on the same sensors."""
        window = None if self.window is None or other.window is None else self.window - other.window
        link = None if self.link is None or other.link is None else self.link - other.link
        return Columns(window, link)

    def only(self, kept: np.ndarray) -> Columns:
        """With zeros in place of those that are not kept, (k,) bool."""
        share = kept[:, None, None]
        return Columns(
            None if self.window is None else share * self.window, None if self.link is None else share * self.link
        )


class New(NamedTuple):
    """Columns beside the model.

    normal (k, k) G; score (k,) s; window (k, 3n) and link (k, 3n − 3) whitened; absorbed (2n, k): Z;
    explained (free, k): the same of the parameters.
    """

    normal: Array
    score: Array
    window: Array | None
    link: Array | None
    absorbed: Array
    explained: Array

    def across(self, other: New) -> Array:
        """(k, l) the block of G between these columns and others."""
        result: Array = -(self.absorbed.T @ other.absorbed) - self.explained.T @ other.explained
        if self.window is not None and other.window is not None:
            result += self.window @ other.window.T
        if self.link is not None and other.link is not None:
            result += self.link @ other.link.T
        return result


@dataclass(frozen=True, eq=False)
class Beside:
    """The products of columns with one fit at its minimum."""

    fit: Fit

    @cached_property
    def freedom(self) -> float:
        """Degrees of freedom of the residual: a window that is weighed down counts for less."""
        fit = self.fit
        weights = fit.weights.window.sum() * 3 + fit.weights.link[fit.chain.windows.linked].sum() * 2
        return float(max(weights - 2 * len(fit.chain.windows) - fit.free.sum(), 1.0))

    @cached_property
    def square(self) -> float:
        """rᵀ P r, what the fit leaves."""
        left = self._left
        return float(np.vdot(left.window, left.window) + np.vdot(left.link, left.link)) - float(
            left.absorbed @ left.absorbed + left.explained @ left.explained
        )

    def of(self, columns: Columns) -> New:
        """What is new in columns."""
        return self.of_each([columns])[0]

    def of_each(self, groups: Sequence[Columns]) -> list[New]:
        """What is new in each of some small groups; those of one sensor are taken through the elimination together."""
        result: dict[int, New] = {}
        for sensors in {(group.window is None, group.link is None) for group in groups}:
            alike = [i for i, group in enumerate(groups) if (group.window is None, group.link is None) == sensors]
            result |= zip(alike, self._of_alike([groups[i] for i in alike]), strict=True)
        return [result[i] for i in range(len(groups))]

    def _of_alike(self, groups: Sequence[Columns]) -> Iterator[New]:
        """Of groups that are all on the same sensors."""
        reduced, left = self.fit.reduced, self._left
        size = len(reduced.information)
        window = _whitened([group.window for group in groups], self._window_scale)
        link = _whitened([group.link for group in groups], self._link_scale)
        absorbed = self._absorbed(window, link)
        pull = -(reduced.half[:, :size].T @ absorbed)
        score = absorbed.T @ left.absorbed
        if window is not None:
            window = window.reshape(len(window), -1)
            pull += reduced.on_parameters.reshape(size, -1) @ window.T
            score -= window @ left.window
        if link is not None:
            link = link.reshape(len(link), -1)
            pull[9:12] += self._on_bias @ link.T
            score -= link @ left.link
        explained = self._explained(pull)
        score += explained.T @ left.explained
        first = 0
        for group in groups:
            one = group.window if group.window is not None else group.link
            assert one is not None
            own = slice(first, first + len(one))
            first = own.stop
            own_absorbed, own_explained = absorbed[:, own], explained[:, own]
            of_window, of_link = (None if part is None else part[own] for part in (window, link))
            normal = -(own_absorbed.T @ own_absorbed)
            for part in (of_window, of_link):
                if part is not None:
                    normal += part @ part.T
            normal.flat[:: len(normal) + 1] += _ROUNDING * (normal.diagonal() + (own_absorbed**2).sum(axis=0))
            normal -= own_explained.T @ own_explained
            yield New(normal, score[own], of_window, of_link, own_absorbed, own_explained)

    def move(self, new: New) -> Array:
        """(P, k) S of columns."""
        result = np.zeros((len(self.fit.free), len(new.score)))
        result[self.fit.free] = self._scale[:, None] * dtrtrs(self._root, new.explained, lower=1, trans=1)[0]
        return result

    def _absorbed(self, window: Array | None, link: Array | None) -> Array:
        """Z (2n, k) of whitened columns."""
        reduced = self.fit.reduced
        one = window if window is not None else link
        assert one is not None
        border = np.zeros((len(one), reduced.basis.shape[2], 2))
        for a in (0, 1):
            if window is not None:
                border[:, :, a] = _along(reduced.on_direction[:, a], window)
            if link is not None:
                border[:, 1:, a] += _along(reduced.after[:, a], link)
                border[:, :-1, a] += _along(reduced.before[:, a], link)
        return solved(self._factor, border.reshape(len(one), -1)).T

    @cached_property
    def _factor(self) -> Array:
        result: Array = self.fit.reduced.factor.astype(complex)
        return result

    def _explained(self, pull: Array) -> Array:
        """The root of what the free parameters explain, of products (P, k) with all."""
        result: Array = dtrtrs(self._root, self._scale[:, None] * pull[self.fit.free], lower=1)[0]
        return result

    @cached_property
    def _left(self) -> _Left:
        fit, reduced = self.fit, self.fit.reduced
        residuals = fit.residuals
        window = residuals.window * (np.sqrt(fit.weights.window) * fit.chain.window_scale)
        link = residuals.link * self._link_scale
        absorbed = self._absorbed(window[None], link[None])[:, 0]
        pull = reduced.on_parameters.reshape(len(fit.free), -1) @ window.ravel()
        pull[9:12] += self._on_bias @ link.ravel()
        pull -= absorbed @ reduced.half[:, : len(pull)]
        return _Left(window.ravel(), link.ravel(), absorbed, self._explained(pull[:, None])[:, 0])

    @cached_property
    def _window_scale(self) -> Array:
        chain = self.fit.chain
        scale = np.sqrt(self.fit.weights.window) * chain.window_scale
        return scale if chain.answer is None else chain.answer * scale

    @cached_property
    def _link_scale(self) -> Array:
        return np.sqrt(self.fit.weights.link) * self.fit.chain.link_scale

    @cached_property
    def _on_bias(self) -> Array:
        """(3, 3n − 3) the links' Jacobian."""
        return np.ascontiguousarray(self.fit.reduced.on_bias.swapaxes(0, 1)).reshape(3, -1)

    @cached_property
    def _scale(self) -> Array:
        """(free,) one over the norm of each parameter's own column."""
        reduced = self.fit.reduced
        flat = reduced.on_parameters.reshape(len(self.fit.free), -1)
        square = np.maximum(np.einsum("pm,pm->p", flat, flat), np.diag(reduced.information))
        square[9:12] += np.einsum("km,km->k", self._on_bias, self._on_bias)
        result: Array = 1 / np.sqrt(np.maximum(square[self.fit.free], 1e-300))
        return result

    @cached_property
    def _root(self) -> Array:
        """(free, free) Cholesky factor of the information times `_scale` on both sides."""
        free, scale = self.fit.free, self._scale
        information = self.fit.reduced.information[np.ix_(free, free)] * scale * scale[:, None]
        result: Array = np.linalg.cholesky(information + _ROUNDING * np.eye(len(scale)))
        return result


class _Left(NamedTuple):
    """The residual as `New` has columns: window (3n,), link (3n − 3,), absorbed (2n,), explained (free,)."""

    window: Array
    link: Array
    absorbed: Array
    explained: Array


def _whitened(parts: Sequence[Array | None], scale: Array) -> Array | None:
    """Columns (k, 3, n) of all groups times `scale`; None where they have none there."""
    given = [part for part in parts if part is not None]
    if not given:
        return None
    result = np.empty((sum(len(part) for part in given), *given[0].shape[1:]))
    np.concatenate(given, out=result)
    result *= scale
    return result


def _along(vector: Array, columns: Array) -> Array:
    """(p, n) products of vectors (3, n) with columns (p, 3, n); faster than einsum."""
    result: Array = vector[0] * columns[:, 0]
    result += vector[1] * columns[:, 1]
    result += vector[2] * columns[:, 2]
    return result
