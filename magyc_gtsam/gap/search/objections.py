"""Objections to the named effects: remaining misfit, families that explain more, and terms that depend on a misfit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.refit import Refit, without_term
from magyc_gtsam.gap.model.variants import Projector, variant
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.scores.neighbours import product_of
from magyc_gtsam.gap.search.found import Found
from magyc_gtsam.gap.search.naming import NOISE_LIMIT, Look, faint, shape_of, weights

_CHANGING = ("hard-iron-step", "local-anomaly", "hard-iron-drift", "temperature-hard-iron")


def stands(current: Refit, index: int, found: Found, now: Look, left: tuple[str, ...]) -> bool:
    """Return whether a term keeps its evidence when the families that are still significant are in the model, too.

    A correct term keeps the part of its explanation that the families do not contain; its own products are tested
    separately. Compared with families that contain most of its signature, it must explain the larger part itself: an
    effect that may lie along any of so many values would hardly lie along the few of the term by chance.
    """
    twin = current.twin
    term = twin.model.terms[index]
    columns = twin.columns(term.name, term.setting)
    own = twin.whiten(columns)
    score_bias = np.zeros(len(own)) if columns.score_bias is None else columns.score_bias
    value, _ = current.value_of(index)
    without = replace(twin, model=without_term(twin.model, index))
    target = twin.residual().ravel() - value @ own  # the residual without the term

    def explained(rows: Array, score_biases: Array, beside: list[tuple[Array, Array]]) -> tuple[Array, Array]:
        """Return the part (3n,) of the residual that columns explain beside others, and their directions."""
        project = Projector(np.concatenate([b for b, _ in beside]), np.concatenate([p for _, p in beside]))
        result = variant(term.setting, rows, project, score_biases)
        return result.score(project(target[None])[0]) @ result.unit, result.unit

    beside = [(without.base_columns, without.base_score_bias)]
    all_of_it, alone = explained(own, score_bias, beside)
    holding: list[tuple[Array, Array]] = []
    for other in (
        s.variant for s in now.scores if s.name in left and term.name not in (s.name, product_of(s.name))
    ):
        _, unit = explained(other.columns, other.score_bias, beside[:1])
        holds = _squared(alone @ unit.T) > (1 - RULES.little) * len(alone)
        (holding if holds else beside).append((other.columns, other.score_bias))
    still, rest = explained(own, score_bias, beside)
    statistic, kept = _squared(still), _squared(rest @ all_of_it)
    if statistic <= max(RULES.strong * found.threshold, RULES.firm * kept):
        return False
    if not holding:
        return True
    rows, score_biases = (np.concatenate(part) for part in zip(*holding, strict=True))
    more, unit = explained(rows, score_biases, [*beside, (own, score_bias)])
    return statistic > RULES.mostly * (statistic + _squared(more) - len(unit))


def _squared(values: Array) -> float:
    return float(np.vdot(values, values))


def switched(found: Sequence[Found]) -> tuple[str, ...]:
    """Return the effects that change with time, if there are so many that an unknown cause must be changing."""
    changing = [f.name for f in found if f.name in _CHANGING]
    return tuple(dict.fromkeys(changing)) if len(changing) > RULES.changes else ()


def leftover(now: Look, first: Look, found: Sequence[Found], noted: set[str]) -> tuple[str, ...]:
    """Return the names that are still significant, beyond what the found effects leave by their approximate form.

    They include generic families that explained the data clearly better than all names together.
    """
    bent = weights(now.refit)  # of terms found in this search, or given
    explained = max([s.statistic for s in first.scores] + bent, default=0.0)
    named = any(f.name in TERMS for f in found)
    all_named = max(sum(f.statistic for f in found if f.name in TERMS), *bent, 0.0)
    if not named or any(f.name == "coloured-noise" for f in found):
        all_named = np.inf  # no named effect to compare with, or statistics that are those of the colour
    result = ahead_of_names(first, found)
    for score in now.scores:
        excess = score.statistic - len(score.variant.unit)
        # A family of many values hardly gains on held-out data; it counts if it explains more than all named effects.
        many = score.generic and len(score.variant.unit) > RULES.many
        more = many and excess > all_named
        if not score.significant or (now.gains.get(score.name, 0.0) <= 0 and not more):
            continue
        if (found or bent) and excess < RULES.shape * explained:
            continue
        if not score.generic and (faint(score, found) or shape_of(score, now.refit, found)):
            continue
        result.append(score.name)
    for noise in now.noise:
        loud = noise.evidence > NOISE_LIMIT and noise.name in ("tone", "coloured-noise")
        if (
            loud
            and noise.name not in noted
            and not ((found or bent) and noise.statistic < RULES.shape * explained)
        ):
            result.append(noise.name)
    return tuple(dict.fromkeys(result))


def ahead_of_names(first: Look, found: Sequence[Found]) -> list[str]:
    """Return the generic families that explained the data clearly better than all names together."""
    evidence = [f.evidence for f in found if f.name in TERMS]
    if not evidence:
        return []
    named = sum(evidence)
    ahead = named + max(RULES.beats[0], RULES.beats[1] * named)
    return [
        s.name
        for s in first.scores
        if s.generic and s.significant and s.evidence > ahead and first.gains.get(s.name, 0.0) > 0
    ]
