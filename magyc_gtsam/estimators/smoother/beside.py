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
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np

from magyc_gtsam.estimators.smoother.columns import UnmodelledColumns, joined
from magyc_gtsam.estimators.smoother.whitened_fit import ROUNDING, WhitenedFit
from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array

# Columns times windows that go through the elimination together: few calls, and the working set stays in the cache.
_TOGETHER = 1 << 16

Make = Callable[[], UnmodelledColumns]


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

    def of(self, columns: UnmodelledColumns) -> ColumnScore:
        """Return score and information of a group of columns."""
        return self.of_each([lambda: columns])[0]

    def of_each(self, groups: Sequence[Make]) -> list[ColumnScore]:
        """Return score and information of each group; groups on the same sensors are eliminated together."""
        result: dict[int, tuple[Array, Array, Array]] = {}
        waiting: dict[object, dict[int, UnmodelledColumns]] = {}
        count: dict[object, int] = {}
        most = _TOGETHER // len(self.fit.chain.windows)
        for i, make in enumerate(groups):
            group = make()
            sensors = group.window is None, group.link is None, group.per_row > 0
            waiting.setdefault(sensors, {})[i] = group
            count[sensors] = count.get(sensors, 0) + group.size
            if count[sensors] > most:
                result |= self._of_alike(waiting.pop(sensors))
                count[sensors] = 0
        for alike in waiting.values():
            result |= self._of_alike(alike)
        return [ColumnScore(*result[i], make, self) for i, make in enumerate(groups)]

    def _of_alike(self, groups: dict[int, UnmodelledColumns]) -> dict[int, tuple[Array, Array, Array]]:
        """Return {key: (G, s, explained)} of groups that are all on the same sensors."""
        explained, score, normals = (self._compiled if compiled.loops else self._in_numpy)(list(groups.values()))
        result, first = {}, 0
        for i, normal in zip(groups, normals, strict=True):
            rows = slice(first, first + len(normal))
            first = rows.stop
            result[i] = normal, score[rows], explained[:, rows]
        return result

    def _compiled(self, groups: Sequence[UnmodelledColumns]) -> tuple[Array, Array, list[Array]]:
        """Return `explained` (free, K), s (K,) and the matrices G of groups on the same sensors."""
        sizes = [group.size for group in groups]
        ends = list(accumulate(size * size for size in sizes))
        of_window, of_link = self._onto
        products, normal = np.empty((len(of_window), sum(sizes))), np.empty(ends[-1])
        compiled.loops.score(
            len(self.fit.chain.windows),
            *(compiled.given(group.window) for group in groups),
            *(compiled.given(group.link) for group in groups),
            *self._whitening,
            of_window,
            of_link,
            np.array([ROUNDING]),
            np.array(sizes, dtype=np.int64),
            products,
            normal,
        )
        normals = [normal[e - k * k : e].reshape(k, k) for e, k in zip(ends, sizes, strict=True)]
        return products[:-1], products[-1], normals

    def _in_numpy(self, groups: Sequence[UnmodelledColumns]) -> tuple[Array, Array, list[Array]]:
        window, link, absorbed = self.whiten(joined(groups))
        of_each = zip(self._onto, (window, link), strict=True)
        products = sum((rows @ part.T for rows, part in of_each if part is not None), np.zeros(()))
        explained = products[:-1]
        normals, first = [], 0
        for size in (group.size for group in groups):
            rows = slice(first, first + size)
            first, taken, kept = rows.stop, absorbed[rows] @ absorbed[rows].T, explained[:, rows]
            normal = sum(part[rows] @ part[rows].T for part in (window, link) if part is not None) - taken
            normal.flat[:: size + 1] += ROUNDING * (normal.diagonal() + taken.diagonal())
            normals.append(normal - kept.T @ kept)
        return explained, products[-1], normals

    @cached_property
    def _onto(self) -> tuple[Array, Array]:
        """Rows (free + 1, 3n) of windows and (free + 1, 3n − 3) of links, whose products with whitened columns are
        `explained` and, the last one, the score.

        They are the components of the parameters and the residual, less what the directions explain of each.
        """
        own, left = self.estimated, self.left
        root = own.explained(np.eye(len(own.free)))
        score = left.explained @ root
        along = np.vstack([root, score])
        half, window = along @ own.half, along @ own.window.reshape(len(own.free), -1)
        link = along[:, own.linked] @ own.link
        for rows, rest in ((half, left.absorbed), (window, left.window), (link, left.link)):
            rows[-1] -= rest
        return self.beside_directions(half, window, link)

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
            window, link, absorbed[own] = beside.whiten(new.make())
            if window is not None:
                of_windows.append((window, own))
            if link is not None:
                of_links.append((link, own))
        explained = np.concatenate([new.explained for new in groups], axis=1)
        return cls(rows, explained, absorbed, _one_below_the_other(of_windows), _one_below_the_other(of_links))

    def only(self, groups: Sequence[int]) -> Stacked:
        """Return some of the groups."""
        ends = np.cumsum([0, *(self.groups[i].stop - self.groups[i].start for i in groups)]).tolist()
        own = tuple(slice(*pair) for pair in pairwise(ends))
        place = np.full(len(self.absorbed), -1)
        for i, rows in zip(groups, own, strict=True):
            place[self.groups[i]] = np.arange(rows.start, rows.stop)
        kept = np.concatenate([np.arange(self.groups[i].start, self.groups[i].stop) for i in groups])

        def some(part: Array, rows: np.ndarray) -> tuple[Array, np.ndarray]:
            wanted = np.flatnonzero(place[rows] >= 0)
            return part[wanted], place[rows[wanted]]

        return Stacked(own, self.explained[:, kept], self.absorbed[kept], some(*self.window), some(*self.link))

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
    return np.concatenate([part for part, _ in parts]), np.concatenate(rows)
