"""Products of columns beside groups whose variances are held fixed, by the sweep operator (Goodnight 1979).

With columns of G (K, K), s (K,) and yᵀy, of which those of the held groups have A = G_hh + V⁻¹, eliminating these
leaves

    G − G_h A⁻¹ G_hᵀ,   s − G_h A⁻¹ s_h,   yᵀy − s_hᵀ A⁻¹ s_h

of the others. The table holds these, G_h A⁻¹ between them and a held group, and −A⁻¹ for the group itself. To hold,
change or release a group is one product of its rows with all columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dgemm

from magyc_gtsam.factors.chain.rotations import Array

ROUNDING = 1e-9  # least share of yᵀy that columns leave; beside a poor fit they could explain more than all of it


class Products(NamedTuple):
    """G (k, k) and s (k,) of columns beside groups that are held, and what these leave of yᵀy."""

    normal: Array
    score: Array
    left: float


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

    def hold(self, own: slice, variance: float) -> None:
        """Hold the variance of a group of columns, whatever it was; 0 releases the group."""
        key = own.start, own.stop
        before = self._variance.get(key, 0.0)
        if variance == before:
            return
        table, normal = self._table, self.of(own).normal
        across, inverse, new = table[:, own].copy(), np.zeros_like(normal), np.zeros_like(normal)
        if before:
            inverse = -table[own, own]
            across = across @ np.linalg.inv(inverse)
        if variance:
            new[:] = np.linalg.inv(normal + np.eye(len(normal)) / variance)
        # The transpose has the order of BLAS, and the table is symmetric.
        dgemm(1.0, across @ (inverse - new), across, 1.0, table.T, trans_b=True, overwrite_c=True)
        if variance:
            across, normal = across @ new, -new
        table[:, own], table[own], table[own, own] = across, across.T, normal
        self._variance[key] = variance

    def of(self, own: slice) -> Products:
        """Return the products of a group beside the others that are held, whether it is held itself or not."""
        variance = self._variance.get((own.start, own.stop), 0.0)
        inner, score = self._table[own, own].copy(), self._table[own, -1].copy()
        if not variance:
            return Products(inner, score, self.left)
        information = np.linalg.inv(-inner)
        normal = information - np.eye(len(inner)) / variance
        return Products(normal, information @ score, self._left(score @ information @ score))

    def without(self, own: slice, others: Sequence[slice]) -> list[Products]:
        """Return the products of groups that are not held, with a group released that is."""
        solved = self._table[:, own]
        across = solved @ np.linalg.inv(-self._table[own, own])
        left = self._left(solved[-1] @ across[-1])
        result = []
        for rows in others:
            score = self._table[rows, -1] + solved[rows] @ across[-1]
            result.append(Products(self._table[rows, rows] + solved[rows] @ across[rows].T, score, left))
        return result

    @property
    def left(self) -> float:
        """What the held groups leave of yᵀy."""
        return self._left(0.0)

    def _left(self, more: float) -> float:
        return max(float(self._table[-1, -1]) + float(more), self._least)
