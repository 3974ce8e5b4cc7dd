"""Products of columns beside groups whose variances are held fixed, by the sweep operator (Goodnight 1979).

With columns of G (K, K), s (K,) and yᵀy, of which those of the held groups have G_hh + V⁻¹, eliminating these leaves

    G − G_h (G_hh + V⁻¹)⁻¹ G_hᵀ,   s − G_h (G_hh + V⁻¹)⁻¹ s_h,   yᵀy − s_hᵀ (G_hh + V⁻¹)⁻¹ s_h

of the others. Groups are held and released one by one, each at a few products of its rows with all columns.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array

ROUNDING = 1e-9  # least share of yᵀy that columns leave; beside a poor fit they could explain more than all of it


class HeldColumns:
    """The products of columns beside the groups that are held; none at first.

    Args:
        normal, score, square: G (K, K), s (K,) and yᵀy of all columns.
    """

    def __init__(self, normal: Array, score: Array, square: float) -> None:
        self._table = np.empty((len(score) + 1,) * 2)
        self._table[:-1, :-1], self._table[:-1, -1], self._table[-1, :-1] = normal, score, score
        self._table[-1, -1] = square
        self._variance: dict[tuple[int, int], float] = {}
        self._least = ROUNDING * square

    def copy(self) -> HeldColumns:
        """Return a copy, in which other groups may be held."""
        result = HeldColumns.__new__(HeldColumns)
        result._table, result._variance, result._least = self._table.copy(), dict(self._variance), self._least
        return result

    def hold(self, own: slice, variance: float) -> None:
        """Hold the variance, above 0, of a group of columns."""
        table = self._table
        inverse = np.linalg.inv(table[own, own] + np.eye(own.stop - own.start) / variance)
        across = table[:, own].copy()
        solved = across @ inverse
        table -= solved @ across.T
        table[:, own], table[own], table[own, own] = solved, solved.T, -inverse
        self._variance[own.start, own.stop] = variance

    def release(self, own: slice) -> None:
        """Release a group of columns, if it is held."""
        variance = self._variance.pop((own.start, own.stop), None)
        if variance is None:
            return
        table = self._table
        block = np.linalg.inv(-table[own, own])
        solved = table[:, own].copy()
        across = solved @ block
        table += solved @ across.T
        table[:, own], table[own] = across, across.T
        table[own, own] = block - np.eye(len(block)) / variance

    def normal(self, own: slice) -> Array:
        """Return G (k, k) of a group that is not held."""
        return self._table[own, own]

    def score(self, own: slice) -> Array:
        """Return s (k,) of a group that is not held."""
        return self._table[own, -1]

    @property
    def left(self) -> float:
        """What the held groups leave of yᵀy."""
        return max(float(self._table[-1, -1]), self._least)
