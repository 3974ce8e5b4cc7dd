"""`find_gap` of many logs of one instrument: forward selection of effects, with a refit of all logs after each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.followed import of_one_quantity
from magyc_gtsam.calibration.noted import as_mounted, noted
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import MOMENTS, TERMS, nested, sudden
from magyc_gtsam.gap.evidence.generic import families
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION, related
from magyc_gtsam.gap.many.described import AddedEffect, told
from magyc_gtsam.gap.many.instruments import ANOTHER, instruments_of, not_of_one, strangers
from magyc_gtsam.gap.many.model import MODEL
from magyc_gtsam.gap.many.noise import noise_effects
from magyc_gtsam.gap.many.one_log import OneLog
from magyc_gtsam.gap.many.result import GapOfMany, LogLeftOut, SharedEffect, Weight
from magyc_gtsam.gap.many.weighing import WeighedOverLogs, look_over
from magyc_gtsam.gap.model.refit import refit, widened, with_free_delay
from magyc_gtsam.gap.outcome.corrected import as_calibration
from magyc_gtsam.gap.outcome.doubt import doubt_of_clipped, doubted, why_clipped
from magyc_gtsam.gap.outcome.judged import judged
from magyc_gtsam.gap.outcome.verdict import among, missing
from magyc_gtsam.gap.result import Doubt, Verdict
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.applied import CALIBRATED, is_calibrated
from magyc_gtsam.recording.expected import expect_recording
from magyc_gtsam.recording.fingerprint import fingerprint, first_shared

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class _State:
    """The state of a search: the logs, the candidates, the added effects, the logs left out, and the last look."""

    logs: tuple[OneLog, ...]
    names: tuple[str, ...]
    added: tuple[AddedEffect, ...] = ()
    own: tuple[LogLeftOut, ...] = ()
    weighed: tuple[WeighedOverLogs, ...] = ()
    unknown: str = ""


def find_gap_of_many(
    recordings: Sequence[Recording], candidates: Sequence[str], report: Progress = lambda _: None
) -> GapOfMany:
    """Compare all logs of one instrument.

    Args:
        recordings: of one instrument, each with magnetometer and gyroscope.
        candidates: names to choose from.
        report: called with the share done.

    Raises:
        MagycError: no recordings, or an object that is not a recording.
    """
    fitted = _fitted_logs(recordings, candidates, lambda share: report(0.4 * share))
    while True:
        state = _searched(fitted, lambda share: report(0.4 + 0.6 * share))
        calibrations = {log.name: _calibration(log, not state.unknown) for log in state.logs}
        groups = instruments_of(calibrations)
        others = strangers(groups)
        if not others:
            break
        own = (*fitted.own, *(LogLeftOut(name, ANOTHER) for name in others))
        fitted = replace(fitted, logs=tuple(log for log in fitted.logs if log.name not in others), own=own)
    report(1.0)
    apart = not_of_one(groups)
    if apart:  # no value is one of all logs then
        return GapOfMany("not enough information", apart, (), state.own, (), {})
    # Beside an unknown effect, autocorrelation and outliers are part of its misfit, not noise.
    looked = len(state.logs) >= MODEL.least and not state.unknown
    return _result(state, calibrations, noise_effects(state.logs, candidates) if looked else ())


def _searched(state: _State, report: Progress) -> _State:
    """Add effects to the model of the logs until nothing is missing, or nothing that has a name."""
    for step in range(MODEL.most + 1 if len(state.logs) >= MODEL.least else 0):
        state, going = _step(state, step < MODEL.most)
        report((step + 1) / (MODEL.most + 1))
        if not going:
            break
    return state


def _fitted_logs(recordings: Sequence[Recording], names: Sequence[str], report: Progress) -> _State:
    """Fit the base model to each log; leave out logs that cannot be read or calibrated, with the reason."""
    if not len(recordings):
        raise MagycError("mg.find_gap: no recordings; give those of one instrument")
    logs: list[OneLog] = []
    own: list[LogLeftOut] = []
    known: dict[str, str] = {}  # fingerprint → name
    instead: dict[str, bool] = {}
    for k in range(len(recordings)):
        called = f"log {k + 1}"
        try:
            recording = recordings[k]  # a lazy sequence reads it here
        except MagycError as problem:
            own.append(LogLeftOut(called, str(problem)))
            continue
        expect_recording("mg.find_gap", recording)
        called = recording.name or called
        if called in (log.name for log in logs):
            called = f"{called} ({k + 1})"
        samples = fingerprint(recording)
        first = first_shared(samples, known)
        if first is not None:
            own.append(LogLeftOut(called, f"the same samples as {known[first]}, which count once"))
            continue
        if is_calibrated(recording):
            own.append(LogLeftOut(called, CALIBRATED))
            continue
        recording = replace(recording, channels=of_one_quantity(recording.channels, instead))
        try:
            logs.append(OneLog.of(recording, names, called))
            known[samples] = called  # only now: a log that is left out hides none with the same samples
        except MagycError as problem:
            own.append(LogLeftOut(called, str(problem)))
        report((k + 1) / len(recordings))
    return _State(tuple(logs), tuple(names), own=tuple(own))


def _step(state: _State, more: bool) -> tuple[_State, bool]:
    """Test all effects, and add the strongest or leave out logs with an unknown effect; return whether to continue."""
    had = [each.name for each in state.added]
    free = [name for name in state.names if name in TERMS and name not in had]
    asked = [name for name in free if not any(nested(name, other) for other in had)]
    weighed = look_over(state.logs, asked)
    state = replace(state, weighed=weighed)
    strongest = weighed[0]
    explained, limit = sum(each.evidence for each in state.added), MODEL.sure
    for each in state.added:  # what it leaves looks like its rivals, or like no name
        like = strongest.name not in TERMS or (each.name in TERMS and related(strongest.name, each.name))
        limit += (MODEL.remain if like else MODEL.remain_apart) * each.evidence
    if strongest.nats < limit:
        return state, False
    if strongest.named and more:
        varies = strongest.name == FIELD_VARIATION
        instead = _instead(state, strongest, weighed) if varies else None
        if instead is not None:
            return instead, True
        ahead = (_with_variation if varies else _with_effect)(state, strongest, _alternatives(weighed))
        # Of what the field explained without the effect, a part may be due to it.
        own = sum(log.power_of(strongest.name) for log in ahead.logs)
        going = varies or own > MODEL.remain * sum(log.of_field for log in ahead.logs)
        return (ahead if going else state), going
    if strongest.nats < MODEL.sure + MODEL.remain * (explained + sum(log.of_field for log in state.logs)):
        return state, False
    few = strongest.present > MODEL.plain
    alone = strongest.apart > strongest.shared and 0 < few.sum() <= max(1, MODEL.few * len(few))
    if not strongest.named and alone and len(few) - few.sum() >= MODEL.least:
        return _without_logs(state, few, strongest), True
    return replace(state, unknown=strongest.name), False


def _instead(state: _State, varying: WeighedOverLogs, weighed: Sequence[WeighedOverLogs]) -> _State | None:
    """Return the state with the sudden effect beside which, once it is fitted, least of a varying field is left; None
    if none explains as much as that field.

    A large jump explains little in the linear model in which it is looked for, at a time that is only nearly right, and
    a field that varies follows it.
    """
    best, least = None, MODEL.remain * varying.nats
    for rival in [each for each in weighed if _sudden(each) and each.nats > MODEL.sure][: MODEL.rivals]:
        ahead = _with_effect(state, rival, _alternatives(weighed))
        left = sum(log.varying[0] for log in ahead.logs)
        if left < least:
            best, least = ahead, left
    return best


def _sudden(weighed: WeighedOverLogs) -> bool:
    """Return whether a hypothesis is a sudden effect in one of the logs."""
    tests = [test for test in weighed.best if test is not None]
    return weighed.name in TERMS and any(sudden(weighed.name, test.setting) for test in tests)


def _alternatives(weighed: Sequence[WeighedOverLogs]) -> tuple[str, ...]:
    """Return the names that are not clearly behind the strongest one."""
    first = weighed[0]

    def lead(other: WeighedOverLogs) -> float:
        return MODEL.moments if first.name in MOMENTS and other.name in MOMENTS else MODEL.sure

    return tuple(
        other.name for other in weighed[1:] if other.named and other.nats > max(first.nats - lead(other), 0.0)
    )


def _without_logs(state: _State, few: np.ndarray, strongest: WeighedOverLogs) -> _State:
    own = tuple(
        LogLeftOut(log.name, f"{_missing(strongest.name, [log], state.names)}; the log was left out")
        for log, out in zip(state.logs, few, strict=True)
        if out
    )
    kept = tuple(log for log, out in zip(state.logs, few, strict=True) if not out)
    added = tuple(each.in_logs(~few) for each in state.added)
    return replace(state, logs=kept, own=(*state.own, *own), added=added)


def _missing(name: str, logs: Sequence[OneLog], names: Sequence[str]) -> str:
    """Return in words that an effect or a generic family is missing."""
    every = (family for log in logs for family in families(log.refitted.twin))
    place = next((family.place for family in every if family.name == name), "")
    return missing(name, place) + (f", and it is not {among(names)}" if place else "")


def _with_effect(state: _State, chosen: WeighedOverLogs, rivals: tuple[str, ...]) -> _State:
    """Add the effect to all logs, or to those that have it; leave out logs whose model does not converge with it."""
    instrument = chosen.instrument >= 0.5
    logs: list[OneLog] = []
    own: list[LogLeftOut] = []
    settings: list[dict[str, float] | None] = []
    present: list[float] = []
    kept = np.ones(len(state.logs), dtype=bool)
    for k, (log, best, probability) in enumerate(zip(state.logs, chosen.best, chosen.present, strict=True)):
        ahead, setting = log, None
        if best is not None and (instrument or probability > 0.5):
            shown = chosen if chosen.one_value else best
            references = {k: v for k, v in best.setting.items() if k.startswith("reference")}
            setting = references | {k: v for k, v in shown.setting.items() if not k.startswith("reference")}
            try:
                ahead = log.with_effect(chosen.name, setting, shown.value)
            except MagycError as problem:
                own.append(LogLeftOut(log.name, str(problem)))
                kept[k] = False
                continue
        logs.append(ahead)
        settings.append(setting)
        present.append(float(probability) if setting is None or not instrument else 1.0)
    one = AddedEffect(chosen.name, chosen.nats, chosen.instrument, np.array(present), tuple(settings), rivals)
    before = (each.in_logs(kept) for each in state.added)
    return replace(state, logs=tuple(logs), own=(*state.own, *own), added=(*before, one))


def _with_variation(state: _State, chosen: WeighedOverLogs, rivals: tuple[str, ...]) -> _State:
    """Add a varying field to the logs that have it."""
    here = [log.varying[1] is not None and p > 0.5 for log, p in zip(state.logs, chosen.present, strict=True)]
    logs = tuple(
        replace(log, variation=log.varying[1]) if own else log for log, own in zip(state.logs, here, strict=True)
    )
    settings: tuple[dict[str, float] | None, ...] = tuple({} if own else None for own in here)
    one = AddedEffect(chosen.name, 0.0, 0.0, chosen.present, settings, rivals)
    return replace(state, logs=logs, added=(*state.added, one))


def _result(state: _State, calibrations: dict[str, Calibration], noise: Sequence[SharedEffect]) -> GapOfMany:
    effects = (*told(state.added, state.logs, calibrations), *noise)
    where = _missing(state.unknown, state.logs, state.names) if state.unknown else ""
    if where:
        doubt = Doubt(where, "compare the logs singly (`mg.find_gap`)")
        calibrations = {name: doubted(calibration, doubt) for name, calibration in calibrations.items()}
    weights = tuple(Weight(each.name, each.shared, each.apart) for each in state.weighed)
    named = "; ".join(effect.sentence for effect in effects)
    verdict: Verdict
    if len(state.logs) < MODEL.least:
        verdict, said = "not enough information", f"{len(state.logs)} of the logs can be used, and two are needed"
    elif where:
        verdict, said = "unknown", f"{named}; beside that, {where}" if named else where
    elif effects:
        verdict, said = "closed", named
    else:
        verdict, said = "none", f"nothing is missing in {len(state.logs)} logs"
    return GapOfMany(verdict, said, effects, state.own, weights, calibrations)


def _calibration(log: OneLog, complete: bool) -> Calibration:
    """Return the calibration with the effects as terms; covariance and verdict include the remaining misfit.

    Args:
        log: with the effects in its model.
        complete: whether no effect outside the catalogue is missing.
    """
    model = with_free_delay(log.refitted.model)
    fitted = widened(refit(log.refitted.twin.problem, model, log.short_term))
    found = judged(as_calibration(fitted, None), fitted, log.recording, None)[0]
    why = "" if log.clipped is None else why_clipped(log.clipped, found, complete)
    if log.clipped is not None and why:
        found = doubted(found, doubt_of_clipped(log.clipped, why))
    found = noted(found, recordings=[fingerprint(log.recording)], left_out=list(log.left_out))
    return as_mounted(found, log.recording)
