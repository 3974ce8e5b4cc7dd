"""Marginalisation of parameters without a prior and of effects with one, beside which a candidate is tested.

For innovations r (3n,) of variance ρ² and columns N with prior variances v (infinite for parameters), marginalisation
is weighting with M = (I − Nᵀ H⁻¹ N) / ρ², H = N Nᵀ + ρ² diag(1/v). The score bias of a column (due to the gyroscope's
noise in its own regressors) is projected in the same way. With H = L Lᵀ, only the few products of N with other columns
are multiplied by L⁻¹, not the long rows of N.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, cholesky, solve_triangular
from scipy.linalg.blas import dtrsm

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
        _rest: (1 + before, 3n) r / ρ, then the columns before those of effects, in their units / ρ.
        _effects: (m − before, 3n) the columns of effects, in their units / ρ.
        _inner, _solved: (m,) L⁻¹ N r / ρ², without and with the score bias.
    """

    noise: float
    before: int
    _parameters: int
    _unit: Array
    _lower: Array
    _rest: Array
    _effects: Array
    _inner: Array
    _solved: Array

    @classmethod
    def of(
        cls,
        residual: Array,
        flat: Array,
        soft: Array,
        variance: Array,
        score_bias: Array,
        noise: float = 1.0,
        gram: Array | None = None,
    ) -> Beside:
        """Marginalise columns without a prior (q, 3n), and with variances (k,) (k, 3n), of score bias (q + k,).

        Args:
            residual, flat, soft, variance, score_bias: the innovations, and these.
            noise: ρ.
            gram: (k, k) soft softᵀ, if it is known.
        """
        size, count = np.sqrt(np.einsum("pn,pn->p", flat, flat)), len(flat)
        unit = np.concatenate([1 / np.where(size > 0, size, 1.0), np.sqrt(variance)])
        rest = np.concatenate([residual[None], flat, soft])
        rest[0] /= noise
        rest[1:] *= (unit / noise)[:, None]
        flat, soft, of_soft = rest[1 : count + 1], rest[count + 1 :], unit[count:] / noise
        across = flat @ soft.T
        own = soft @ soft.T if gram is None else gram * (of_soft[:, None] * of_soft)
        ridge, prior = _RIDGE / noise**2 * np.eye(count), np.eye(len(soft))
        square = np.block([[flat @ flat.T + ridge, across], [across.T, own + prior]])
        lower = cholesky(square, lower=True, overwrite_a=True, check_finite=False)
        inner = solve_triangular(lower, rest[1:] @ rest[0], lower=True)
        solved = inner - solve_triangular(lower, score_bias * unit / noise**2, lower=True)
        return cls(noise, len(unit), count, unit, lower, rest, rest[:0], inner, solved)

    @classmethod
    def of_varying(
        cls, residual: Array, flat: Array, score_bias: Array, variation: FieldVariation | None
    ) -> Beside:
        """Marginalise columns without a prior (q, 3n), of score bias (q,), and a variation of the field."""
        if variation is None:
            return cls.of(residual, flat, flat[:0], np.zeros(0), score_bias)
        components, noise = variation.components, variation.noise
        variance, none = np.full(len(components), noise**2), np.zeros(len(components))
        bias = np.concatenate([score_bias, none])
        return cls.of(residual, flat, components, variance, bias, noise, variation.gram)

    @classmethod
    def of_model(cls, twin: Twin, variation: FieldVariation | None = None) -> Beside:
        """Marginalise the parameters and terms of a model, none with a prior, and a variation of the field."""
        return cls.of_varying(twin.residual().ravel(), twin.base_columns, twin.base_score_bias, variation)

    def with_effects(self, columns: Array, variance: Array, score_bias: Array) -> Beside:
        """Marginalise the columns (k, 3n) of effects, with variances (k,) and score bias (k,), too."""
        unit = np.sqrt(variance)
        rows = columns * (unit / self.noise)[:, None]
        known = np.concatenate([self._rest[1:] @ rows.T, self._effects @ rows.T])
        reach = solve_triangular(self._lower, known, lower=True, check_finite=False).T
        lower = cholesky(rows @ rows.T + np.eye(len(rows)) - reach @ reach.T, lower=True, check_finite=False)
        own, bias = rows @ self._rest[0], score_bias * unit / self.noise**2
        inner = solve_triangular(lower, own - reach @ self._inner, lower=True)
        solved = solve_triangular(lower, own - bias - reach @ self._solved, lower=True)
        return replace(
            self,
            _unit=np.concatenate([self._unit, unit]),
            _lower=np.block([[self._lower, np.zeros(reach.T.shape)], [reach, lower]]),
            _effects=np.concatenate([self._effects, rows]),
            _inner=np.concatenate([self._inner, inner]),
            _solved=np.concatenate([self._solved, solved]),
        )

    def rest(self) -> Beside:
        """Return the model without its effects."""
        m = self.before
        return replace(
            self,
            _unit=self._unit[:m],
            _lower=self._lower[:m, :m],
            _effects=self._effects[:0],
            _inner=self._inner[:m],
            _solved=self._solved[:m],
        )

    @property
    def square(self) -> float:
        """Return rᵀ M r."""
        return float(self._rest[0] @ self._rest[0] - self._inner @ self._inner)

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
        result: Array = self._rest[0] - self._mean[: self.before] @ self._rest[1:] - self.signal
        return result

    def see(self, columns: Array, score_bias: Array) -> Seen:
        """Return what columns (N, 3n) with score bias (N,) have in common with the model."""
        known = len(self._rest)
        found = np.empty((known + len(self._effects), len(columns)))  # a tenth faster than its transpose
        np.matmul(self._rest, columns.T, out=found[:known])
        np.matmul(self._effects, columns.T, out=found[known:])
        on_signal = self._mean[self.before :] @ found[known:] / self.noise
        seen = dtrsm(1 / self.noise, self._upper, found.T, side=1, overwrite_b=1) if len(columns) else found.T
        reach = seen[:, 1:]
        return Seen(reach, seen[:, 0] - reach @ self._solved - score_bias / self.noise**2, on_signal)

    @cached_property
    def _upper(self) -> Array:
        """(1 + m, 1 + m) Lᵀ, after a 1 for the residual, in LAPACK's order."""
        upper: Array = block_diag(1.0, self._lower).T
        return upper

    @cached_property
    def _mean(self) -> Array:
        """(m,) the mean of what is marginalised, with the opposite sign, in the units of the columns."""
        result: Array = solve_triangular(self._lower, self._solved, lower=True, trans=1)
        return result

    @cached_property
    def signal(self) -> Array:
        """(3n,) what the effects explain together, in units of the noise."""
        result: Array = self._mean[self.before :] @ self._effects
        return result

    @property
    def reach_of_signal(self) -> Array:
        """Return the reach (before,) of that into what is marginalised before the effects."""
        result: Array = self._mean[self.before :] @ self._lower[self.before :, : self.before]
        return result
