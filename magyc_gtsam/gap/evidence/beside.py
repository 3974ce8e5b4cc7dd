"""Marginalisation of parameters without a prior and of effects with one, beside which a candidate is tested.

For innovations r (3n,) of variance ρ² and columns N with prior variances v (infinite for parameters), marginalisation
is weighting with M = (I − Nᵀ H⁻¹ N) / ρ², H = N Nᵀ + ρ² diag(1/v). The score bias of a column (due to the gyroscope's
noise in its own regressors) is projected in the same way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from magyc_gtsam.factors.chain.rotations import Array

_RIDGE = 1e-10  # of a parameter's information, added so that undetermined directions have a solution


class Seen(NamedTuple):
    """The reach (N, m) of columns into what is marginalised, and their scores (N,) after marginalisation."""

    reach: Array
    score: Array


class Beside:
    """The marginalised model.

    Attributes:
        square: rᵀ M r.
        log_determinant: of I + V N Nᵀ / ρ², after marginalisation of the parameters.
        noise: ρ.
        before: number of columns that are marginalised before those of effects.
    """

    def __init__(
        self,
        residual: Array,
        flat: Array,
        soft: Array,
        variance: Array,
        score_bias: Array,
        noise: float = 1.0,
        effects: int = 0,
    ):
        """Marginalise columns without a prior (q, 3n), and with variances (k,) (k, 3n), of score bias (q + k,); the
        last `effects` of them belong to effects."""
        size = np.sqrt(np.einsum("pn,pn->p", flat, flat))
        size = np.where(size > 0, size, 1.0)
        self._rows = np.concatenate([flat / size[:, None], soft * np.sqrt(variance)[:, None]]) / noise
        score_bias = (
            np.concatenate([score_bias[: len(flat)] / size, score_bias[len(flat) :] * np.sqrt(variance)])
            / noise**2
        )
        prior = np.concatenate([np.full(len(flat), _RIDGE / noise**2), np.ones(len(soft))])
        normal = self._rows @ self._rows.T + np.diag(prior)
        self._lower = cholesky(normal, lower=True, check_finite=False)
        self.noise, self.before = noise, len(self._rows) - effects
        self._size, self._deviation = size, np.sqrt(variance)
        own = self._rows @ residual / noise
        self._solved = solve_triangular(self._lower, own - score_bias, lower=True)
        self._residual = residual / noise
        inner = solve_triangular(self._lower, own, lower=True)
        self.square = float(self._residual @ self._residual - inner @ inner)
        self.log_determinant = 2 * float(np.log(np.diag(self._lower))[len(flat) :].sum())

    def solution(self) -> tuple[Array, Array]:
        """Return the minimum (q + k,) of what is marginalised, in the columns' units, and its covariance."""
        scale = np.concatenate([1 / self._size, self._deviation])
        inverse = solve_triangular(self._lower, np.diag(scale), lower=True)
        return -inverse.T @ self._solved, inverse.T @ inverse

    def left(self) -> Array:
        """Return the innovations (3n,) less the mean of what is marginalised, in units of the noise."""
        result: Array = self._residual - self._rows.T @ solve_triangular(
            self._lower, self._solved, lower=True, trans=1
        )
        return result

    def see(self, columns: Array, score_bias: Array) -> Seen:
        """Return reach and score of columns (N, 3n) with score bias (N,)."""
        reach = solve_triangular(self._lower, self._rows @ columns.T / self.noise, lower=True).T
        own = columns @ (self._residual / self.noise) - score_bias / self.noise**2
        return Seen(reach, own - reach @ self._solved)

    def signal(self) -> Array:
        """Return what the effects explain together (3n,), in units of the noise."""
        value = solve_triangular(self._lower, self._solved, lower=True, trans=1)
        result: Array = value[self.before :] @ self._rows[self.before :]
        return result
