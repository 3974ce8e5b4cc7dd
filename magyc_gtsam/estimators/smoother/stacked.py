"""The products between groups of columns outside the model (`beside`), of many groups at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from magyc_gtsam.estimators.smoother.beside import ColumnScore
from magyc_gtsam.factors.chain.rotations import Array


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
