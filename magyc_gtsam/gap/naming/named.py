"""The effects that the posterior names, the model with them, and what remains without a name.

An effect is named where it is probable enough, alone or together with rivals that explain the same. These are the
effects of the median probability model (Barbieri and Berger, Ann. Statist. 32, 2004), with a limit above one half since
a wrong name costs more than a missing one. Something remains without a name where it is as probable that something else
is present: an effect that is not named, or one outside the catalogue.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace

import numpy as np

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import MOMENTS, TERMS
from magyc_gtsam.gap.effects.world import GRADIENT
from magyc_gtsam.gap.evidence.answer import COLOUR, Answer
from magyc_gtsam.gap.evidence.neighbours import product_of
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION, Node, related
from magyc_gtsam.gap.evidence.posterior import UNKNOWN, Set, marginals
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.model.problem import Active, Model
from magyc_gtsam.gap.model.refit import Refit, refit
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.samples.first import First
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.recording import Recording

_EXPLAIN = {*TERMS, FIELD_VARIATION}  # names that explain a misfit; others describe the noise
LINES = "spectral-lines"  # that never end, and are no tones


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


@dataclass(frozen=True, eq=False)
class Named:
    """The effects that are named.

    Attributes:
        recording: the data, without wrong samples and tones.
        first: the model without effects, on the recording with all its samples.
        tree: of the fitted sets.
        fitted: the model with the effects.
        found: the effects; those that are terms in the order of the model's (`term_places`).
        leftover: names of what else is present: the most probable family without a physical meaning, or `LINES` if they
            are more probable.
        probabilities: the posterior's, of all names.
        unsure: {name or `UNKNOWN`: probability} of what may be present beside them, the most probable first; empty if
            nothing is missing, or if it is probable enough that it is outside the catalogue.
    """

    recording: Recording
    first: First
    tree: Tree
    fitted: Refit
    found: tuple[Found, ...]
    leftover: tuple[str, ...]
    probabilities: Mapping[str, float]
    unsure: Mapping[str, float] = field(default_factory=dict)


def as_found(score: NoiseScore, rivals: tuple[str, ...] = ()) -> Found:
    """Return an effect on the noise, or the variation of the field, as an effect that was found."""
    return Found(score.name, score.statistic, rivals, noise=score)


def term_places(found: Sequence[Found], model: Model) -> dict[int, int]:
    """Return {place in `found`: place among the model's terms}, in order; terms of a given model come before them."""
    of_terms = [place for place, f in enumerate(found) if f.name in TERMS]
    given = len(model.terms) - len(of_terms)
    return {place: given + index for index, place in enumerate(of_terms)}


def named(said: Answer, first: First, short_term: SensorNoise) -> Named:
    """Name the effects of a recording.

    Args:
        said: the posterior of the recording.
        first: the model without effects, with the terms of a given calibration.
        short_term: noise of the sensors between neighbouring samples.
    """
    given = tuple(term.name for term in first.refit.model.terms)
    posterior = said.posterior
    stated = marginals(posterior)
    rivals = _probable(posterior, stated)
    fitted = _fitted(said.tree, rivals, given, short_term)
    found = [
        *_terms(fitted, len(given), rivals),
        *_noise(said, first, fitted, stated),
        *_varying(said.tree.best, stated),
    ]
    told = {*given, *(name for one in found for name in (one.name, *rivals.get(one.name, ())))}
    told |= _held(told)
    of_catalogue, outside = _unnamed(posterior, told)
    left = _family(said) if of_catalogue + outside > PRIOR.missing_from else ()
    absent = {n: p for n, p in stated.items() if n in {*_EXPLAIN, UNKNOWN} - told and p > PRIOR.improbable}
    unsure = absent if left and outside <= PRIOR.missing_from and absent.keys() & TERMS.keys() else {}
    return Named(said.recording, first, said.tree, fitted, tuple(found), left, stated, unsure)


def _probable(posterior: Mapping[Set, float], stated: Mapping[str, float]) -> dict[str, tuple[str, ...]]:
    """Return {effect that is named: its rivals}, the most probable first.

    Of an effect and its rivals that are probable together only, the most probable one is named; but not beside
    something unknown, since each may be a part of it.
    """
    result: dict[str, tuple[str, ...]] = {}
    known = stated.get(UNKNOWN, 0.0) <= PRIOR.missing_from
    for name in (name for name in stated if name in TERMS):
        others = [one for one in stated if one in TERMS and related(name, one) and one != name]
        rivals = tuple(one for one in others if _in_place_of(posterior, name, one))
        each = {name, *rivals}
        together = sum(p for (names, _), p in posterior.items() if not each.isdisjoint(names))
        said = {one for first, more in result.items() for one in (first, *more)}
        most = said.isdisjoint(each) and all(stated[name] >= stated[one] for one in rivals)
        if stated[name] > PRIOR.named_from or (known and most and together > PRIOR.named_from):
            result[name] = rivals
    return result


def _in_place_of(posterior: Mapping[Set, float], name: str, other: str) -> bool:
    """Return whether another effect may well be present instead of one."""
    instead = sum(p for (names, _), p in posterior.items() if other in names and name not in names)
    return instead > PRIOR.improbable


def _held(told: AbstractSet[str]) -> set[str]:
    """Return the effects that the covariance of the result allows for, named or not.

    The misalignment of the chips is estimated beside every model, the delay beside every model with an effect.
    """
    return {"misalignment", "timing"} if told & TERMS.keys() else {"misalignment"}


def _unnamed(posterior: Mapping[Set, float], told: AbstractSet[str]) -> tuple[float, float]:
    """Return the probability that something is present that is not told: of the catalogue alone, and unknown."""
    absent = _EXPLAIN - told
    of_catalogue = sum(
        p for (names, unknown), p in posterior.items() if not unknown and absent.intersection(names)
    )
    return of_catalogue, sum(p for (_, unknown), p in posterior.items() if unknown)


def _fitted(
    tree: Tree, wanted: Mapping[str, Sequence[str]], given: Sequence[str], short_term: SensorNoise
) -> Refit:
    """Return the model with the named effects, from the most probable set that contains most of them."""

    def fits(node: Node) -> tuple[int, int, float]:
        there = set(node.present) & TERMS.keys() - set(given)
        return len(there & wanted.keys()), -len(there - wanted.keys()), node.log

    node = max((node for node in tree.nodes.values() if node.names[: len(given)] == given), key=fits)
    for name in sorted(wanted.keys() - set(node.names)):  # which is in sets that were not fitted
        option = node.found.get(name)
        more = None if option is None or node.full(name) else tree.child(node, option)
        node = node if more is None else more
    terms, strong = node.fit.model.terms, node.kept
    chosen = [t for i, t in enumerate(terms) if i < len(given) or (t.name in wanted and i in strong)]
    model = replace(
        node.fit.model, terms=_each_once(part for term in chosen for part in _parts(term, node.fit.twin.time))
    )
    # The calibration takes the noise to be white and widens its covariance.
    return refit(replace(node.fit.twin.problem, colour=None), model, short_term)


def _each_once(terms: Iterable[Active]) -> tuple[Active, ...]:
    """Return terms without repetitions: one step may end where another one is."""
    return tuple({(term.name, *sorted(term.setting.items())): term for term in terms}.values())


def _parts(term: Active, time: Array) -> Iterator[Active]:
    """Yield the two steps of an object that is attached and taken off again; any other term as it is.

    A step before the first or after the last of the windows' times (n,) cannot be seen.
    """
    if "until" not in term.setting or term.name != "hard-iron-step":
        yield term
        return
    for end, sign in (("time", 1.0), ("until", -1.0)):
        if time[0] < term.setting[end] < time[-1]:
            yield replace(term, setting={"time": term.setting[end]}, value=sign * term.value)


def _terms(fitted: Refit, given: int, rivals: Mapping[str, tuple[str, ...]]) -> Iterator[Found]:
    for index, term in enumerate(fitted.model.terms[given:], given):
        missing = _without_channel(term.name, fitted.twin)
        others = tuple(dict.fromkeys((*rivals[term.name], *missing)))
        yield Found(term.name, fitted.weight_of(index), others)


def _without_channel(name: str, twin: Twin) -> list[str]:
    """Return the effects on the same sensor whose missing channel might explain a change with time."""
    if name not in MOMENTS:
        return []
    same = {other: term for other, term in TERMS.items() if term.side == TERMS[name].side}
    return [other for other, term in same.items() if term.missing(twin) and "acceleration" not in term.channels]


def _noise(said: Answer, first: First, fitted: Refit, stated: Mapping[str, float]) -> Iterator[Found]:
    """Yield the effects on single samples, and correlated noise where the field does not vary."""
    scores = [*said.left_out, first.steps[0]]
    if stated.get(COLOUR, 0.0) > PRIOR.named_from and not said.tree.best.of_colour[0]:
        scores += [one for one in First(said.recording, fitted).noise if one.name == COLOUR]
    yield from (as_found(score) for score in scores if stated.get(score.name, 0.0) > PRIOR.named_from)


def _varying(node: Node, stated: Mapping[str, float]) -> Iterator[Found]:
    """Yield the field's variation and correlated noise beside it, which change no parameter.

    Without a position the variation may be a gradient.
    """
    variation = node.variation
    if variation is None:
        return
    rivals = (GRADIENT.name,) if GRADIENT.missing(node.fit.twin) else ()
    place = {"attitude": variation.attitude, "share": variation.share_of(node.fit.twin)}
    for name, evidence, size, setting, others in (
        (COLOUR, 0.5 * node.of_colour[0], variation.colour, {"correlation_time": variation.colour_period}, ()),
        (FIELD_VARIATION, variation.gain, variation.size, {"period": variation.period, **place}, rivals),
    ):
        if size and stated.get(name, 0.0) > PRIOR.named_from:
            value, sigma = np.array([size]), np.array([0.5 * size])  # the grid of amplitudes has octaves
            yield as_found(NoiseScore(name, 2 * evidence, evidence, True, True, value, sigma, setting), others)


def _family(said: Answer) -> tuple[str, ...]:
    """Return the most probable family, or spectral lines, by which what has no name is described."""
    found = said.tree.best.found.values()
    families = {one.name: one.log for one in found if one.name not in TERMS and product_of(one.name) is None}
    if np.isfinite(said.unsteady):
        families[LINES] = said.unsteady
    return tuple(sorted(families, key=lambda name: -families[name])[:1])
