"""The log evidence of the terms of a model at its minimum: amplitudes marginalised, scales averaged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import what_matters
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import scales_of
from magyc_gtsam.gap.model.field_variation import FieldVariation
from magyc_gtsam.gap.model.refit import Refit

_START, _SWEEPS = 4.0, 2  # of the scales: each is averaged with the others at their most probable values


@dataclass(frozen=True, eq=False)
class Terms:
    """The terms of a model.

    Attributes:
        base: (q, 3n) whitened columns of the parameters.
        columns: (k, 3n) whitened columns of the terms, in units of the smallest effect that matters.
        score_bias: (k,) their score bias.
        of_term: (k,) index of the term of each column.
        residual: (3n,) innovations of the model without the terms.
    """

    base: Array
    columns: Array
    score_bias: Array
    of_term: np.ndarray
    residual: Array

    def beside(self, variation: FieldVariation | None) -> Beside:
        """Marginalise the parameters and the field's variation."""
        return Beside.of_varying(self.residual, self.base, np.zeros(len(self.base)), variation)

    def added_to(self, rest: Beside, scale: Array, without: int | None = None) -> Beside:
        """Marginalise the terms, of scales (t,), beside the rest; all of them, or all but one."""
        kept = self.of_term != (-1 if without is None else without)
        return rest.with_effects(self.columns[kept], scale[self.of_term][kept] ** 2, self.score_bias[kept])

    def information(self, rest: Beside) -> tuple[Array, Array]:
        """Return information (k, k) and score (k,) of their values beside the rest."""
        seen = rest.see(self.columns, self.score_bias)
        return self.columns @ self.columns.T / rest.noise**2 - seen.reach @ seen.reach.T, seen.score

    @classmethod
    def of(cls, fit: Refit) -> Terms:
        twin, terms = fit.twin, fit.model.terms
        rows, none = [fit.rows_of(index) for index in range(len(terms))], np.zeros(0)
        places = np.concatenate([none.astype(int), *rows])
        units = [what_matters(twin, t.name, t.setting, len(own)) for t, own in zip(terms, rows, strict=True)]
        unit = np.concatenate([none, *units])
        value = np.concatenate([none, *(fit.value_of(index)[0] for index in range(len(terms)))])
        columns = twin.base_columns[places] * unit[:, None]
        return cls(
            np.delete(twin.base_columns, places, axis=0),
            columns,
            twin.base_score_bias[places] * unit,
            np.repeat(np.arange(len(terms)), [len(own) for own in rows]),
            twin.residual().ravel() - (value / unit) @ columns,
        )


@dataclass(frozen=True, eq=False)
class Explained:
    """What the terms of a model explain beside the rest.

    Attributes:
        information, score, of_term: (k, k), (k,) and term (k,) of each value.
        nats: (t,) evidence that each term adds to the others.
    """

    information: Array
    score: Array
    of_term: np.ndarray
    nats: Array

    def powers(self, among: Sequence[int]) -> dict[tuple[int, int], float]:
        """Return the powers of some terms, without the others.

        Entry (i, i) is the power that i explains beside the rest of them. Entry (i, j) is the power that i may have as
        a deviation of j from its form: that of the part of j's signal that i could explain, or what both explain
        together times the share of i's signature that j absorbs, whichever is larger.
        """
        some = np.isin(self.of_term, list(among))
        information, of_term = self.information[np.ix_(some, some)], self.of_term[some]
        inverse = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
        value = inverse @ self.score[some]
        own = {i: of_term == i for i in among}
        alone = {i: np.linalg.pinv(information[np.ix_(own[i], own[i])], hermitian=True) for i in among}
        result = {}
        for i, j in combinations_with_replacement(among, 2):
            both = own[i] | own[j]
            power = value[both] @ np.linalg.pinv(inverse[np.ix_(both, both)], hermitian=True) @ value[both]
            for mine, other in {(i, j), (j, i)}:
                result[mine, other] = float(power)
                if i != j:
                    across = information[np.ix_(own[mine], own[other])]
                    share = np.trace(across @ alone[other] @ across.T)
                    share /= max(np.trace(information[np.ix_(own[mine], own[mine])]), 1e-300)
                    to_it = across @ value[own[other]]
                    result[mine, other] = float(max(power * share, to_it @ alone[mine] @ to_it))
        return result


def marginal(terms: Terms, plain: Beside, fit: Refit) -> tuple[float, Array, Explained, float]:
    """Marginalise the terms of a model.

    Returns:
        The log evidence of the terms beside the rest, nats; their most probable scales (t,); what they explain; and the
        remaining square.
    """
    count = len(fit.model.terms)
    if not count:
        return 0.0, np.zeros(0), Explained(np.zeros((0, 0)), np.zeros(0), terms.of_term, np.zeros(0)), plain.square
    information, score = terms.information(plain)

    def nats(scale: Array) -> float:
        variance = scale[terms.of_term] ** 2
        spread = np.eye(len(score)) + variance[:, None] * information
        gain = score @ np.linalg.solve(spread, variance * score)
        return 0.5 * float(gain - np.linalg.slogdet(spread)[1])

    scale = np.full(count, _START)
    each: list[Array] = []
    for _ in range(_SWEEPS):
        each = []
        for i, term in enumerate(fit.model.terms):
            likely = PRIOR.scales[scales_of(term.name)]
            tried = np.array([nats(np.where(np.arange(count) == i, one, scale)) for one in likely])
            scale[i] = likely[int(np.argmax(tried))]
            each.append(tried)
    spread = np.array([float(np.logaddexp.reduce(t) - t.max() - np.log(len(t))) for t in each])
    total = nats(scale)
    alone = np.array(
        [total + own - nats(np.where(np.arange(count) == i, 0.0, scale)) for i, own in enumerate(spread)]
    )
    inverse = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
    value = inverse @ score
    explained = Explained(information, score, terms.of_term, alone)
    return total + float(spread.sum()), scale, explained, plain.square - float(score @ value)
