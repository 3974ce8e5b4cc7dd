"""The evidence of innovations as a function of the amplitudes of columns that the model does not contain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.model.projector import Projector


class EvidenceOfAmplitudes(NamedTuple):
    """ln Z of innovations as a function of the amplitudes of k columns, both after projection.

    Attributes:
        gram, score, square: products of the columns, of these with the innovations, and of the innovations.
        freedom: number of values that the model leaves.
        determinant: log determinant of the columns whose amplitudes are given.
    """

    gram: Array
    score: Array
    square: float
    freedom: int
    determinant: float = 0.0

    @classmethod
    def of(cls, base: Array, innovation: Array, columns: Array, gram: Array) -> EvidenceOfAmplitudes:
        """Project innovations (1, 3n) and columns (k, 3n) with products `gram` (k, k) on the complement of a model's
        columns (q, 3n)."""
        project = Projector(base)
        left, within = project(innovation)[0], project.within(columns)
        return cls(gram - within @ within.T, columns @ left, float(left @ left), len(left) - len(base))

    def given(self, columns: slice, deviations: Array) -> EvidenceOfAmplitudes:
        """Return it as a function of the amplitudes of the other columns, if those of some have these deviations."""
        every = np.arange(len(self.score))
        others, own = np.delete(every, columns), every[columns][deviations > 0]
        upper, y = self._solved(own, deviations[deviations > 0])
        across = deviations[deviations > 0, None] * self.gram[np.ix_(own, others)]
        across = dtrtrs(upper, across, lower=0, trans=1)[0] if len(own) else across
        return self._replace(
            gram=self.gram[np.ix_(others, others)] - across.T @ across,
            score=self.score[others] - y @ across,
            square=self.square - float(y @ y),
            determinant=self.determinant + _log_determinant(upper),
        )

    def log(self, deviations: Array, fixed: bool = False) -> tuple[float, float]:
        """Return ln Z and ρ; ρ is at least 1, and 1 if `fixed`."""
        upper, y = self._solved(np.flatnonzero(deviations > 0), deviations[deviations > 0])
        rest = max(self.square - float(y @ y), 1e-9)
        variance = 1.0 if fixed else max(rest / self.freedom, 1.0)
        logs = self.determinant + _log_determinant(upper) + self.freedom * float(np.log(variance))
        return -0.5 * (rest / variance + logs), float(np.sqrt(variance))

    def _solved(self, own: np.ndarray, d: Array) -> tuple[Array, Array]:
        """Return the Cholesky factor Lᵀ (u, u) of some columns with deviations (u,), and L⁻¹ √Λ Z v (u,)."""
        if not len(own):
            return np.zeros((0, 0)), np.zeros(0)
        inner = (self.gram if len(own) == len(self.gram) else self.gram[np.ix_(own, own)]) * (d[:, None] * d)
        inner.flat[:: len(d) + 1] += 1.0
        # Of the transpose, which is the same matrix in LAPACK's order.
        upper = dpotrf(inner.T, lower=0, overwrite_a=1, clean=0)[0]
        return upper, dtrtrs(upper, d * self.score[own], lower=0, trans=1)[0]


def _log_determinant(upper: Array) -> float:
    return 2 * float(np.log(upper.diagonal()).sum())
