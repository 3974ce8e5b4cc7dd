"""Marginalisation of parameters without a prior and of effects with one, beside which a candidate is tested.

For innovations r (3n,) of variance ρ² and columns N with prior variances v (infinite for parameters), marginalisation
is weighting with M = (I − Nᵀ H⁻¹ N) / ρ², H = N Nᵀ + ρ² diag(1/v). The score bias of a column (due to the gyroscope's
noise in its own regressors) is projected in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.model.field_variation import FieldVariation
from magyc_gtsam.gap.model.twin import Twin

LEAST = 1e-7  # of the largest information, below which a direction is left out
_RIDGE = 1e-10  # of a parameter's information, added so that undetermined directions have a solution


class Seen(NamedTuple):
    """What columns have in common with a marginalised model.

    Attributes:
        reach: (N, m) of the columns into what is marginalised.
        score: (N,) after marginalisation.
        on_signal: (N,) products with what the effects explain together (`Beside.signal`).
    """

    reach: Array
    score: Array
    on_signal: Array


@dataclass(frozen=True, eq=False)
class Beside:
    """The marginalised model.

    Attributes:
        noise: ρ.
        before: number of columns that are marginalised before those of effects.
        _parameters: number of those without a prior.
        _unit: (m,) units of the columns: 1 / |N| without a prior, √v with one.
        _lower: (m, m) Cholesky factor L of H in these units.
        _white: (m, 3n) L⁻¹ N / ρ, the columns in these units.
        _residual: (3n,) r / ρ.
        _inner, _solved: (m,) L⁻¹ N r / ρ², without and with the score bias.
    """

    noise: float
    before: int
    _parameters: int
    _unit: Array
    _lower: Array
    _white: Array
    _residual: Array
    _inner: Array
    _solved: Array

    @classmethod
    def of(
        cls, residual: Array, flat: Array, soft: Array, variance: Array, score_bias: Array, noise: float = 1.0
    ) -> Beside:
        """Marginalise columns without a prior (q, 3n), and with variances (k,) (k, 3n), of score bias (q + k,)."""
        size = np.sqrt(np.einsum("pn,pn->p", flat, flat))
        unit = np.concatenate([1 / np.where(size > 0, size, 1.0), np.sqrt(variance)])
        rows = np.concatenate([flat, soft]) * (unit / noise)[:, None]
        prior = np.concatenate([np.full(len(flat), _RIDGE / noise**2), np.ones(len(soft))])
        lower = cholesky(rows @ rows.T + np.diag(prior), lower=True, check_finite=False)
        white = solve_triangular(lower, rows, lower=True, check_finite=False)
        inner = white @ residual / noise
        solved = inner - solve_triangular(lower, score_bias * unit / noise**2, lower=True)
        return cls(noise, len(rows), len(flat), unit, lower, white, residual / noise, inner, solved)

    @classmethod
    def of_varying(
        cls, residual: Array, flat: Array, score_bias: Array, variation: FieldVariation | None
    ) -> Beside:
        """Marginalise columns without a prior (q, 3n), of score bias (q,), and a variation of the field."""
        components, noise = (flat[:0], 1.0) if variation is None else (variation.components, variation.noise)
        variance, none = np.full(len(components), noise**2), np.zeros(len(components))
        return cls.of(residual, flat, components, variance, np.concatenate([score_bias, none]), noise)

    @classmethod
    def of_model(cls, twin: Twin, variation: FieldVariation | None = None) -> Beside:
        """Marginalise the parameters and terms of a model, none with a prior, and a variation of the field."""
        return cls.of_varying(twin.residual().ravel(), twin.base_columns, twin.base_score_bias, variation)

    def with_effects(self, columns: Array, variance: Array, score_bias: Array) -> Beside:
        """Marginalise the columns (k, 3n) of effects, with variances (k,) and score bias (k,), too."""
        unit = np.sqrt(variance)
        rows = columns * (unit / self.noise)[:, None]
        reach = rows @ self._white.T
        lower = cholesky(rows @ rows.T + np.eye(len(rows)) - reach @ reach.T, lower=True, check_finite=False)
        white = solve_triangular(lower, rows - reach @ self._white, lower=True, check_finite=False)
        own = rows @ self._residual - score_bias * unit / self.noise**2
        solved = solve_triangular(lower, own - reach @ self._solved, lower=True)
        return replace(
            self,
            _unit=np.concatenate([self._unit, unit]),
            _lower=np.block([[self._lower, np.zeros(reach.T.shape)], [reach, lower]]),
            _white=np.concatenate([self._white, white]),
            _inner=np.concatenate([self._inner, white @ self._residual]),
            _solved=np.concatenate([self._solved, solved]),
        )

    def rest(self) -> Beside:
        """Return the model without its effects."""
        m = self.before
        return replace(
            self,
            _unit=self._unit[:m],
            _lower=self._lower[:m, :m],
            _white=self._white[:m],
            _inner=self._inner[:m],
            _solved=self._solved[:m],
        )

    @property
    def square(self) -> float:
        """Return rᵀ M r."""
        return float(self._residual @ self._residual - self._inner @ self._inner)

    @property
    def log_determinant(self) -> float:
        """Return that of I + V N Nᵀ / ρ², after marginalisation of the parameters."""
        return 2 * float(np.log(np.diag(self._lower))[self._parameters :].sum())

    def solution(self) -> tuple[Array, Array]:
        """Return the minimum (q + k,) of what is marginalised, in the columns' units, and its covariance."""
        inverse = solve_triangular(self._lower, np.diag(self._unit), lower=True)
        return -inverse.T @ self._solved, inverse.T @ inverse

    def left(self) -> Array:
        """Return the innovations (3n,) less the mean of what is marginalised, in units of the noise."""
        result: Array = self._residual - self._solved @ self._white
        return result

    def see(self, columns: Array, score_bias: Array) -> Seen:
        """Return what columns (N, 3n) with score bias (N,) have in common with the model."""
        found = columns @ np.concatenate([self._white, self._pulls]).T  # the columns are read once
        found /= self.noise
        return Seen(found[:, :-2], found[:, -2] - score_bias / self.noise**2, found[:, -1])

    @cached_property
    def _pulls(self) -> Array:
        """(2, 3n) what pulls at a column, and the effects' signal."""
        return np.stack([self.left(), self.signal])

    @cached_property
    def signal(self) -> Array:
        """(3n,) what the effects explain together, in units of the noise."""
        value = solve_triangular(self._lower, self._solved, lower=True, trans=1)
        result: Array = value[self.before :] @ self._lower[self.before :] @ self._white
        return result
