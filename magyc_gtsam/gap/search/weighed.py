"""The named effects of the score tests, checked against the posterior of all sets of effects.

Score tests compare an effect with noise. In a room the field varies, and any smooth function explains much of it. The
posterior includes the field variation of the place in every set, and gives the probability of each effect beside it.
An improbable effect is not corrected. If the posterior is sure of the field's variation, contains all probable effects
and no unknown one, the remaining misfit of the score tests is this variation. If it is sure of an unknown effect, that
remains.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.answer import COLOUR, Answer
from magyc_gtsam.gap.evidence.decision import UNKNOWN, marginals
from magyc_gtsam.gap.evidence.posterior import Set
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import FIELD_VARIATION
from magyc_gtsam.gap.model.field_variation import FieldVariation
from magyc_gtsam.gap.model.refit import refit, without_term
from magyc_gtsam.gap.preparation.clocks import CLOCK_DRIFT
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.scores.neighbours import product_of
from magyc_gtsam.gap.search.naming import Found, less, term_places
from magyc_gtsam.gap.search.search import Search

_OF_NOISE = (COLOUR, "tone")  # effects that a varying field may resemble


def weighed(result: Search, said: Answer, short_term: SensorNoise) -> Search:
    """Remove or mark the improbable effects of a search.

    Args:
        result: of the search.
        said: the posterior of the same recording.
        short_term: noise of the sensors between neighbouring samples.
    """
    stated = marginals(said.posterior)
    doubtful = {place for place, one in enumerate(result.found) if _improbable(one, said.posterior)}
    variation = said.tree.best.variation
    if variation is None or not variation.evident or not _of_the_place(result, stated, doubtful):
        return _with_unknown(_marked(result, doubtful), said, stated[UNKNOWN])
    kept = _without(result, doubtful, short_term)
    score = _score(variation)
    found = Found(FIELD_VARIATION, score.statistic, 0.0, score.evidence, noise=score)
    left = tuple(name for name in result.leftover if name == CLOCK_DRIFT)
    return replace(kept, found=(*kept.found, found), leftover=left)


def _marked(result: Search, doubtful: Container[int]) -> Search:
    """Mark improbable effects; improbable effects on the noise become part of the remaining misfit."""
    found = tuple(replace(one, improbable=place in doubtful) for place, one in enumerate(result.found))
    other = {place: one.name for place, one in enumerate(found) if one.improbable and one.name in _OF_NOISE}
    left = dict.fromkeys((*result.leftover, *other.values()))
    return replace(result, found=less(found, other), leftover=tuple(left))


def _with_unknown(result: Search, said: Answer, probability: float) -> Search:
    """Add the most probable generic family to the remaining misfit, if an unknown effect is nearly certain."""
    if result.leftover or probability < PRIOR.sure:
        return result
    best = said.tree.best
    families = [each for each in best.found.values() if each.name not in TERMS and product_of(each.name) is None]
    likeliest = max(families, key=lambda each: each.log, default=None)
    return result if likeliest is None else replace(result, leftover=(likeliest.name,))


def _improbable(one: Found, posterior: Mapping[Set, float]) -> bool:
    """Return whether an effect and its rivals together are improbable."""
    if one.name not in TERMS and one.name not in _OF_NOISE:
        return False
    names = {one.name, *one.rivals}
    return sum(p for (there, _), p in posterior.items() if not names.isdisjoint(there)) < PRIOR.improbable


def _of_the_place(result: Search, stated: Mapping[str, float], doubtful: Container[int]) -> bool:
    """Return whether the field's variation is nearly certain, and no other effect is missing."""
    named = {name for i, one in enumerate(result.found) if i not in doubtful for name in (one.name, *one.rivals)}
    missing = [name for name in TERMS if stated.get(name, 0.0) > PRIOR.likely and name not in named]
    sure = stated.get(FIELD_VARIATION, 0.0) > PRIOR.sure and stated[UNKNOWN] < 1 - PRIOR.sure
    return sure and not missing


def _without(result: Search, places: Container[int], short_term: SensorNoise) -> Search:
    """Return the search without the effects at some places."""
    indices = [i for place, i in term_places(result.found, result.last.refit.model).items() if place in places]
    found = less(result.found, places)
    if not indices:
        return replace(result, found=found)
    model = result.last.refit.model
    for index in reversed(indices):
        model = without_term(model, index)
    fitted = refit(result.problem, model, short_term)
    return replace(result, found=found, last=replace(result.last, refit=fitted))


def _score(variation: FieldVariation) -> NoiseScore:
    """Return the variation of the field as an effect that changes no reading."""
    size = float(np.hypot(variation.along, variation.attitude))
    return NoiseScore(
        FIELD_VARIATION,
        2 * variation.gain,
        0.0,
        variation.gain,
        True,
        np.array([size]),
        np.array([0.5 * size]),  # the grid of amplitudes has octaves
        {"period": variation.period, "attitude": variation.attitude},
    )
