"""Score tests: the gain in likelihood from adding each candidate, for all candidates together, without a refit.

The innovations of a candidate are projected on the complement of the base model's columns and made orthonormal, so that
its statistic is ‖d‖², d = Cᵀ v, and its expected value R⁻¹ d. A grid search (over the time of a step, for example) is a
set of variants, of which the best counts.

Thresholds come from the twin: its innovations are drawn (white, or with the colour of the data's) and projected in the
same way. The upper tail of a candidate's largest −ln p over its variants is exponential, and is extrapolated from the
upper tenth of the draws; tables of χ² account neither for the grid search nor for the colour.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import ncx2

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.model.variants import Projector, Variant, determined, ready, variant, variants
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.scores.generic import Family, families
from magyc_gtsam.gap.scores.neighbours import neighbours
from magyc_gtsam.gap.scores.null import TAIL, Draws, colour, quantile, surprises, tail

DRAWS = 500


@dataclass(frozen=True, eq=False)
class Score:
    """The score test of a candidate.

    Attributes:
        name: of the catalogue or of a generic family.
        generic: True for a generic family.
        place: the variable that a generic family depends on, in words.
        variants: all settings of the grid search.
        best: index of the best variant.
        statistic: ‖d‖² of the best variant.
        evidence: −ln of its p-value for white innovations, corrected for the grid search; ranks the candidates.
        significance: the same for innovations with the colour of the data, if that is less; decides.
        threshold: the family-wise level of `statistic`.
        limit: the family-wise level of `significance`.
        expected, covariance: expected value (k,) and its covariance (k, k).
    """

    name: str
    generic: bool
    place: str
    variants: tuple[Variant, ...]
    best: int
    statistic: float
    evidence: float
    significance: float
    threshold: float
    limit: float
    expected: Array
    covariance: Array

    @property
    def variant(self) -> Variant:
        """Return the best variant."""
        return self.variants[self.best]

    @property
    def significant(self) -> bool:
        """Return whether it passes the family-wise level."""
        return self.significance > self.limit

    def smallest(self, twin: Twin) -> float:
        """Return the smallest value of a named effect that matters, for its least determined parameter."""
        term = TERMS[self.name]
        each = np.broadcast_to(term.matters / term.deviations(twin, self.variant.setting), self.expected.shape)
        return float(each[np.argmax(np.diag(self.covariance) / each**2)])

    def power(self, twin: Twin) -> float:
        """Return the probability that the smallest value of a named effect that matters passes the threshold."""
        if not len(self.variant.unit):
            return 0.0
        term = TERMS[self.name]
        sigma = np.sqrt(np.diag(self.covariance)) * term.deviations(twin, self.variant.setting)
        size = (term.matters / max(float(sigma.max()), 1e-300)) ** 2
        return float(ncx2.sf(self.threshold, len(self.variant.unit), size))


def candidates(twin: Twin, project: Projector, names: tuple[str, ...]) -> dict[str, tuple[str, list[Variant]]]:
    """Return {name: (place, variants)} of the named effects that can be tested, then of the generic families."""
    result: dict[str, tuple[str, list[Variant]]] = {}
    for name in names:
        term = TERMS[name]
        if term.missing(twin):
            continue
        settings = term.settings(twin)
        if settings:
            many = variants(twin, project, name, settings)
            result[name] = (
                "",
                [determined(v, RULES.determined * term.matters) for v in many] if term.many_shapes else many,
            )
    beside = [f for active in twin.model.terms for f in neighbours(twin, active.name, active.setting)]
    for family in (*families(twin), *{f.name: f for f in beside}.values()):
        result[family.name] = (family.place, _parts(family, twin, project))
    return result


def _parts(family: Family, twin: Twin, project: Projector) -> list[Variant]:
    """Return the variants of a generic family: the whole, and its parts."""
    columns = family.columns(twin)
    rows = twin.whiten(columns)
    score_bias = np.zeros(len(rows)) if columns.score_bias is None else columns.score_bias
    result = [determined(variant({}, rows, project, score_bias), family.within)]
    for width in family.parts:
        whole = len(rows) // width
        settings = [{"first": float(width * i), "width": float(width)} for i in range(whole)]
        parts = rows[: whole * width].reshape(whole, width, -1)
        result += ready(settings, parts, project, score_bias[: whole * width].reshape(whole, width))
        if whole * width < len(rows):
            rest = {"first": float(whole * width), "width": float(width)}
            result.append(variant(rest, rows[whole * width :], project, score_bias[whole * width :]))
    return result


def scan(twin: Twin, names: tuple[str, ...], random: np.random.Generator) -> tuple[list[Score], Array, Projector]:
    """Score every candidate against the twin's model.

    Returns:
        The scores, strongest first, the projected innovations, and the projection.
    """
    project = Projector(twin.base_columns, twin.base_score_bias)
    innovation = project(twin.residual().reshape(1, -1))[0]
    found = candidates(twin, project, names)
    flat = [(name, index) for name, (_, many) in found.items() for index in range(len(many))]
    units = np.concatenate([found[name][1][index].unit for name, index in flat], dtype=np.float32)
    ranks = np.array([len(found[name][1][index].unit) for name, index in flat])
    starts = np.concatenate([[0], np.cumsum(ranks)])[:-1]
    white = random.standard_normal((innovation.size, DRAWS), dtype=np.float32)

    def drawn(windows: Array) -> Array:
        rows = twin.innovations(windows, random.standard_normal((len(windows), 3, twin.n - 1)))
        return project(rows.reshape(len(rows), -1)).reshape(rows.shape)

    coloured = colour(_without_best(innovation, found).reshape(3, -1), drawn, white)
    null_white = _statistics(units @ white, starts, ranks)
    null_coloured = null_white if coloured is white else _statistics(units @ coloured, starts, ranks)
    limit = float(np.log(len(found) / RULES.family_wise))
    scores = []
    first = 0
    for name, (place, many) in found.items():
        rows = slice(first, first + len(many))
        first += len(many)
        score_vectors = [v.score(innovation) for v in many]
        statistics = np.array([d @ d for d in score_vectors])
        surprise = surprises(statistics[:, None], ranks[rows])[:, 0]
        best = int(np.argmax(surprise))
        chosen = many[best]
        level_white, slope = tail(null_white[rows], ranks[rows])
        level = level_white
        if coloured is not white:
            level, slope = tail(null_coloured[rows], ranks[rows])
        rank = max(int(ranks[rows][best]), 1)
        beyond = limit + np.log(1 - TAIL)
        needed = max(level + slope * beyond, level_white + beyond)
        evidence = float(surprise[best] - level_white - np.log(1 - TAIL))  # slope 1 for white innovations
        significance = float((surprise[best] - level) / slope - np.log(1 - TAIL))
        scores.append(
            Score(
                name=name,
                generic=name not in TERMS,
                place=place,
                variants=tuple(many),
                best=best,
                statistic=float(statistics[best]),
                evidence=evidence,
                significance=min(significance, evidence),
                threshold=float(quantile(needed, rank)),
                limit=limit,
                expected=-chosen.back @ score_vectors[best],
                covariance=chosen.back @ chosen.back.T,
            )
        )
    scores.sort(key=lambda s: -s.evidence)
    return scores, innovation, project


def _without_best(innovation: Array, found: Mapping[str, tuple[str, list[Variant]]]) -> Array:
    """Subtract what the best named effect explains, if much, from the innovations: it would count as their colour."""
    named = [v for name, (_, many) in found.items() if name in TERMS for v in many if len(v.unit)]
    score_vectors = [v.score(innovation) for v in named]
    if not named:
        return innovation
    best = int(np.argmax([d @ d - 2 * len(d) for d in score_vectors]))
    if score_vectors[best] @ score_vectors[best] < RULES.much:
        return innovation
    return innovation - named[best].unit.T @ score_vectors[best]


def _statistics(d: Draws, starts: np.ndarray, ranks: np.ndarray) -> Array:
    """Return the squared lengths (variants, draws) of stacked scores d."""
    padded = np.concatenate([d * d, np.zeros((1, d.shape[1]), d.dtype)])
    result = np.add.reduceat(padded, starts, axis=0).astype(float)
    result[ranks == 0] = 0.0
    return result


def held_out_gain(base: Array, columns: Array, residual: Array, block: Array) -> float:
    """Return the gain in log-likelihood (nats) of adding columns, on blocks of rows that were not fitted.

    Args:
        base: (q, rows) whitened.
        columns: (k, rows) whitened.
        residual: (rows,) whitened.
        block: (rows,) 0 or 1.
    """
    gain = 0.0
    design = np.concatenate([base, columns])
    size = np.maximum(np.sqrt(np.einsum("pn,pn->p", design, design)), 1e-300)[:, None]
    design = design / size
    for fold in (0, 1):
        train, test = block != fold, block == fold
        seen = design[:, train]
        normal, score = seen @ seen.T, seen @ residual[train]
        normal[np.diag_indices_from(normal)] += 1e-9
        errors = []
        for count in (len(base), len(design)):
            solution = np.linalg.solve(normal[:count, :count], score[:count])
            errors.append(residual[test] - solution @ design[:count, test])
        gain += 0.5 * float(errors[0] @ errors[0] - errors[1] @ errors[1])
    return gain


def interleaved(time: Array, length: float) -> Array:
    """Return alternately 0 and 1 (3n,) in blocks of `length` s, for innovations stacked axis by axis."""
    return np.tile(np.floor((time - time[0]) / length).astype(int) % 2, 3)
