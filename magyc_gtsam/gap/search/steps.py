"""The steps of a search: what the choice of one effect does to the data, the model and the names found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.forms import Setting
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.problem import Active, Model, Problem
from magyc_gtsam.gap.model.refit import Refit, refit, with_term, without_term
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.coarse import unrounded
from magyc_gtsam.gap.samples.fine import Fine
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.samples.tones import heard, silenced
from magyc_gtsam.gap.scores.score import Score
from magyc_gtsam.gap.search.naming import Found, Look, any_change, as_found, less, related, rivals_of, term_places
from magyc_gtsam.recording import Recording

Prepare = Callable[[Recording], Problem]
_PASSES = 2  # of the model, from readings with steps to one without


@dataclass(frozen=True, eq=False)
class State:
    """How far a search is.

    Attributes:
        recording, problem: the data, without what was found to be wrong samples, and without tones.
        current: the model at its minimum.
        found: the names, in the order of adding; see `naming.term_places`.
        short_term: noise of the sensors between neighbouring samples.
    """

    recording: Recording
    problem: Problem
    current: Refit
    found: tuple[Found, ...]
    short_term: SensorNoise

    def refitted(self, model: Model) -> Refit | None:
        """Another model at its minimum; None where the data do not determine its terms beside the rest."""
        try:
            ahead = refit(self.problem, model, self.short_term, self.current.twin)
        except MagycError:
            return None
        return ahead if ahead.converged else None


def with_noise(state: State, now: Look, choice: NoiseScore, prepare: Prepare) -> State:
    """With an effect on the noise named; tones and steps are taken out of the readings, wrong samples left out."""
    recording = state.recording
    if choice.name == "tone":
        line = heard(recording, state.current.model, choice.setting["frequency"])
        recording = silenced(recording, [line])
        choice = replace(choice, value=line.value, sigma=line.sigma, setting=line.setting)
    elif choice.name == "spikes":
        recording = _without(recording, now.fine, choice)
    elif choice.name == "quantisation":
        return _with_steps(state, now, choice, prepare)
    return _with_recording(replace(state, found=(*state.found, as_found(choice))), recording, prepare)


def _with_steps(state: State, now: Look, choice: NoiseScore, prepare: Prepare) -> State:
    """With coarse steps named and what they add on average taken out, by a model that is then a better one."""
    result = replace(state, found=(*state.found, as_found(choice)))
    for _ in range(_PASSES):
        smooth = unrounded(
            result.recording, state.recording, result.current.model, float(choice.value[0]), now.fine.level
        )
        result = _with_recording(result, smooth, prepare)
    return result


def _with_recording(state: State, recording: Recording, prepare: Prepare) -> State:
    if recording is state.recording:
        return state
    problem = prepare(recording)
    current = refit(problem, state.current.model, state.short_term)
    return replace(state, recording=recording, problem=problem, current=current)


def with_effect(state: State, now: Look, choice: Score, sharp: Score) -> State | None:
    """With an effect added as it is sharpest, and what has become superfluous taken out; None: not determined."""
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
    """With the evidence of rivals that an effect has made superfluous added to its own: it explains that too."""
    own = sum(f.of is sharp for f in after.found)
    statistic, evidence = (_of_rivals(before.found, sharp) - _of_rivals(after.found, sharp)) / max(own, 1)

    def more(found: Found) -> Found:
        return replace(found, statistic=found.statistic + statistic, evidence=found.evidence + evidence)

    return replace(after, found=tuple(more(f) if f.of is sharp else f for f in after.found))


def _of_rivals(found: Sequence[Found], sharp: Score) -> Array:
    """(2,) statistic and evidence of all that are confused with an effect."""
    rivals = [(f.statistic, f.evidence) for f in found if f.of is not None and related(f.name, sharp.name)]
    return np.sum([(0.0, 0.0), *rivals], axis=0)


def with_more_modes(state: State, now: Look) -> State | None:
    """With more modes of a drift that is in the model; None where they are not wanted."""
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
    """An effect of which more was found."""
    return replace(found, statistic=found.statistic + more.statistic, evidence=found.evidence + more.evidence)


def terms_of(name: str, current: Refit, setting: Setting) -> list[Active]:
    """The term of a setting; of a thing attached and taken off, the two steps; of the gyroscope's matrix all of it.

    A part of the matrix may be all that the motion shows, yet the rest of it is no better known: its prior holds it.
    """
    settings: list[Setting] = [{} if name == "gyro-scale" else dict(setting)]
    if "until" in setting:
        settings = [{"time": setting["time"]}, {"time": setting["until"]}]
    return [Active(name, each, np.zeros(len(current.twin.columns(name, each).window))) for each in settings]


def _backwards(state: State) -> State:
    """Take out terms whose value has become insignificant beside the others, or what a rival leaves of its form."""
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
    """What a term must explain lest it be no more than the form of its strongest rival among `found` (indices)."""
    own, most = current.model.terms[index], 0.0
    for other in found:
        rival = current.model.terms[other]
        rough = TERMS[rival.name].rough
        if not related(rival.name, own.name):
            continue
        if not rough and (own.setting.get("uneven") or rival.setting.get("uneven")):
            continue  # no filter of all axes alike leaves something else on each
        asked = RULES.left * current.weight_of(other)
        most = max(most, asked if rough else min(asked, 2 * RULES.weak))
    return most


def _without(recording: Recording, fine: Fine, spikes: NoiseScore) -> Recording:
    """The recording without its wrong samples."""
    assert spikes.rows is not None
    wrong = np.isin(recording.time, fine.time[spikes.rows])
    return replace(recording, magnetic_field_fresh=recording.magnetic_field_fresh & ~wrong)
