"""Adopt the set of effects of which the posterior is sure, where the score tests did not find all of it.

The score tests add one effect at a time. They stop with a misfit that they cannot name where a family explains as much
as the next effect, as on some jumps of the hard iron. The posterior compares whole sets. A set of which it is sure
replaces the search's result if each of its effects improves the prediction of held-out data.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.answer import Answer
from magyc_gtsam.gap.evidence.decision import UNKNOWN, marginals
from magyc_gtsam.gap.evidence.posterior import kept, names_of
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.model.field_variation import field_variation
from magyc_gtsam.gap.model.refit import Refit, refit
from magyc_gtsam.gap.outcome.worth import predicts
from magyc_gtsam.gap.preparation.clocks import CLOCK_DRIFT
from magyc_gtsam.gap.search.found import Found, as_found
from magyc_gtsam.gap.search.naming import any_change, untested
from magyc_gtsam.gap.search.search import Search, look


def adopted(result: Search, said: Answer, short_term: SensorNoise) -> Search:
    """Return the search's result, or the set of which the posterior is sure where that has effects not found.

    Args:
        result: of the score tests.
        said: the posterior of the same recording.
        short_term: noise of the sensors between neighbouring samples.
    """
    if result.first.refit.model.terms:
        return result  # the terms of a given calibration are kept
    sure = _sure(said)
    seen = {name for one in result.found for name in (one.name, *one.rivals)}
    if sure <= {*seen, *result.slight}:
        return result  # what is too small and weak to be named stays so
    fitted = next(_predicting(said, sure, short_term), None)
    if fitted is None:
        return result
    last = look(said.recording, fitted, result.first.tested, np.random.default_rng(0))
    alone = {one.name: one for one in result.found if one.noise is not None}
    alone |= {score.name: as_found(score) for score in said.left_out if score.name not in alone}
    return replace(
        result,
        recording=said.recording,
        problem=fitted.twin.problem,
        last=last,
        found=(*_found(fitted, result), *alone.values()),
        leftover=tuple(name for name in result.leftover if name == CLOCK_DRIFT),
        slight=tuple(name for name in result.slight if name not in sure),
    )


def _sure(said: Answer) -> frozenset[str]:
    """Return the effects of which the posterior is sure.

    It is empty if any likely effect is not sure, or if something unknown may be present.
    """
    stated = marginals(said.posterior)
    likely = frozenset(name for name in TERMS if stated.get(name, 0.0) > PRIOR.likely)
    least = min((stated[name] for name in likely), default=0.0)
    return likely if least > PRIOR.sure and stated[UNKNOWN] < 1 - PRIOR.sure else frozenset()


def _predicting(said: Answer, sure: frozenset[str], short_term: SensorNoise) -> Iterator[Refit]:
    """Yield the fits of a set, the likeliest first, of which every term improves the prediction of held-out data."""
    alike = [node for node in said.tree.nodes.values() if names_of(said.tree, node) == sure]
    nodes = sorted(alike, key=lambda node: -node.log)
    for node in nodes:
        if node.log < nodes[0].log - PRIOR.close:
            return
        terms = tuple(node.fit.model.terms[index] for index in kept(said.tree, node))
        try:
            fitted = refit(node.fit.twin.problem, replace(node.fit.model, terms=terms), short_term)
        except MagycError:
            continue
        variation = field_variation(fitted.twin)
        if fitted.converged and all(predicts(fitted, index, variation) for index in range(len(terms))):
            yield fitted


def _found(fitted: Refit, result: Search) -> Iterator[Found]:
    """Yield the record of each term.

    The posterior has excluded the rivals that were tested. Rivals whose channel is not in the log remain.
    """
    scores = {score.name: score for score in result.first.scores}
    for index, term in enumerate(fitted.model.terms):
        weight, score = fitted.weight_of(index), scores[term.name]
        seen = replace(score, statistic=weight, evidence=0.5 * weight)
        rivals = tuple(untested(term.name, fitted.twin))
        yield Found(
            term.name,
            weight,
            score.threshold,
            seen.evidence,
            rivals,
            unsure=any_change(seen, result.first),
        )
