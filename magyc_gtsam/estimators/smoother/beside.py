"""Score and information of columns that a fit's model lacks, and the parameter errors that leaving them out causes.

At its minimum a field chain leaves the whitened residual r = J δ − X β, where the columns X act on the reading and on
the gyroscope's links and are not in the model. With P the projection that removes what directions and parameters can
explain of a column,

    G = Xᵀ P X,   s = −Xᵀ P r,   β̂ = G⁻¹ s,    and if X is left out, each unit of β moves θ by S = H⁻¹ Jᵀ X.

Only inner products are needed, and the elimination of the fit already holds half of them: with L Lᵀ the directions'
matrix, C the product of the directions' Jacobian with the columns and Z = L⁻¹ C, eliminating the directions leaves
XᵀX − ZᵀZ. Columns and parameters go through the same steps, so that their joint matrix is positive semidefinite up to
rounding, which a small ridge on each covers. Terms of the model beyond θ are treated as parameters with their priors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dgemm

from magyc_gtsam.estimators.smoother.columns import Columns, Products, RateErrors, joined
from magyc_gtsam.estimators.smoother.whitened_fit import ROUNDING, WhitenedFit
from magyc_gtsam.factors.chain.banded import forward_solved
from magyc_gtsam.factors.chain.rotations import Array, along

# Columns times windows that go through the elimination together: few calls, and the working set stays in the cache.
_TOGETHER = 1 << 15

Make = Callable[[], Columns]


@dataclass(frozen=True, eq=False)
class ColumnScore:
    """The score and information matrix of one group of columns outside the model.

    The columns themselves are computed again when they are needed (`Stacked`), because few groups are.

    Attributes:
        normal: (k, k) G.
        score: (k,) s.
        explained: (free, k) components of the columns along the free parameters, in whitened coordinates.
        make: returns the columns.
        beside: the fit's products.
    """

    normal: Array
    score: Array
    explained: Array
    make: Make
    beside: ColumnProducts

    @property
    def left_by_terms(self) -> Array:
        """(k,) share of each column's information beside θ that remains beside the terms, too; 1 without terms."""
        own, terms = self.normal.diagonal(), self.beside.fit.terms
        if terms is None:
            return np.ones(len(own))
        held: Array = np.square(self.explained[-terms.columns.size :]).sum(axis=0)
        return own / np.maximum(own + held, 1e-300)


