"""Steps of a search: the change of data, model and found effects by the addition of one effect."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.forms import Setting
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.noise import SINGLE, without
from magyc_gtsam.gap.model.base import problem_of
from magyc_gtsam.gap.model.problem import Active, Model, Problem
from magyc_gtsam.gap.model.refit import Refit, refit, with_term, without_term
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.coarse import unrounded
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.scores.score import Score
from magyc_gtsam.gap.search.found import Found, as_found, less, term_places
from magyc_gtsam.gap.search.naming import Look, any_change, related, rivals_of
from magyc_gtsam.recording import Recording

_PASSES = 2  # estimates of the model, the first from readings with steps


@dataclass(frozen=True, eq=False)
class State:
    """The state of a search.

    Attributes:
        recording, problem: the data, without wrong samples and tones.
        current: the model at its minimum.
        found: the effects, in the order in which they were added; see `found.term_places`.
        short_term: noise of the sensors between neighbouring samples.
    """

    recording: Recording
    problem: Problem
    current: Refit
    found: tuple[Found, ...]
    short_term: SensorNoise

    def refitted(self, model: Model) -> Refit | None:
        """Return another model at its minimum; None if the data do not determine its terms."""
        try:
            ahead = refit(self.problem, model, self.short_term, self.current.twin)
        except MagycError:
            return None
        return ahead if ahead.converged else None


def with_noise(state: State, now: Look, choice: NoiseScore) -> State:
    """Add an effect on the noise; remove tones and rounding errors from the readings, and leave out wrong samples."""
    recording = state.recording
    if choice.name in SINGLE:
        recording, choice = without(recording, state.current.model, now.fine, choice)
    elif choice.name == "quantisation":
        return _with_steps(state, now, choice)
    return _with_recording(replace(state, found=(*state.found, as_found(choice))), recording)


def _with_steps(state: State, now: Look, choice: NoiseScore) -> State:
    """Add coarse steps, and remove their mean rounding error by means of a model that improves with each pass."""
    result = replace(state, found=(*state.found, as_found(choice)))
    for _ in range(_PASSES):
        smooth = unrounded(
            result.recording, state.recording, result.current.model, float(choice.value[0]), now.fine.level
        )
        result = _with_recording(result, smooth)
    return result


def _with_recording(state: State, recording: Recording) -> State:
    if recording is state.recording:
        return state
    problem = problem_of(recording)
    current = refit(problem, state.current.model, state.short_term)
    return replace(state, recording=recording, problem=problem, current=current)


def with_effect(state: State, now: Look, choice: Score, sharp: Score) -> State | None:
    """Add an effect at its refined setting, and remove terms that became superfluous; None if it is not determined."""
    added = terms_of(choice.name, state.current, sharp.variant.setting)
    model = state.current.model
    for term in added:
        model = with_term(model, term)
    ahead = state.refitted(model)
    if ahead is None:
        return None
    whole = Found(
        choice.name,
        sharp.statistic,
        sharp.threshold,
        sharp.evidence,
        rivals_of(choice, now),
        of=sharp,
        unsure=any_change(sharp, now),
    )
    parts = [whole.times(1 / len(added))] * len(added)
    after = _backwards(replace(state, current=ahead, found=(*state.found, *parts)))
    return _taken_over(state, after, sharp)


def _taken_over(before: State, after: State, sharp: Score) -> State:
    """Add the evidence of rivals that an effect has made superfluous to its own, because it explains that, too."""
    own = sum(f.of is sharp for f in after.found)
    statistic, evidence = (_rivals_sum(before.found, sharp) - _rivals_sum(after.found, sharp)) / max(own, 1)

    def more(found: Found) -> Found:
        return replace(found, statistic=found.statistic + statistic, evidence=found.evidence + evidence)

    return replace(after, found=tuple(more(f) if f.of is sharp else f for f in after.found))


def _rivals_sum(found: Sequence[Found], sharp: Score) -> Array:
    """Return the sums (2,) of statistic and evidence of all effects that are confused with an effect."""
    rivals = [(f.statistic, f.evidence) for f in found if f.of is not None and related(f.name, sharp.name)]
    return np.sum([(0.0, 0.0), *rivals], axis=0)


def with_more_modes(state: State, now: Look) -> State | None:
    """Return the state with more modes of a drift in the model; None if they are not significant."""
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
        ahead = state.refitted(replace(model, terms=terms))
        if ahead is None:
            return None
        found = tuple(_stronger(f, score) if f.name == score.name else f for f in state.found)
        return replace(state, current=ahead, found=found)
    return None


def _stronger(found: Found, more: Score) -> Found:
    """Return an effect with the evidence of a further score added."""
    return replace(found, statistic=found.statistic + more.statistic, evidence=found.evidence + more.evidence)


def terms_of(name: str, current: Refit, setting: Setting) -> list[Active]:
    """Return the terms of a setting.

    An object that is attached and taken off again is two steps. A part of the gyroscope's matrix adds all of it:
    although the motion shows only this part, the rest is no better known, and is constrained by its prior.
    """
    settings: list[Setting] = [{} if name == "gyro-scale" else dict(setting)]
    if "until" in setting:
        settings = [{"time": setting["time"]}, {"time": setting["until"]}]
    return [Active(name, each, np.zeros(len(current.twin.columns(name, each).window))) for each in settings]


def _backwards(state: State) -> State:
    """Remove terms that became insignificant beside the others, or no larger than a rival's deviation from its form."""
    current, found = state.current, state.found
    while len(current.model.terms) > 1:
        weakest, least = -1, 1.0
        places = term_places(found, current.model)
        for place, index in places.items():
            strength = current.weight_of(index) / max(
                found[place].threshold, _asked(current, index, places.values())
            )
            if strength < least:
                weakest, least = place, strength
        if weakest < 0:
            break
        current = refit(state.problem, without_term(current.model, places[weakest]), state.short_term)
        found = less(found, {weakest})
    return replace(state, current=current, found=found)


def _asked(current: Refit, index: int, found: Iterable[int]) -> float:
    """Return the statistic below which a term may be the deviation of a rival among `found` (indices) from its form."""
    own, most = current.model.terms[index], 0.0
    for other in found:
        rival = current.model.terms[other]
        rough = TERMS[rival.name].rough
        if not related(rival.name, own.name):
            continue
        if not rough and (own.setting.get("uneven") or rival.setting.get("uneven")):
            continue  # a filter common to all axes leaves no different remainder on each
        asked = RULES.left * current.weight_of(other)
        most = max(most, asked if rough else min(asked, 2 * RULES.weak))
    return most
