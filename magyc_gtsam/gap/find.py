"""`find_gap`: where a recording and the model disagree, the effect that causes it, and the remaining misfit."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import overload

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.elsewhere import on_recording
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.one_thread import one_thread
from magyc_gtsam.gap.effects import NAMES
from magyc_gtsam.gap.evidence.answer import answer
from magyc_gtsam.gap.many.find import find_gap_of_many
from magyc_gtsam.gap.many.result import GapOfMany
from magyc_gtsam.gap.model.base import base_model, needs_gyroscope
from magyc_gtsam.gap.model.refit import Refit, widened
from magyc_gtsam.gap.naming.named import Named, named
from magyc_gtsam.gap.naming.steps import with_one_jump, without_samples_of_steps
from magyc_gtsam.gap.outcome.corrected import as_calibration
from magyc_gtsam.gap.outcome.doubt import with_clipped, with_stuck_bit
from magyc_gtsam.gap.outcome.outcome import gap_of, nothing_tested
from magyc_gtsam.gap.preparation.channel_holes import without_channel_holes
from magyc_gtsam.gap.preparation.discrete import noiseless, settled
from magyc_gtsam.gap.result import Doubt, Gap
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import First
from magyc_gtsam.gap.samples.tones import silenced
from magyc_gtsam.gap.simulated import SimulatedGap, compare
from magyc_gtsam.observability import Observability, assess
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.expected import expect_progress, expect_recording
from magyc_gtsam.recording.fingerprint import fingerprint, first_shared
from magyc_gtsam.sensor_faults.usable import without_faults

_ADD_NOISE = "give the simulated sensors the noise of the real ones, or record a log"
_SILENT = f"a misfit has nothing to be measured against; {_ADD_NOISE}"


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
            in, and other terms that are dated there are left out. None: the twelve parameters without delay.
        simulated: a recording of the user's own simulator on the same or a similar motion, compared directly.
        candidates: names to choose from; None for the whole catalogue.
        progress: called with the share done, 0 to 1.

    Raises:
        MagycError: unknown candidate, no gyroscope, or data that cannot be calibrated at all. Too little motion or
            noise-free data are not an error but give the verdict "not enough information".
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
    theirs, before = None, 0.0
    if simulated is not None:  # first, since an error in it would cost the result of the recording
        theirs, before = _side(simulated, names, "simulated: ", lambda done: report(0.5 * done)), 0.5
    gap, result = _gap_and_named(recording, calibration, names, lambda done: report(before + (1 - before) * done))
    if theirs is not None and result is not None:
        ours = _side(recording, names, "", lambda done: None) if calibration is not None else _side_of(gap, result)
        gap = replace(gap, assumptions=compare(ours, theirs))
    report(1.0)
    of_these = {"recordings": [fingerprint(recording)]}
    fitted = replace(gap.calibration, diagnostics={**gap.calibration.diagnostics, **of_these})
    return replace(gap, calibration=fitted)


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
    needs_gyroscope(recording)
    usable = without_faults(recording)
    recording, unlogged = without_channel_holes(usable.recording)
    recording, discrete = settled(recording, names)
    tones = () if calibration is None else tuple(t for t in calibration.terms if t.name == "tone")
    recording = silenced(recording, tones)
    short_term = short_term_noise(recording)
    base = base_model(recording, calibration, short_term)
    report(0.2)
    reasons = _untestable(recording, base, short_term)
    result: Named | None = None
    if reasons is not None:
        gap = nothing_tested(base, *reasons, calibration)
    else:
        first = First(recording, base)
        said = answer(recording, base, short_term, names, discrete, first.fine)
        report(0.8)
        result = with_one_jump(named(said, first, short_term), short_term)
        result = without_samples_of_steps(recording, result)
        gap = gap_of(result, short_term, calibration, names, discrete)
    gap = with_stuck_bit(with_clipped(gap, usable.clipped), usable.bit)
    run = {"seconds": clock.perf_counter() - started, "left_out": [*usable.left_out, *unlogged]}
    return replace(gap, diagnostics={**gap.diagnostics, **run}), result


def _untestable(recording: Recording, base: Refit, short_term: SensorNoise) -> tuple[str, Doubt] | None:
    """Return why nothing can be tested, in full and in few words with a remedy; None if there is enough information."""
    motion = _determined(recording, base, short_term)
    if not motion.observable:
        weakest = motion.weak[0]
        doubt = Doubt(f"too little motion to determine the {weakest.what}", weakest.remedy)
        return f"too little motion: {weakest.sentence}", doubt
    if noiseless(recording):
        silence = f"the magnetometer has no measurable noise (under {RULES.noiseless * 1e9:.2g} nT)"
        return f"{silence}: {_SILENT}", Doubt(silence, _ADD_NOISE)
    return None


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


def _determined(recording: Recording, base: Refit, short_term: SensorNoise) -> Observability:
    """Return what the motion determines at the sensors' own noise, to which the misfit of an effect does not add."""
    fitted = as_calibration(replace(base, converged=False), None)  # not yet to be trusted, whatever its values
    assert fitted.covariance is not None
    assert fitted.field_strength is not None
    share = min(1.0, (short_term.magnetometer / base.model.noise.magnetometer) ** 2)
    covariance = share * fitted.covariance
    return assess(covariance, fitted.soft_iron, fitted.field_strength, recording, fitted.hard_iron)
