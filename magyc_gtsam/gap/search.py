"""Naming: which effect is added next, what it cannot be told from, and when the search ends.

Forward by the penalised score (evidence: −ln p against the white twin), decided by the twin with the data's own
colour, vetoed where held-out blocks gain nothing; everything is refitted jointly after each addition, and what has
become superfluous is taken out again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import Noise
from magyc_gtsam.factors.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.fine import Fine, fine_innovations, noise_scores
from magyc_gtsam.gap.naming import (
    LEFT,
    NOISE_LIMIT,
    Found,
    Look,
    as_found,
    choose,
    leftover,
    rivals_of,
    stands,
    switched,
    term_places,
)
from magyc_gtsam.gap.neighbours import product_of
from magyc_gtsam.gap.noise_effects import NoiseScore
from magyc_gtsam.gap.problem import Active, Model, Problem
from magyc_gtsam.gap.refined import nearer, sharpened, sharpest
from magyc_gtsam.gap.refit import Refit, refit, with_term, without_term
from magyc_gtsam.gap.score import (
    Score,
    held_out_gain,
    interleaved,
    scan,
)
from magyc_gtsam.gap.tones import heard, silenced
from magyc_gtsam.recording import Recording

MOST_TERMS = 5
_BLOCKS = 8  # of the held-out veto, at least: each half must hold some of every manoeuvre


@dataclass(frozen=True, eq=False)
class Search:
    """The state of a search.

    Attributes:
        recording, problem: the data, without what was found to be wrong samples.
        first, last: looks at the base model and at the final one.
        found: effects in the order of adding; see `naming.term_places`.
        leftover: names of what is significant in the last look and was neither added nor vetoed, and colour for which
            what is missing may pass.
    """

    recording: Recording
    problem: Problem
    first: Look
    last: Look
    found: tuple[Found, ...]
    leftover: tuple[str, ...] = ()
    vetoed: frozenset[str] = field(default_factory=frozenset)


def look(recording: Recording, refitted: Refit, names: tuple[str, ...], random: np.random.Generator) -> Look:
    """Score everything against a model."""
    scores, innovation, projector = scan(refitted.twin, names, random)
    scores = [
        sharpened(s, refitted, innovation, projector) if s.significant and "until" in s.variant.setting else s
        for s in scores
    ]
    scores.sort(key=lambda s: -s.evidence)
    fine = fine_innovations(recording, refitted.model)
    noise = noise_scores(recording, fine, NOISE_LIMIT)
    gains = {s.name: _gain(refitted, s, innovation) for s in scores if s.evidence > 3.0}
    return Look(refitted, scores, noise, fine, innovation, projector, gains)


def _gain(refitted: Refit, score: Score, innovation: Array) -> float:
    twin = refitted.twin
    length = 10.0 if score.generic else TERMS[score.name].block(score.variant.setting)
    length = min(length, (twin.time[-1] - twin.time[0]) / _BLOCKS)
    return held_out_gain(twin.base_columns, score.variant.columns, innovation, interleaved(twin.time, length))


def search(
    recording: Recording,
    problem: Problem,
    base: Refit,
    short_term: Noise,
    names: tuple[str, ...],
    prepare: Callable[[Recording], Problem],
    progress: Callable[[float], None],
    seed: int = 0,
) -> Search:
    """Add effects until nothing is significant."""
    random = np.random.default_rng(seed)
    allowed = tuple(n for n in names if n in TERMS)
    current = base
    first = now = look(recording, current, allowed, random)
    found: list[Found] = []
    noted: set[str] = set()
    failed: set[str] = set()
    instead: tuple[str, ...] = ()
    for turn in range(MOST_TERMS + 3):
        progress(0.2 + 0.1 * turn)
        choice = choose(now, names, noted, found, failed)
        if choice is None:
            break
        if isinstance(choice, NoiseScore):
            noted.add(choice.name)
            if choice.name == "quantisation":
                noted.add("coloured-noise")  # the error of a coarse step hangs together as the reading does
            if choice.name == "tone":
                line = heard(recording, current.model, choice.setting["frequency"])
                recording = silenced(recording, [line])
                choice = replace(choice, value=line.value, sigma=line.sigma, setting=line.setting)
            elif choice.name == "spikes":
                recording = _without(recording, now.fine, choice)
            if choice.name in ("tone", "spikes"):
                problem = prepare(recording)
                current = refit(problem, current.model, short_term)
            found.append(as_found(choice))
        else:
            if len(current.model.terms) >= MOST_TERMS:
                break
            rivals = rivals_of(choice, now)
            sharp = sharpest(choice, now.refit, now.innovation, now.projector)
            instead = nearer(choice.name, sharp, now)
            if instead:
                break
            setting = dict(sharp.setting)
            added = _terms(choice.name, current, setting)
            model = current.model
            for term in added:
                model = with_term(model, term)
            ahead = _tried(problem, model, short_term)
            if ahead is None:
                failed.add(choice.name)
                continue
            current = ahead
            share = 1 / len(added)
            found += [
                Found(
                    choice.name,
                    choice.statistic * share,
                    choice.threshold * share,
                    choice.evidence * share,
                    rivals,
                )
                for _ in added
            ]
            current, found = _backwards(problem, current, found, short_term)
        now = look(recording, current, allowed, random)
        wider = _wider(now)
        if wider is not None and (ahead := _tried(problem, wider.model, short_term)) is not None:
            found = [_stronger(f, wider.score) if f.name == wider.score.name else f for f in found]
            current = ahead
            now = look(recording, current, allowed, random)
    # It is in no model, so that what is real of it is still there; of the rest another effect made it seem.
    loud = {noise.name for noise in now.noise if noise.significant}
    found = [f for f in found if f.name != "coloured-noise" or f.name in loud]
    left = tuple(dict.fromkeys((*instead, *switched(found), *leftover(now, first, found, noted))))
    if left:
        coloured = tuple(f.name for f in found if f.name == "coloured-noise")
        kept, found = _firm(problem, current, found, first, now, left, short_term)
        left = (*left, *coloured)
        if kept is not current:
            current = kept
            now = look(recording, current, allowed, random)
    return Search(recording, problem, first, now, tuple(found), left)


def _firm(
    problem: Problem,
    current: Refit,
    found: list[Found],
    first: Look,
    now: Look,
    left: tuple[str, ...],
    short_term: Noise,
) -> tuple[Refit, list[Found]]:
    """Without the terms that lean on what is missing: those that a generic family would absorb."""
    places = term_places(found, current.model)
    # A line at the motion's frequencies that is stronger than a name is what the name was mistaken for.
    line = max((n.evidence for n in first.noise if n.name == "tone" and not n.significant), default=0.0)
    loose = {
        place: index
        for place, index in places.items()
        if found[place].evidence < line
        or _again(found[place], now, left)
        or found[place].name in {product_of(name) for name in left}
        or not stands(current, index, found[place], now, left)
    }
    model = current.model
    for index in reversed(loose.values()):
        model = without_term(model, index)
    kept = [f for i, f in enumerate(found) if i not in loose]
    kept = [f for f in kept if f.name != "coloured-noise"]  # for which what is missing would pass
    return (refit(problem, model, short_term) if loose else current), kept


def _again(one: Found, now: Look, left: tuple[str, ...]) -> bool:
    """Whether an effect is wanted oftener than it may be had, and nearly as much: steps in a row are no step."""
    more = max((s.statistic for s in now.scores if s.name == one.name), default=np.inf)
    return one.name in left and more > LEFT * one.statistic


class _Wider(NamedTuple):
    """A model with more modes of a drift, and the score that wants them."""

    model: Model
    score: Score


def _wider(now: Look) -> _Wider | None:
    """With more modes of a drift that is in the model, where they are wanted."""
    model = now.refit.model
    for index, term in enumerate(model.terms):
        if term.setting.get("order", 0) < 1:
            continue
        score = next((s for s in now.scores if s.name == term.name and s.significant), None)
        if score is None or now.gains.get(term.name, 0.0) <= 0:
            continue
        if score.variant.setting["order"] <= term.setting["order"]:
            continue
        value = np.zeros(len(now.refit.twin.columns(term.name, score.variant.setting).window))
        value[: len(term.value)] = term.value
        terms = (*model.terms[:index], Active(term.name, score.variant.setting, value), *model.terms[index + 1 :])
        return _Wider(replace(model, terms=terms), score)
    return None


def _stronger(found: Found, more: Score) -> Found:
    """An effect of which more was found."""
    return replace(found, statistic=found.statistic + more.statistic, evidence=found.evidence + more.evidence)


def _terms(name: str, current: Refit, setting: dict[str, float]) -> list[Active]:
    """The term of a setting; of a thing attached and taken off, the two steps; of the gyroscope's matrix all of it.

    A part of the matrix may be all that the motion shows, yet the rest of it is no better known: its prior holds it.
    """
    settings = [{} if name in ("gyro-scale", "gyro-quadratic") else setting]
    if "until" in setting:
        settings = [{"time": setting["time"]}, {"time": setting["until"]}]
    return [Active(name, each, np.zeros(len(current.twin.columns(name, each).window))) for each in settings]


def _backwards(
    problem: Problem, current: Refit, found: list[Found], short_term: Noise
) -> tuple[Refit, list[Found]]:
    """Take out terms whose value has become insignificant beside the others."""
    while len(current.model.terms) > 1:
        weakest, least = -1, 1.0
        places = term_places(found, current.model)
        for place, index in places.items():
            value, covariance = current.value_of(index)
            strength = float(value @ np.linalg.pinv(covariance) @ value) / found[place].threshold
            if strength < least:
                weakest, least = place, strength
        if weakest < 0:
            break
        current = refit(problem, without_term(current.model, places[weakest]), short_term)
        found = [f for i, f in enumerate(found) if i != weakest]
    return current, found


def _tried(problem: Problem, model: Model, short_term: Noise) -> Refit | None:
    """The refit of a model; None where the data do not determine the new term beside the rest."""
    try:
        ahead = refit(problem, model, short_term)
    except MagycError:
        return None
    return ahead if ahead.converged else None


def _without(recording: Recording, fine: Fine, spikes: NoiseScore) -> Recording:
    """The recording without its wrong samples."""
    assert spikes.rows is not None
    wrong = np.isin(recording.time, fine.time[spikes.rows])
    return replace(recording, magnetic_field_fresh=recording.magnetic_field_fresh & ~wrong)
