"""All candidates with their evidence, probability and status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from magyc_gtsam.gap.effects import LABELS, TERMS
from magyc_gtsam.gap.effects.term import EffectTerm
from magyc_gtsam.gap.evidence.candidates import what_matters
from magyc_gtsam.gap.evidence.detectable import ENOUGH, power_of
from magyc_gtsam.gap.evidence.generic import families
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import Weighed
from magyc_gtsam.gap.naming.named import Found, Named
from magyc_gtsam.gap.result import Hypothesis, Status, Verdict
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.noise_effects import NoiseScore

_HARDLY = 0.005  # a probability that is 0 in per cent


def hypotheses(
    result: Named, names: Sequence[str], found: Sequence[Found], word: Verdict, discrete: Sequence[NoiseScore]
) -> tuple[Hypothesis, ...]:
    """Return all candidates with their evidence beside the model without effects, strongest first.

    Args:
        result: the effects that are named, and the model with them.
        names: candidates.
        found: the effects, with those that were corrected before.
        word: the verdict.
        discrete: tests of the latter.
    """
    named = {f.name for f in found} if word in ("closed", "open") else set()
    rivals = {r for f in found for r in f.rivals} if word in ("closed", "open") else set()
    places = {family.name: family.place for family in families(result.first.refit.twin)}
    weighed = [one for one in result.tree.bare.found.values() if one.name in (*TERMS, *places)]
    every = [_hypothesis(one, result, places, named, rivals) for one in weighed]
    noise = (each for each in (*discrete, *result.first.noise) if each.name in names)
    every += [_noise_hypothesis(each, named, result.probabilities) for each in noise]
    return tuple(sorted(every, key=lambda one: -one.evidence))


def _hypothesis(
    weighed: Weighed, result: Named, places: Mapping[str, str], named: set[str], rivals: set[str]
) -> Hypothesis:
    name, term, twin = weighed.name, TERMS.get(weighed.name), result.first.refit.twin
    significant, power = weighed.log > ENOUGH, power_of(name, weighed.everywhere) if term else np.nan
    probability = result.probabilities.get(name, 0.0) if term else np.nan
    value, covariance = weighed.estimate
    scale, matters = np.ones(len(value)), np.nan
    if term:
        scale = term.scale * what_matters(twin, name, weighed.setting, len(value))
        matters = float(scale.max())
    status: Status
    if name in named:
        status, words = "named", "named"
    elif significant and name in rivals:
        status, words = "ambiguous", "this motion cannot tell it from the effect that was named"
    elif probability >= PRIOR.improbable:
        status, words = "possible", "too improbable to be named"
    elif significant and named:
        status, words = "explained", "significant, but improbable beside the effects that are named"
    elif significant:
        status, words = "significant", "significant"
    elif term and power < RULES.would_be_found:
        status, words = "not enough information", _hardly_found(term, matters, power, len(value))
    elif term:
        status, words = "rejected", "not significant, though what matters would have been found"
    else:
        status, words = "rejected", "not significant"
    return Hypothesis(
        name=name,
        label=term.label if term else f"anything in {places[name]}",
        generic=term is None,
        evidence=weighed.log,
        significant=significant,
        parameters=len(value),
        expected=value * scale,
        sigma=np.sqrt(np.diag(covariance)) * scale,
        unit=term.unit if term else "",
        setting=dict(weighed.setting),
        power=power,
        matters=matters,
        probability=probability,
        status=status,
        sentence=words,
    )


def _hardly_found(term: EffectTerm, matters: float, power: float, count: int) -> str:
    of_one = " in the parameter that this motion determines least" if count > 1 else ""
    found = f"be found with probability {power:.0%} only" if power >= _HARDLY else "hardly ever be found"
    return f"the smallest value that matters ({matters:.2g} {term.unit}){of_one} would {found}"


def _noise_hypothesis(noise: NoiseScore, named: set[str], probabilities: Mapping[str, float]) -> Hypothesis:
    unit, scale = noise.shown
    status: Status
    if noise.name in named:
        status, words = "named", "named"
    elif noise.significant and named:
        status, words = "explained", "significant until the effects above were added"
    elif noise.significant:
        status, words = "significant", "significant"
    else:
        status, words = "rejected", "strong, but not of its form" if noise.strong else "not significant"
    return Hypothesis(
        name=noise.name,
        label=LABELS[noise.name],
        generic=False,
        evidence=noise.evidence,
        significant=noise.significant,
        parameters=len(noise.value),
        expected=noise.value * scale,
        sigma=noise.sigma * scale,
        unit=unit,
        setting=dict(noise.setting),
        power=np.nan,
        matters=np.nan,
        probability=probabilities.get(noise.name, 0.0),
        status=status,
        sentence=words,
    )