@dataclass(frozen=True, eq=False)
class ColumnProducts(WhitenedFit):
    """The products of columns with a fit at its minimum."""

    def of(self, columns: Columns) -> ColumnScore:
        """Return score and information of a group of columns."""
        return self.of_each([lambda: columns])[0]

    def of_each(self, groups: Sequence[Make]) -> list[ColumnScore]:
        """Return score and information of each group; groups of the same kind go through the elimination together."""
        result: dict[int, tuple[Array, Array, Array]] = {}
        waiting: dict[object, dict[int, Columns]] = {}
        windows = len(self.fit.chain.windows)
        for i, make in enumerate(groups):
            group = make()
            alike = waiting.setdefault(_kind(group), {})
            alike[i] = group
            if sum(each.size for each in alike.values()) * windows >= _TOGETHER:
                result |= self._of_alike(alike)
                alike.clear()
        for alike in waiting.values():
            result |= self._of_alike(alike)
        return [ColumnScore(*result[i], make, self) for i, make in enumerate(groups)]

    def _of_alike(self, groups: dict[int, Columns]) -> dict[int, tuple[Array, Array, Array]]:
        """Return {key: (G, s, explained)} of groups that are all on the same sensors, or have the same axes."""
        if not groups:
            return {}
        left, each = self.left, list(groups.values())
        part = self._products(each) if isinstance(each[0], Products) else self._dense(each)
        absorbed = forward_solved(self.factor, part.border)
        explained = self.estimated.explained(part.pull - self.estimated.half @ absorbed.T)
        score = absorbed @ left.absorbed + explained.T @ left.explained - part.score
        result, first = {}, 0
        for i, group in groups.items():
            own = slice(first, first + group.size)
            first = own.stop
            explained_of_own = explained[:, own]
            square = _gram(absorbed[own])
            normal = part.square(own) - square
            normal.flat[:: len(normal) + 1] += ROUNDING * (normal.diagonal() + square.diagonal())
            normal -= explained_of_own.T @ explained_of_own
            result[i] = normal, score[own], explained_of_own
        return result

    def absorbed(self, columns: Columns) -> Array:
        """Return Zᵀ (k, 2n) of columns."""
        part = self._products([columns]) if isinstance(columns, Products) else self._dense([columns])
        return forward_solved(self.factor, part.border)

    def _dense(self, groups: Sequence[Columns]) -> _Part:
        """Return the products of columns of any kind."""
        own, left = self.estimated, self.left
        together = joined(groups)
        window = None if together.window is None else together.window * self.window_scale
        link = None if together.link is None else together.link * self.link_scale
        count = together.size
        border = self.border(count, window, link)
        pull, score = np.zeros((len(own.free), count)), np.zeros(count)
        if window is not None:
            window = window.reshape(count, -1)
            pull += own.window.reshape(len(pull), -1) @ window.T
            score += window @ left.window
        if link is not None:
            link = link.reshape(count, -1)
            pull[own.linked] += own.link @ link.T
            score += link @ left.link
        parts = [part for part in (window, link) if part is not None]

        def square(own: slice) -> Array:
            result = _gram(parts[0][own])
            for part in parts[1:]:
                result += _gram(part[own])
            return result

        return _Part(border, pull, score, square)

    def _products(self, groups: Sequence[Columns]) -> _Part:
        """Return the products of profiles along common axes; the work on the axes is shared by all profiles."""
        own, size = self.estimated, len(self.estimated.free)
        products = [group for group in groups if isinstance(group, Products)]
        axes, profiles = (
            products[0].axes * self.window_scale,
            np.concatenate([each.profiles for each in products]),
        )
        (count, _, n), transposed = axes.shape, profiles.T
        of_axes = self.border(count, axes, None)
        border = (profiles[:, None, None] * of_axes).reshape(-1, 2, n)
        on_parameters = np.einsum("pin,bin->pbn", own.window, axes)
        pull = (on_parameters.reshape(-1, n) @ transposed).reshape(size, count, -1)
        score = along(self.left.window.reshape(3, n), axes) @ transposed
        between = np.einsum("ain,bin->abn", axes, axes)
        overlap = between.any(axis=2).tolist()
        pairs = [(a, b) for a in range(count) for b in range(a, count) if overlap[a][b]]

        def square(own: slice) -> Array:
            some = profiles[own.start // count : own.stop // count]
            result = np.zeros((len(some), count, len(some), count))
            for a, b in pairs:
                result[:, a, :, b] = (between[a, b] * some) @ some.T
                if a != b:
                    result[:, b, :, a] = result[:, a, :, b]
            return result.reshape(len(some) * count, -1)

        return _Part(border, pull.swapaxes(1, 2).reshape(size, -1), score.T.ravel(), square)

    def move(self, new: ColumnScore) -> Array:
        """Return S (P, k) of a group of columns."""
        return self.moves([new])[0][: len(self.fit.free)]

    def moves(self, groups: Sequence[ColumnScore]) -> list[Array]:
        """Return (p, k) of each group of columns: S, and below it the same for the terms of the model."""
        if not groups:
            return []
        explained = np.concatenate([new.explained for new in groups], axis=1)
        moved, ends = self.estimated.moved(explained), accumulate(len(new.score) for new in groups)
        return [moved[:, end - len(new.score) : end] for new, end in zip(groups, ends, strict=True)]


class _Part(NamedTuple):
    """Products of whitened columns X before the elimination.

    Attributes:
        border: (k, 2, n) with the directions' Jacobian.
        pull: (P, k) with the parameters' Jacobian.
        score: (k,) with the residual.
        square: returns XᵀX of a slice of the columns.
    """

    border: Array
    pull: Array
    score: Array
    square: Callable[[slice], Array]


def _gram(rows: Array) -> Array:
    """Return the Gram matrix (k, k) of rows (k, m).

    The general product is used: BLAS's routine for a matrix times its transpose takes twice as long for so few rows.
    """
    result: Array = dgemm(1.0, rows.T, rows.T, trans_a=1)
    return result


def _kind(group: Columns) -> object:
    """Return a key that groups share if they go through the elimination together."""
    if isinstance(group, Products):
        return id(group.axes)
    if isinstance(group, RateErrors):  # reading `link` would integrate the errors
        return True, False
    return group.window is None, group.link is None


@dataclass(frozen=True, eq=False)
class Stacked:
    """The K columns of several groups, whitened, one below the other.

    Attributes:
        groups: the rows of each group.
        explained: (free, K) components along the free parameters.
        absorbed: (K, 2n) Zᵀ.
        window: (k, 3n) columns of the windows, and the rows (k,) that they belong to; the other rows are zero.
        link: likewise of the links, (l, 3n − 3) and (l,).
    """

    groups: tuple[slice, ...]
    explained: Array
    absorbed: Array
    window: tuple[Array, np.ndarray]
    link: tuple[Array, np.ndarray]

    @classmethod
    def of(cls, groups: Sequence[ColumnScore]) -> Stacked:
        """Stack one group or more of the same fit."""
        edges = np.cumsum([0, *(len(new.score) for new in groups)]).tolist()
        rows = tuple(slice(*pair) for pair in pairwise(edges))
        beside = groups[0].beside
        absorbed = np.empty((edges[-1], beside.left.absorbed.size))
        of_windows: list[tuple[Array, slice]] = []
        of_links: list[tuple[Array, slice]] = []
        for new, own in zip(groups, rows, strict=True):
            columns = new.make()
            absorbed[own] = beside.absorbed(columns)
            if columns.window is not None:
                of_windows.append((columns.window * beside.window_scale, own))
            link = columns.link
            if link is not None:
                of_links.append((link * beside.link_scale, own))
        explained = np.concatenate([new.explained for new in groups], axis=1)
        return cls(rows, explained, absorbed, _one_below_the_other(of_windows), _one_below_the_other(of_links))

    def across(self, other: Stacked) -> Array:
        """Return the (K, L) block of G between these columns and others."""
        result: Array = -(self.absorbed @ other.absorbed.T) - self.explained.T @ other.explained
        for (own, rows), (others, columns) in ((self.window, other.window), (self.link, other.link)):
            if len(rows) and len(columns):
                result[np.ix_(rows, columns)] += own @ others.T
        return result


def _one_below_the_other(parts: Sequence[tuple[Array, slice]]) -> tuple[Array, np.ndarray]:
    """Return the columns as rows, and the number of each row."""
    if not parts:
        return np.empty((0, 0)), np.empty(0, dtype=int)
    rows = [np.arange(own.start, own.stop) for _, own in parts]
    return np.concatenate([part.reshape(len(part), -1) for part, _ in parts]), np.concatenate(rows)
