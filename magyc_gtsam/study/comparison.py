"""Run of every method on one recording, with its result, its run time or the reason why it cannot run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from magyc_gtsam.estimators import calibrate, methods
from magyc_gtsam.estimators.method import Method
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.expected import expect_recording
from magyc_gtsam.study.judging import judge
from magyc_gtsam.study.outcome import Comparison, MethodOutcome, OutcomeStatus

Progress = Callable[[str, float], None]

MOST_SAMPLES = 50_000  # limit for methods that ignore the order of samples; more cost time and gain little
_NEEDS = {  # a requirement of methods: the test whether a recording meets it, and its name in messages
    "angular_rate": (lambda r: r.angular_rate is not None, "a gyroscope"),
    "attitude": (lambda r: r.attitude is not None and bool(np.isfinite(r.attitude).any()), "a reference attitude"),
    "acceleration": (lambda r: r.acceleration is not None, "an accelerometer"),
}


def compare(
    recording: Recording,
    names: Sequence[str] | None = None,
    *,
    field_strength: float | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Calibrate a recording with every method that it allows, and judge the results.

    Args:
        recording: the recording.
        names: names from `methods()`; None for all.
        field_strength: T, sets the scale of every soft iron; None for det 1.
        progress: called with the method's name and the share of it that is done.

    Raises:
        MagycError: a method is unknown or given twice.
        KeyboardInterrupt: interrupted before the first method was done.
    """
    expect_recording("mg.compare", recording)
    asked = checked_methods(names)
    return judge(recording, asked, run_methods(recording, asked, field_strength, progress))


def run_methods(
    recording: Recording,
    asked: Sequence[str],
    field_strength: float | None = None,
    progress: Progress | None = None,
) -> list[MethodOutcome]:
    """Run each method on a recording; for the arguments see `compare`.

    A method that fails in any way reports it in its outcome and does not stop the others. An interrupt stops them; the
    outcomes so far are kept, including the last values of a method that has some.

    Raises:
        KeyboardInterrupt: interrupted before the first method was done.
    """
    known = methods()
    ran: list[MethodOutcome] = []
    try:
        for name in asked:
            ran.append(_run(recording, name, known[name], field_strength, progress))
            if ran[-1].interrupted:
                break
    except KeyboardInterrupt:
        if not ran:
            raise
    return ran


def checked_methods(names: Sequence[str] | None) -> tuple[str, ...]:
    """Check that the names are unique names of methods, and return them; None gives all methods.

    Raises:
        MagycError: a method is unknown or given twice.
    """
    known = methods()
    if names is None:
        return tuple(known)
    for place, name in enumerate(names):
        if name not in known:
            raise MagycError(f"methods: {name!r} is not one of {', '.join(known)}")
        if name in names[:place]:
            raise MagycError(f"methods: {name!r} is given twice")
    return tuple(names)


def _run(
    recording: Recording, name: str, method: Method, field_strength: float | None, progress: Progress | None
) -> MethodOutcome:
    missing = [lacking for need in method.needs if (lacking := _lacking(recording, need))]
    if missing:
        return MethodOutcome(name, OutcomeStatus.IMPOSSIBLE, f"needs {' and '.join(missing)}")
    used, note = (recording, "") if method.needs else _thinned(recording)

    def report(share: float) -> None:
        if progress is not None:
            progress(name, share)

    report(0.0)
    start = time.perf_counter()
    try:
        result = calibrate(used, name, field_strength=field_strength, progress=report)
    except MagycError as error:
        reason = str(error).removeprefix(f"method {name!r} failed: ")
        return MethodOutcome(name, OutcomeStatus.FAILED, reason, note, seconds=time.perf_counter() - start)
    except Exception as error:  # noqa: BLE001 - a defect of one method must not stop the others
        if isinstance(error.__cause__, KeyboardInterrupt):  # raised while an extension module was being loaded
            raise error.__cause__ from None
        reason = f"{type(error).__name__}: {error}"
        return MethodOutcome(name, OutcomeStatus.FAILED, reason, note, seconds=time.perf_counter() - start)
    seconds = time.perf_counter() - start
    status = OutcomeStatus.TRUSTED if result.trusted else OutcomeStatus.UNTRUSTED
    return MethodOutcome(name, status, result.message, note, result, seconds)


def _lacking(recording: Recording, need: str) -> str | None:
    has, words = _NEEDS.get(need, (None, need))
    if has is not None and not has(recording):
        return words
    return "the field in tesla" if recording.magnetic_field_unit == "counts" else None


def _thinned(recording: Recording) -> tuple[Recording, str]:
    """Return the magnetometer's samples, every k-th if there are too many, and a note about it."""
    count = int(recording.magnetic_field_fresh.sum())
    every = -(-count // MOST_SAMPLES)
    if every == 1:
        return recording, ""
    rows = np.flatnonzero(recording.magnetic_field_fresh)[::every]
    return recording.rows(rows), f"{len(rows):,} of {count:,} samples, evenly spaced"
