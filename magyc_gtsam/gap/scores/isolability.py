"""Effects that can be named with a motion, their smallest strength, and the effects they would be confused with.

The strength is the length of an effect's vector of values. Values of random directions, with the noise of the twin, are
subjected to the score tests; an effect is confused with the names that often explain as much or more.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq
from scipy.stats import ncx2

from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.effects.term import EffectTerm
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.variants import Variant
from magyc_gtsam.gap.result import Isolability
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.noise_isolability import noise_isolability
from magyc_gtsam.gap.scores.look import ScoreTests, look
from magyc_gtsam.gap.scores.null import quantile, surprises
from magyc_gtsam.gap.scores.score import Score
from magyc_gtsam.recording import Recording

_DIRECTIONS = 500  # of the values, over which the power is averaged
_TRIALS = 60  # of naming an effect
# nats: a twentieth of the probability is 3; as much again for values and settings, which a score does not pay for
_AS_GOOD = 6.0


def isolability(recording: Recording) -> tuple[Isolability, ...]:
    """Return the table for a motion.

    Args:
        recording: of the motion, real or simulated, with its noise.

    Raises:
        MagycError: the motion or the data do not allow a calibration.
    """
    noise = short_term_noise(recording)
    random = np.random.default_rng(0)
    now = _named_only(look(recording, base_model(recording, None, noise), tuple(TERMS), random))
    scores = {score.name: score for score in now.scores}
    terms = tuple(
        _row(term, scores[name], now, random) if name in scores else _absent(term, term.missing(now.refit.twin))
        for name, term in TERMS.items()
    )
    return (*terms, *noise_isolability(recording, noise.magnetometer))


def _named_only(now: ScoreTests) -> ScoreTests:
    """Return a look at the named effects only, without score bias."""
    scores = [
        replace(s, variants=tuple(replace(v, offset=np.zeros_like(v.offset)) for v in s.variants))
        for s in now.scores
        if not s.generic
    ]
    return replace(now, scores=scores)


def _row(term: EffectTerm, score: Score, now: ScoreTests, random: np.random.Generator) -> Isolability:
    typical = score.variants[len(score.variants) // 2]
    shown = term.scale / float(np.median(term.deviations(now.refit.twin, typical.setting)))
    seen = _seen(term, typical, now, random)
    smallest = _found_from(seen, score)
    confused: dict[str, float] = {}
    if np.isfinite(smallest):
        signatures = max(smallest, term.matters) * seen[:_TRIALS] @ typical.unit
        confused = _confused(term.name, signatures, now, random)
    words = f"from {smallest * shown:.2g} {term.unit} on" if np.isfinite(smallest) else "not found at any strength"
    if smallest > term.matters:
        words += f", where {term.matters * shown:.2g} would matter"
    if confused:
        words += f", as {' or '.join((term.name, *confused))}, which this motion can hardly tell apart"
    nameable = smallest <= term.matters and not confused
    return Isolability(
        term.name,
        term.label,
        smallest * shown,
        term.unit,
        term.matters * shown,
        typical.left,
        nameable,
        confused,
        words if nameable else f"{words}; {term.motion}",
    )


def _seen(term: EffectTerm, one: Variant, now: ScoreTests, random: np.random.Generator) -> Array:
    """Return scores (directions, r) of values of length 1, without the part that the motion does not determine."""
    values = random.standard_normal((_DIRECTIONS, len(one.columns)))
    values /= np.linalg.norm(values, axis=1)[:, None]
    seen: Array = (values / term.deviations(now.refit.twin, one.setting)) @ (one.columns @ one.unit.T)
    return seen


def _found_from(seen: Array, score: Score) -> float:
    """Return the strength found with probability 0.9, for scores `seen` (directions, r) of values of length 1."""
    rank = seen.shape[1]
    if rank == 0:
        return float("inf")
    # The threshold applies to the best setting, whose rank may differ; the same −ln p is required at this rank.
    threshold = quantile(_surprise(score.threshold, score), rank)
    size = (seen**2).sum(axis=1)

    def power(strength: float) -> float:
        return float(ncx2.sf(threshold, rank, strength**2 * size).mean())

    # At this strength even the worst determined direction is found.
    enough = np.sqrt((4 * threshold + 100) / size.min())
    return float(
        np.exp(brentq(lambda log: power(np.exp(log)) - RULES.found_with, np.log(1e-6 * enough), np.log(enough)))
    )


def _confused(name: str, signatures: Array, now: ScoreTests, random: np.random.Generator) -> dict[str, float]:
    """Return the other names that explain an effect as well as the best, with their share of the trials.

    Only names above `RULES.confused` are returned, the most frequent first.

    Args:
        name: of the effect.
        signatures: (trials, 3n) of the effect, whitened.
        now: the look.
        random: source of the noise.
    """
    given: list[set[str]] = []
    for trial in _trials(now, signatures + random.standard_normal(signatures.shape)):
        best = trial.scores[0]
        if best.significant:
            given.append({s.name for s in trial.scores if best.evidence - s.evidence < _AS_GOOD})
    often = Counter(other for names in given for other in names - {name})
    return {
        other: count / len(given) for other, count in often.most_common() if count > RULES.confused * len(given)
    }


def _trials(now: ScoreTests, innovations: Array) -> list[ScoreTests]:
    """Return looks with other innovations (trials, 3n)."""
    scores = zip(*(_rescored(score, innovations) for score in now.scores), strict=True)
    return [
        replace(now, scores=sorted(each, key=lambda s: -s.evidence), innovation=innovation)
        for each, innovation in zip(scores, innovations, strict=True)
    ]


def _rescored(score: Score, innovations: Array) -> list[Score]:
    """Return a score with other innovations (trials, 3n)."""
    ranks = np.array([len(v.unit) for v in score.variants])
    d = np.concatenate([v.unit for v in score.variants]) @ innovations.T
    statistics = np.array([(part**2).sum(axis=0) for part in np.split(d, np.cumsum(ranks)[:-1])])
    surprise = surprises(statistics, ranks)
    level = _surprise(score.threshold, score)
    searched = _surprise(score.statistic, score) - score.evidence
    return [
        replace(
            score,
            best=best,
            statistic=float(statistics[best, trial]),
            evidence=float(surprise[best, trial]) - searched,
            significance=float(surprise[best, trial]) - level + score.limit,
            threshold=quantile(level, max(int(ranks[best]), 1)),
        )
        for trial, best in enumerate(np.argmax(surprise, axis=0))
    ]


def _surprise(statistic: float, score: Score) -> float:
    """Return −ln p of a statistic at the best setting of a score."""
    return float(surprises(np.array([[statistic]]), np.array([len(score.variant.unit)]))[0, 0])


def _absent(term: EffectTerm, missing: tuple[str, ...]) -> Isolability:
    return Isolability(
        term.name,
        term.label,
        float("inf"),
        term.unit.replace("per unit", "per deviation"),
        term.matters * term.scale,
        0.0,
        False,
        {},
        f"cannot be tested without {' and '.join(missing) or 'more data'}",
    )
