"""All candidates with their evidence, probability and status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from magyc_gtsam.gap.effects import LABELS, TERMS
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.naming.found import Found
from magyc_gtsam.gap.outcome.described import IN_TESLA
from magyc_gtsam.gap.result import Hypothesis, Status, Verdict
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.scores.look import ScoreTests
from magyc_gtsam.gap.scores.score import Score


def hypotheses(
    look: ScoreTests,
    names: Sequence[str],
    found: Sequence[Found],
    word: Verdict,
    discrete: Sequence[NoiseScore],
    probabilities: Mapping[str, float],
) -> tuple[Hypothesis, ...]:
    """Return all candidates with their evidence, strongest first.

    Args:
        look: the score tests of the base model.
        names: candidates.
        found: the effects.
        word: the verdict.
        discrete: scores of effects that were corrected before the look.
        probabilities: of all names.
    """
    named = {f.name for f in found} if word in ("closed", "open") else set()
    rivals = {r for f in found for r in f.rivals} if word in ("closed", "open") else set()
    result = [(s.evidence, _hypothesis(s, look, named, rivals, probabilities)) for s in look.scores]
    result += [
        (n.evidence, _noise_hypothesis(n, named, probabilities))
        for n in (*discrete, *look.noise)
        if n.name in names
    ]
    return tuple(h for _, h in sorted(result, key=lambda pair: -pair[0]))


def _hypothesis(
    score: Score, look: ScoreTests, named: set[str], rivals: set[str], probabilities: Mapping[str, float]
) -> Hypothesis:
    term = TERMS.get(score.name)
    power = score.power(look.refit.twin) if term else 1.0
    matters = score.smallest(look.refit.twin) if term else 0.0
    probability = probabilities.get(score.name, 0.0) if term else np.nan
    scale = term.scale if term else 1.0
    status: Status
    if score.name in named:
        status, words = "named", "named"
    elif score.significant and score.name in rivals:
        status, words = "ambiguous", "this motion cannot tell it from the effect that was named"
    elif probability >= PRIOR.improbable:
        status, words = "possible", "too improbable to be named"
    elif score.significant and named:
        status, words = "explained", "significant, but improbable beside the effects that are named"
    elif score.significant:
        status, words = "significant", "significant"
    elif term and power < RULES.would_be_found:
        status, words = (
            "not enough information",
            f"the smallest effect that matters ({matters * scale:.2g} {term.unit}) would be found with "
            f"probability {power:.0%} only",
        )
    else:
        status, words = "rejected", "not significant, though what matters would have been found"
    sigma = np.sqrt(np.diag(score.covariance))
    return Hypothesis(
        name=score.name,
        label=term.label if term else f"anything in {score.place}",
        generic=score.generic,
        statistic=score.statistic,
        threshold=score.threshold,
        significant=score.significant,
        parameters=len(score.expected),
        expected=score.expected * scale,
        sigma=sigma * scale,
        unit=term.unit if term else "",
        setting=dict(score.variant.setting),
        power=power,
        matters=matters * scale,
        probability=probability,
        status=status,
        sentence=words,
    )


def _noise_hypothesis(noise: NoiseScore, named: set[str], probabilities: Mapping[str, float]) -> Hypothesis:
    scale = 1e6 if noise.name in IN_TESLA else 1.0
    status: Status
    if noise.name in named:
        status, words = "named", "named"
    elif noise.significant:
        status, words = (
            ("explained", "significant until the effects above were added") if named else ("significant",) * 2
        )
    else:
        of_form = "not significant" if noise.statistic < noise.threshold else "strong, but not of its form"
        status, words = "rejected", of_form
    return Hypothesis(
        name=noise.name,
        label=LABELS[noise.name],
        generic=False,
        statistic=noise.statistic,
        threshold=noise.threshold,
        significant=noise.significant,
        parameters=len(noise.value),
        expected=noise.value * scale,
        sigma=noise.sigma * scale,
        unit="µT" if scale > 1 else "",
        setting=dict(noise.setting),
        power=1.0,
        matters=0.0,
        probability=probabilities.get(noise.name, 0.0),
        status=status,
        sentence=words,
    )
