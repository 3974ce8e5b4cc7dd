"""The effects that a search has found, and their places among the terms of its model."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.scores.score import Score


@dataclass(frozen=True, eq=False)
class Found:
    """An effect that was added.

    Two steps that are terms of one score have half its evidence each, as long as there are two.

    Attributes:
        name: of the catalogue.
        statistic, threshold, evidence: of its test when it was added.
        rivals: names that this motion cannot distinguish from it.
        noise: its test, if it is an effect on the noise.
        of: the score of which it is a term.
        unsure: True if a missing channel may be the cause instead; to correct it could increase the heading error.
        improbable: True if the posterior of all sets of effects is against it: a term of the model, but no name.
    """

    name: str
    statistic: float
    threshold: float
    evidence: float
    rivals: tuple[str, ...] = ()
    noise: NoiseScore | None = None
    of: Score | None = None
    unsure: bool = False
    improbable: bool = False

    def times(self, factor: float) -> Found:
        """Return it with its evidence multiplied by a factor."""
        numbers = {name: factor * getattr(self, name) for name in ("statistic", "threshold", "evidence")}
        return replace(self, **numbers)


def as_found(score: NoiseScore) -> Found:
    """Return a noise effect as an effect that was found."""
    return Found(score.name, score.statistic, score.threshold, score.evidence, noise=score)


def term_places(found: Sequence[Found], model: Model) -> dict[int, int]:
    """Return {place in `found`: place among the model's terms}, in order; terms of a given model come before them."""
    of_terms = [place for place, f in enumerate(found) if f.name in TERMS]
    given = len(model.terms) - len(of_terms)
    return {place: given + index for index, place in enumerate(of_terms)}


def less(found: Sequence[Found], places: Container[int]) -> tuple[Found, ...]:
    """Return the effects without those at some places; one step that remains of two gets the evidence of both."""
    kept = [f for place, f in enumerate(found) if place not in places]

    def whole(one: Found) -> Found:
        before, now = (sum(f.of is one.of for f in every) for every in (found, kept))
        return one if one.of is None or before == now else one.times(before / now)

    return tuple(whole(f) for f in kept)
