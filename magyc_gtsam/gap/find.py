"""`find_gap`: where a recording and the model disagree, the effect that causes it, and the remaining misfit."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import overload

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.elsewhere import on_recording
from magyc_gtsam.calibration.followed import followed
from magyc_gtsam.calibration.noted import as_mounted, noted, with_clock_drift
from magyc_gtsam.estimators.smoother.clock_drift import restamped
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.one_thread import one_thread
from magyc_gtsam.gap.effects import NAMES
from magyc_gtsam.gap.evidence.answer import answer
from magyc_gtsam.gap.many.find import find_gap_of_many
from magyc_gtsam.gap.many.result import GapOfMany
from magyc_gtsam.gap.model.base import TooSmoothError
from magyc_gtsam.gap.model.refit import refit, widened, with_free_delay
from magyc_gtsam.gap.naming.named import Named, named
from magyc_gtsam.gap.naming.steps import without_samples_of_steps
from magyc_gtsam.gap.outcome.doubt import with_clipped, with_stuck_bit
from magyc_gtsam.gap.outcome.outcome import gap_of, nothing_tested
from magyc_gtsam.gap.prepared import Prepared
from magyc_gtsam.gap.result import Doubt, Gap
from magyc_gtsam.gap.samples.first import First
from magyc_gtsam.gap.simulated import SimulatedGap, compare
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.expected import expect_progress, expect_recording
from magyc_gtsam.recording.fingerprint import fingerprint, first_shared


@overload
def find_gap(
    recording: Recording,
    calibration: Calibration | None = None,
    simulated: Recording | None = None,
    candidates: Sequence[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Gap: ...


@overload
def find_gap(
    recording: Sequence[Recording],
    calibration: None = None,
    simulated: None = None,
    candidates: Sequence[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> GapOfMany: ...


@one_thread
def find_gap(
    recording: Recording | Sequence[Recording],
    calibration: Calibration | None = None,
    simulated: Recording | None = None,
    candidates: Sequence[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Gap | GapOfMany:
    """Find where model and measurement disagree, name the effect, add it, and show the remaining misfit.

    Args:
        recording: with magnetometer and gyroscope. Other channels (current, temperature, depth, position) and the
            acceleration allow more effects to be tested. Several recordings of one instrument are compared: an effect
            of the instrument has one value in all, an effect of the place or the day a separate value in each.
        calibration: the initial model with its delay and terms. All of it is estimated again; parameters that the data
            contradict are in the sentence and in `Gap.moved`. A jump that it found in another recording counts as set
            in, and other terms that are dated there are left out. A `clock_drift` of its configuration is taken out of
            the stamps. None: the twelve parameters without delay.
        simulated: a recording of the user's own simulator on the same or a similar motion, compared directly.
        candidates: names to choose from; None for the whole catalogue.
        progress: called with the share done, 0 to 1.

    Raises:
        MagycError: unknown candidate, no gyroscope, or data that cannot be calibrated at all. Too little motion,
            noise-free data or an axis that is stuck but for its last bit are not an error but give the verdict "not
            enough information".
    """
    expect_progress(progress)
    names, report = _names(candidates), progress or (lambda _: None)
    if isinstance(recording, Sequence) and not isinstance(recording, str):
        if calibration is not None or simulated is not None:
            raise MagycError("mg.find_gap: of several recordings takes no calibration= and no simulated=")
        return find_gap_of_many(recording, names, report)
    _check_types(recording, calibration, simulated)
    report(0.0)
    calibration, _ = on_recording(calibration, recording)
    if calibration is not None:
        recording = replace(recording, channels=followed(recording.channels, calibration.terms))
    drift = 0.0 if calibration is None else calibration.configuration.get("clock_drift", 0.0)
    theirs, before = None, 0.0
    if simulated is not None:  # first, since an error in it would cost the result of the recording
        theirs, before = _side(simulated, names, "simulated: ", lambda done: report(0.5 * done)), 0.5
    gap, result = _gap_and_named(
        restamped(recording, drift), calibration, names, lambda done: report(before + (1 - before) * done)
    )
    if theirs is not None and result is not None:
        ours = _side(recording, names, "", lambda done: None) if calibration is not None else _side_of(gap, result)
        gap = replace(gap, assumptions=compare(ours, theirs))
    report(1.0)
    fitted = noted(gap.calibration, recordings=[fingerprint(recording)])
    fitted, base = (with_clock_drift(as_mounted(each, recording), drift) for each in (fitted, gap.base))
    return replace(gap, calibration=fitted, base=base)


def _side(
    recording: Recording, names: tuple[str, ...], what: str, report: Callable[[float], None]
) -> SimulatedGap:
    """Return the gap of the base model on one of the two recordings.

    Raises:
        MagycError: an error of the recording; its message begins with `what`.
    """
    try:
        gap, result = _gap_and_named(recording, None, names, report)
    except MagycError as problem:
        raise MagycError(f"{what}{problem}") from None
    if result is None:
        raise MagycError(f"{what}{gap.sentence}")
    return _side_of(gap, result)


def _side_of(gap: Gap, result: Named) -> SimulatedGap:
    return SimulatedGap(gap, widened(result.fitted))


def _gap_and_named(
    recording: Recording, calibration: Calibration | None, names: tuple[str, ...], report: Callable[[float], None]
) -> tuple[Gap, Named | None]:
    """Return the gap of one recording, and what is named; None if there is not enough information to name anything."""
    started = clock.perf_counter()
    ready = Prepared.of(recording, names, calibration)
    report(0.2)
    searched = _searched(ready, names)
    report(0.8)
    result: Named | None = None
    if isinstance(searched, Named):
        result, gap = searched, gap_of(searched, ready.short_term, calibration, names, ready.discrete)
    else:
        gap = nothing_tested(ready.base, *searched, calibration)
    gap = with_clipped(gap, ready.usable.clipped)
    for bit in ready.usable.bits:
        gap = with_stuck_bit(gap, bit)
    left_out = [*ready.usable.left_out, *ready.left_out]
    run = {"seconds": clock.perf_counter() - started, "left_out": left_out}
    return replace(gap, diagnostics={**gap.diagnostics, **run}), result


def _searched(ready: Prepared, names: tuple[str, ...]) -> Named | tuple[str, Doubt]:
    """Return what is named in a recording, or why nothing can be, in full and in few words with a remedy."""
    reasons = ready.untestable()
    if reasons is not None:
        return reasons
    first = First(ready.recording, ready.base)
    try:
        said = answer(first, ready.short_term, names, ready.discrete)
    except TooSmoothError:
        return ready.too_smooth()
    result = without_samples_of_steps(ready.recording, named(said, first, ready.short_term))
    model = with_free_delay(result.fitted.model)
    if model is result.fitted.model:
        return result
    return replace(result, fitted=refit(result.fitted.twin.problem, model, ready.short_term))


def _check_types(recording: Recording, calibration: object, simulated: Recording | None) -> None:
    expect_recording("mg.find_gap", recording)
    if simulated is not None:
        expect_recording("simulated", simulated)
        if first_shared(fingerprint(simulated), [fingerprint(recording)]) is not None:
            raise MagycError(
                "simulated: it holds samples of the recording, which prove nothing; give a simulation"
            )
    if calibration is not None and not isinstance(calibration, Calibration):
        raise MagycError(
            f"calibration: a Calibration is needed, got {type(calibration).__name__}; mg.Calibration.load gives one"
        )


def _names(candidates: Sequence[str] | None) -> tuple[str, ...]:
    if candidates is None:
        return NAMES
    if isinstance(candidates, str) or not isinstance(candidates, Sequence) or not candidates:
        raise MagycError(
            f"candidates: a list of names is needed, got {candidates!r}; None takes the whole catalogue"
        )
    unknown = [name for name in candidates if name not in NAMES]
    if unknown:
        raise MagycError(f"candidates: {', '.join(map(repr, unknown))} unknown; there are {', '.join(NAMES)}")
    return tuple(name for name in NAMES if name in candidates)
