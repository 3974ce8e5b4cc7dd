"""The named effects of the score tests, checked against the posterior of all sets of effects.

Score tests compare an effect with noise. In a room the field varies, and any smooth function explains much of it. The
posterior includes the field variation of the place in every set, and gives the probability of each effect beside it.
An improbable effect is not named; it is a part of the field's variation where that is nearly certain, and a misfit
without a name elsewhere. If in addition all probable effects are named and an unknown one is improbable, all remaining
misfit is this variation. If an unknown effect is nearly certain, that remains.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
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
from magyc_gtsam.gap.search.found import Found, less, term_places
from magyc_gtsam.gap.search.search import Search

_OF_NOISE = (COLOUR, "tone")  # effects that a varying field may resemble


def weighed(result: Search, said: Answer, short_term: SensorNoise) -> Search:
    """Remove the improbable effects of a search, and name the field's variation where it is nearly certain.

    Args:
        result: of the search.
        said: the posterior of the same recording.
        short_term: noise of the sensors between neighbouring samples.
    """
    stated = marginals(said.posterior)
    against = {place for place, one in enumerate(result.found) if _improbable(one, said.posterior)}
    left = result.leftover
    variation = said.tree.best.variation
    if variation is not None and variation.evident and stated.get(FIELD_VARIATION, 0.0) > PRIOR.sure:
        kept = _without(result, against, short_term)
        if stated[UNKNOWN] < 1 - PRIOR.sure and not _missing(kept.found, stated):
            left = tuple(name for name in left if name == CLOCK_DRIFT)
        score = _score(variation)
        field = Found(FIELD_VARIATION, score.statistic, 0.0, score.evidence, noise=score)
        kept = replace(kept, found=(*kept.found, field))
    else:
        left = (*left, *(result.found[place].name for place in sorted(against)))
        kept = _marked(result, against)
    if stated[UNKNOWN] > PRIOR.sure and not result.leftover:
        left = (*_likeliest_family(said), *left)
    return replace(kept, leftover=tuple(dict.fromkeys(left)))


def _marked(result: Search, against: Container[int]) -> Search:
    """Mark improbable effects, which stay in the model as a description of the remaining misfit."""
    found = tuple(replace(one, improbable=place in against) for place, one in enumerate(result.found))
    return replace(
        result, found=less(found, {p for p, one in enumerate(found) if one.improbable and one.name in _OF_NOISE})
    )


def _improbable(one: Found, posterior: Mapping[Set, float]) -> bool:
    """Return whether an effect and its rivals together are improbable, whatever else is present."""
    if one.name not in TERMS and one.name not in _OF_NOISE:
        return False
    names = {one.name, *one.rivals}
    return sum(p for (there, _), p in posterior.items() if not names.isdisjoint(there)) < PRIOR.improbable


def _missing(found: Sequence[Found], stated: Mapping[str, float]) -> bool:
    """Return whether a probable effect was not found."""
    named = {name for one in found for name in (one.name, *one.rivals)}
    return any(stated.get(name, 0.0) > PRIOR.likely and name not in named for name in TERMS)


def _likeliest_family(said: Answer) -> tuple[str, ...]:
    """Return the most probable generic family, by which an unknown effect is described."""
    families = [e for e in said.tree.best.found.values() if e.name not in TERMS and product_of(e.name) is None]
    return tuple(each.name for each in sorted(families, key=lambda each: -each.log)[:1])


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
