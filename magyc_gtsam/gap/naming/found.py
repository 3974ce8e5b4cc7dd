"""The effects that are named, and their places among the terms of the model."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.samples.noise_effects import NoiseScore


@dataclass(frozen=True, eq=False)
class Found:
    """An effect that is named.

    Attributes:
        name: of the catalogue.
        statistic: Wald statistic of its values; of an effect on the noise, that of its test.
        rivals: names that this motion cannot distinguish from it.
        noise: its test, if it is an effect on the noise.
    """

    name: str
    statistic: float
    rivals: tuple[str, ...] = ()
    noise: NoiseScore | None = None


def as_found(score: NoiseScore, rivals: tuple[str, ...] = ()) -> Found:
    """Return an effect on the noise, or the variation of the field, as an effect that was found."""
    return Found(score.name, score.statistic, rivals, noise=score)


def term_places(found: Sequence[Found], model: Model) -> dict[int, int]:
    """Return {place in `found`: place among the model's terms}, in order; terms of a given model come before them."""
    of_terms = [place for place, f in enumerate(found) if f.name in TERMS]
    given = len(model.terms) - len(of_terms)
    return {place: given + index for index, place in enumerate(of_terms)}


def less(found: Sequence[Found], places: Container[int]) -> tuple[Found, ...]:
    """Return the effects without those at some places."""
    return tuple(one for place, one in enumerate(found) if place not in places)
