"""Cubic splines through rows of values at the same times."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpttrf, dpttrs

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array, cross

_LEAST = 1e-9  # s, of a step


class Spline(NamedTuple):
    """The splines through values at n > 3 times, whose first and last slopes are those of the first and the last step.

    step (n − 1,) s; inverse (n − 1,) 1/s; diagonal, below (n − 2,), (n − 3,): factors of the tridiagonal matrix of the
    inner slopes; share (n − 2,): reciprocals of the diagonal.
    """

    step: Array
    inverse: Array
    diagonal: Array
    below: Array
    share: Array

    @classmethod
    def at(cls, time: Array) -> Spline:
        """Return the splines at ascending times (n,) s."""
        step = np.maximum(np.diff(time), _LEAST)
        inverse = 1 / step
        diagonal, below, _ = dpttrf(2 * (inverse[1:] + inverse[:-1]), inverse[1:-1])
        return cls(step, inverse, diagonal, below, 1 / diagonal)

    def slopes(self, values: Array) -> Array:
        """Return the derivatives (…, n) at the times of the splines through values (…, n)."""
        n, inverse = len(self.step) + 1, self.inverse
        rows = values.reshape(-1, n)
        slope = np.empty(rows.shape)
        if compiled.loops:
            factors = inverse, self.share, self.below
            compiled.loops.spline_slopes(n, compiled.given(rows), *factors, slope)
            return slope.reshape(values.shape)
        rise = rows[:, 1:] - rows[:, :-1]
        slope[:, 0], slope[:, -1] = rise[:, 0] * inverse[0], rise[:, -1] * inverse[-1]
        rise *= 3 * inverse**2
        right = rise[:, 1:] + rise[:, :-1]
        right[:, 0] -= inverse[0] * slope[:, 0]
        right[:, -1] -= inverse[-1] * slope[:, -1]
        slope[:, 1:-1] = dpttrs(self.diagonal, self.below, right.T, overwrite_b=1)[0].T
        return slope.reshape(values.shape)

    def integrals(self, values: Array, straight: bool = False) -> Array:
        """Return the integrals (…, n − 1) over each step; if `straight`, those of the trapezoids."""
        result: Array = 0.5 * self.step * (values[..., 1:] + values[..., :-1])
        if not straight:
            slope = self.slopes(values)
            result -= self.step**2 / 12 * (slope[..., 1:] - slope[..., :-1])
        return result

    def crossed_integrals(self, values: Array, direction: Array, straight: bool = False) -> Array:
        """Return direction × the integrals (k, 3, n − 1) of vectors (k, 3, n), with directions (3, n) at each begin."""
        if compiled.loops:
            result = np.empty((*values.shape[:2], len(self.step)))
            slope = None if straight else self.slopes(values)
            inputs = map(compiled.given, (values, slope, self.step, direction))
            compiled.loops.cross_integrals(len(self.step) + 1, *inputs, result)
            return result
        return crossed(direction[:, :-1], self.integrals(values, straight))


def crossed(direction: Array, vectors: Array) -> Array:
    """Return the cross products (k, 3, n) of directions (3, n) with vectors (k, 3, n)."""
    result = np.empty(vectors.shape)
    cross(direction[:, None], vectors.swapaxes(0, 1), out=result.swapaxes(0, 1))
    return result
