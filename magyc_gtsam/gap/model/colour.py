"""Coloured noise as autoregressions of the innovations, which whiten them and every regressor alike.

The innovations along the field have all of the colour of the reading. Those across it have the fast part only: a slow
one turns the direction that the filter has found, so that it is predicted. Each has its own autoregression, unless one
for both is more probable, which has half as many parameters: that of fast noise, which turns nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_toeplitz

from magyc_gtsam.factors.chain.rotations import Array

_ORDERS = (1, 2, 3, 4, 6)


@dataclass(frozen=True, eq=False)
class Autoregression:
    """Noise with Σ polynomial[lag] · noise[t − lag] white, alike along each axis.

    Attributes:
        polynomial: (order + 1,), the first is 1.
        level: standard deviation of what is white, relative to the innovations' unit.
        start: that of the first values, which have none before them.
    """

    polynomial: Array
    level: float
    start: float

    @classmethod
    def of(cls, rows: Array, freedom: int) -> Autoregression:
        """Return the likeliest autoregression of rows (k, n) of so many degrees of freedom, with the order by BIC."""
        n = rows.shape[1]
        start = np.sqrt(max(float((rows**2).sum()) / (freedom * n), 1.0))
        found = []
        for order in _ORDERS:
            lagged = np.array([np.vdot(rows[:, lag:], rows[:, : n - lag]) for lag in range(order + 1)])
            first = lagged[:-1].copy()
            first[0] *= 1 + 1e-9
            polynomial = np.concatenate([[1.0], -solve_toeplitz(first, lagged[1:])])
            left = cls(polynomial, 1.0, 1.0).whiten(rows)[:, order:]
            level = float(np.sqrt((left**2).sum() / (freedom * (n - order))))
            found.append(cls(polynomial, level, start))
        return max(found, key=lambda one: one.nats(rows, freedom))

    def nats(self, rows: Array, freedom: int) -> float:
        """Return the log-likelihood of rows (k, n) beyond that of unit white noise, less the penalty of BIC."""
        left = self.whiten(rows)
        return 0.5 * float((rows**2).sum() - (left**2).sum()) - self.price(rows.shape[1], freedom)

    def price(self, n: int, freedom: int) -> float:
        """Return the log determinant of n whitened values of so many degrees of freedom, with the penalty of BIC."""
        order = len(self.polynomial) - 1
        levels = (n - order) * np.log(self.level) + order * np.log(self.start)
        return float(freedom * levels + 0.5 * (order + 1) * np.log(freedom * n))

    def whiten(self, rows: Array) -> Array:
        """Return rows (…, n) of innovations or of regressors, whitened."""
        order, n = len(self.polynomial) - 1, rows.shape[-1]
        result: Array = np.empty(rows.shape)
        result[..., :order] = rows[..., :order] / self.start
        left = result[..., order:]
        np.multiply(rows[..., order:], 1 / self.level, out=left)
        for lag, factor in enumerate(self.polynomial[1:], 1):
            left += rows[..., order - lag : n - lag] * (factor / self.level)
        return result


@dataclass(frozen=True, eq=False)
class ColouredNoise:
    """The noise of a magnetometer.

    Attributes:
        direction: (3, n) of the windows, unit vectors along which an innovation is of the field's strength alone.
        along, across: the autoregressions of the innovations along it and across it, or one for both.
    """

    direction: Array
    along: Autoregression
    across: Autoregression

    @classmethod
    def of(cls, innovation: Array, direction: Array) -> ColouredNoise:
        """Return the likeliest noise of innovations (3, n)."""
        along, across = _parts(innovation, direction)
        result = cls(direction, Autoregression.of(along[None], 1), Autoregression.of(across, 2))
        # The direction turns between windows, so that a part of what is left across it is along it.
        _, left = _parts(result.whiten(innovation), direction)
        level = result.across.level * float(np.sqrt((left**2).sum() / (2 * left.shape[1])))
        common = Autoregression.of(innovation, 3)
        either = replace(result, across=replace(result.across, level=level)), cls(direction, common, common)
        return max(either, key=lambda noise: noise.nats(innovation))

    def nats(self, innovation: Array) -> float:
        """Return the log-likelihood of innovations (3, n) beyond that of white noise, less the penalty of BIC."""
        n, square = innovation.shape[1], float((innovation**2).sum() - (self.whiten(innovation) ** 2).sum())
        if self.along is self.across:
            return 0.5 * square - self.along.price(n, 3)
        return 0.5 * square - self.along.price(n, 1) - self.across.price(n, 2)

    def whiten(self, rows: Array) -> Array:
        """Return rows (…, 3, n) of innovations or of regressors, whitened."""
        if self.along is self.across:
            return self.along.whiten(rows)
        along, across = _parts(rows, self.direction)
        _, across = _parts(self.across.whiten(across), self.direction)
        result: Array = self.along.whiten(along)[..., None, :] * self.direction + across
        return result

    @property
    def gain(self) -> float:
        """The factor of the product of two rows that have the same values in common, across the field."""
        return float(self.across.polynomial @ self.across.polynomial) / self.across.level**2


def _parts(rows: Array, direction: Array) -> tuple[Array, Array]:
    """Return the parts (…, n) along unit vectors (3, n) and (…, 3, n) across them of rows (…, 3, n)."""
    along = np.einsum("...in,in->...n", rows, direction)
    return along, rows - along[..., None, :] * direction
