"""The equations of a linear start: pairs of windows, between which the field rotated back changes only by the bias."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array, cross
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS

TRACELESS = np.concatenate([SYMMETRIC_UNITS[[1, 2, 4]], SYMMETRIC_UNITS[[0, 3]] - SYMMETRIC_UNITS[[3, 5]]])


class Pairs(NamedTuple):
    """n pairs of windows.

    before, after (3, 3, n): M of both; lever (3, 3, n) s: ΔK; turned_back (3, n) T: Mᵀ m of the first; field_before,
    field_after (3, n) T: m of both; change (3, n) T: what the second Mᵀ m is more than the first.
    """

    before: Array
    after: Array
    lever: Array
    turned_back: Array
    field_before: Array
    field_after: Array
    change: Array

    def equations(self, hard_iron: Array, weight: Array, stretched: bool) -> tuple[Array, Array, Array]:
        """Return the columns (k, 3, n) of hard iron, bias and, if `stretched`, five units of D, linearised at a hard
        iron (3,) T, and with weights (n,) their normal equations: (k, k) and the right side (k,).
        """
        n, k = len(weight), 11 if stretched else 6
        if compiled.loops:
            result = np.empty((k, 3, n)), np.empty((k, k)), np.empty(k)
            inputs = map(compiled.given, (*self[:6], hard_iron, TRACELESS, self.change, weight))
            compiled.loops.start_from(n, *inputs, *result)
            return result
        columns = np.empty((k, 3, n))
        np.subtract(self.after, self.before, out=columns[:3])
        still = self.turned_back - np.einsum("ijn,i->jn", self.before, hard_iron)
        columns[3:6] = cross(still[:, None], self.lever).swapaxes(0, 1)
        if stretched:
            after, before = (m - hard_iron[:, None] for m in (self.field_after, self.field_before))
            np.subtract(_stretched(self.after, after), _stretched(self.before, before), out=columns[6:])
        weighted = (columns * weight).reshape(k, -1)
        return columns, weighted @ columns.reshape(k, -1).T, weighted @ self.change.ravel()

    def squares(self, columns: Array, solution: Array) -> Array:
        """Return the squared norms (n,) of what a solution (k,) leaves of the changes."""
        if compiled.loops:
            result = np.empty(columns.shape[2])
            compiled.loops.start_left(len(result), columns, compiled.given(solution), self.change, result)
            return result
        left = self.change - (solution @ columns.reshape(len(columns), -1)).reshape(3, -1)
        return np.einsum("in,in->n", left, left)


def _stretched(rotation: Array, field: Array) -> Array:
    """Return (5, 3, n) Mᵀ E_j m of a basis of D, for M (3, 3, n) and m (3, n)."""
    stretched = (TRACELESS.reshape(15, 3) @ field).reshape(5, 3, -1)
    return np.asarray(np.einsum("ijn,kin->kjn", rotation, stretched))
