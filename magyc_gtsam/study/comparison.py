"""Every method on one recording: what each makes of it, at what cost, and why some cannot."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import Method, calibrate, methods
from magyc_gtsam.estimators.autocal.autocal import inliers
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.given_data import expect_recording
from magyc_gtsam.observability import HARD_IRON_LIMIT
from magyc_gtsam.recording import Mask, Recording
from magyc_gtsam.runners.status import Status as Ended
from magyc_gtsam.study.heading import HeadingError, heading_error

Progress = Callable[[str, float], None]

MOST_SAMPLES = 50_000  # of the methods that take samples in any order; more cost time and win next to nothing
ROBUST = ("autocal", "smoother")  # which tell disturbed samples from others
REFERENCES = ("smoother", "autocal")  # the most accurate with and without a gyroscope
_MANY = 6.0  # sigmas of both together, from which two methods contradict each other
_MATTERS = {"hard_iron": 0.01, "gyro_bias": 1e-3}  # of the field, and rad/s: below, a contradiction does no harm
_WORSE = 1.05  # spread after over spread before, from which a calibration made it worse
UNCALIBRATED = Calibration(np.eye(3), np.zeros(3), method="raw")
_NEEDS = {  # what a method may need, whether a recording has it, and how to say that it has not
    "angular_rate": (lambda r: r.angular_rate is not None, "a gyroscope"),
    "attitude": (lambda r: r.attitude is not None and bool(np.isfinite(r.attitude).any()), "a reference attitude"),
    "acceleration": (lambda r: r.acceleration is not None, "an accelerometer"),
}


class Status(str, Enum):
    """What became of a method."""

    TRUSTED = "trusted"
    DOUBTFUL = "doubtful"
    UNTRUSTED = "not trusted"
    FAILED = "failed"
    IMPOSSIBLE = "not possible"

    __str__ = str.__str__


@dataclass(frozen=True, eq=False)
class Outcome:
    """One method on the recording.

    Attributes:
        method: its name in `methods()`; "raw" for the recording as it is.
        status: what became of it.
        reason: why it is doubtful, not trusted, failed or is not possible; else what the method says of its end.
        note: what was done to the data for this method only, "" for nothing.
        calibration: None where there is none.
        seconds: run time, wall clock; None where it did not run.
        spread: T (or counts), standard deviation of the strength of the samples calibrated, all of them.
        inlier_spread: likewise, of those in `Comparison.inlier`.
        strength: T (or counts), its mean.
        heading: against the reference attitude; None without one.
    """

    method: str
    status: Status
    reason: str
    note: str = ""
    calibration: Calibration | None = None
    seconds: float | None = None
    spread: float | None = None
    inlier_spread: float | None = None
    strength: float | None = None
    heading: HeadingError | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """What `compare` returns.

    Attributes:
        recording: the data.
        raw: the recording as it is, judged like the methods.
        outcomes: one for each method, in the order of `methods()` or as asked for.
        delay: s by which the field was taken later wherever it is held against the reference attitude, one for
            all methods: most do not estimate it, and it would count as their heading error.
        delay_from: the method that estimated it; "" for none.
        inlier: (n,) of the magnetometer's own samples, whether they lie on the ellipsoid of one robust method.
        inlier_from: that method; "" where none can be trusted, and all count as inliers.
        not_run: methods that an interrupt (Ctrl-C) came before.
    """

    recording: Recording
    raw: Outcome
    outcomes: tuple[Outcome, ...]
    delay: float
    delay_from: str
    inlier: Mask
    inlier_from: str
    not_run: tuple[str, ...] = ()

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended it before all methods were done."""
        return bool(self.not_run) or any(_interrupted(o) for o in self.outcomes)

    @property
    def calibrated(self) -> tuple[Outcome, ...]:
        """The methods that gave parameters, trusted or not."""
        return tuple(o for o in self.outcomes if o.calibration is not None)

    @property
    def reference(self) -> Outcome | None:
        """The result to hold the others against: the first of REFERENCES that can be trusted."""
        by_name = {o.method: o for o in self.trusted}
        return next((by_name[name] for name in REFERENCES if name in by_name), None)

    @property
    def recommended(self) -> Outcome | None:
        """The result to use: `reference`, else the trusted one whose calibrated field varies least."""
        if self.reference is not None:
            return self.reference
        return min(self.trusted, key=lambda o: o.inlier_spread or 0.0, default=None)

    def __repr__(self) -> str:
        use = None if self.recommended is None else self.recommended.method
        return f"Comparison(use={use!r}, {len(self.trusted)} of {len(self.outcomes)} methods trusted)"

    def _repr_html_(self) -> str:
        text: str = importlib.import_module("magyc_gtsam.report.notebook").html_of(
            self
        )  # it lies above this module
        return text

    @property
    def by_trust(self) -> tuple[Outcome, ...]:
        """All outcomes, the one to use first, then by status and by how much the calibrated field varies."""
        order = list(Status)
        return tuple(
            sorted(
                self.outcomes,
                key=lambda o: (o is not self.recommended, order.index(o.status), o.inlier_spread or 0.0),
            )
        )

    @property
    def trusted(self) -> tuple[Outcome, ...]:
        """The methods whose result can be trusted."""
        return tuple(o for o in self.outcomes if o.status is Status.TRUSTED)


def compare(
    recording: Recording,
    names: Sequence[str] | None = None,
    *,
    field_strength: float | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Calibrate a recording with every method that it allows: `run_methods`, then `judge`.

    Args:
        recording: the data.
        names: of `methods()`; None for all.
        field_strength: T, sets the scale of every soft iron. None: det 1.
        progress: called with the method's name and the share that it has done.

    Raises:
        MagycError: a name that is no method, or is given twice.
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
) -> list[Outcome]:
    """What each method makes of a recording, as in `compare`.

    A method that fails, in whatever way, says so in its outcome and never stops the others. An interrupt does: what
    has been done by then is kept, with the values so far of a method that has some.

    Raises:
        KeyboardInterrupt: interrupted before the first method was done.
    """
    known = methods()
    ran: list[Outcome] = []
    try:
        for name in asked:
            ran.append(_run(recording, name, known[name], field_strength, progress))
            if _interrupted(ran[-1]):
                break
    except KeyboardInterrupt:
        if not ran:
            raise
    return ran


def judge(recording: Recording, asked: Sequence[str], ran: Sequence[Outcome]) -> Comparison:
    """The outcomes of `run_methods` side by side: the spread of the field and the heading's error of each."""
    delay, delay_from = _delay(ran)
    inlier, inlier_from = _inliers(recording, ran)
    raw = Outcome("raw", Status.UNTRUSTED, "", calibration=UNCALIBRATED)
    judged = [_judged(recording, outcome, delay, inlier) for outcome in (raw, *ran)]
    not_run = tuple(asked[len(ran) :])
    comparison = Comparison(
        recording, judged[0], tuple(judged[1:]), delay, delay_from, inlier, inlier_from, not_run
    )
    return replace(comparison, outcomes=tuple(_doubted(comparison, outcome) for outcome in comparison.outcomes))


def checked_methods(names: Sequence[str] | None) -> tuple[str, ...]:
    """The names, each of one of `methods()` and given once; None gives them all.

    Raises:
        MagycError: a name that is no method, or is given twice.
    """
    known = methods()
    if names is None:
        return tuple(known)
    for place, name in enumerate(names):
        if name not in known:
            raise MagycError(f"methods: {name!r} is none of {', '.join(known)}")
        if name in names[:place]:
            raise MagycError(f"methods: {name!r} is given twice")
    return tuple(names)


def _run(
    recording: Recording, name: str, method: Method, field_strength: float | None, progress: Progress | None
) -> Outcome:
    missing = [lacking for need in method.needs if (lacking := _lacking(recording, need))]
    if missing:
        return Outcome(name, Status.IMPOSSIBLE, f"needs {' and '.join(missing)}")
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
        return Outcome(name, Status.FAILED, reason, note, seconds=time.perf_counter() - start)
    except Exception as error:  # noqa: BLE001 - a method's own defect is its outcome, not the end of the others
        if isinstance(error.__cause__, KeyboardInterrupt):  # met while an extension module was being loaded
            raise error.__cause__ from None
        reason = f"{type(error).__name__}: {error}"
        return Outcome(name, Status.FAILED, reason, note, seconds=time.perf_counter() - start)
    seconds = time.perf_counter() - start
    status = Status.TRUSTED if result.trusted else Status.UNTRUSTED
    return Outcome(name, status, result.message, note, result, seconds)


def _interrupted(outcome: Outcome) -> bool:
    """Whether the method ended at an interrupt, with the values that it had, as the graphs' runners do."""
    calibration = outcome.calibration
    return calibration is not None and calibration.diagnostics.get("status") == str(Ended.INTERRUPTED)


def _lacking(recording: Recording, need: str) -> str | None:
    has, words = _NEEDS.get(need, (None, need))
    if has is not None and not has(recording):
        return words
    return "the field in tesla" if recording.magnetic_field_unit == "counts" else None


def _thinned(recording: Recording) -> tuple[Recording, str]:
    """The magnetometer's own samples, every k-th where there are too many."""
    count = int(recording.magnetic_field_fresh.sum())
    every = -(-count // MOST_SAMPLES)
    if every == 1:
        return recording, ""
    rows = np.flatnonzero(recording.magnetic_field_fresh)[::every]
    return recording.rows(rows), f"{len(rows):,} of {count:,} samples, evenly spaced"


def _delay(ran: Sequence[Outcome]) -> tuple[float, str]:
    """Of the first method that estimated it and can be trusted."""
    for outcome in ran:
        calibration = outcome.calibration
        if outcome.status is Status.TRUSTED and calibration is not None and calibration.delay_sigma is not None:
            return calibration.delay, outcome.method
    return 0.0, ""


def _inliers(recording: Recording, ran: Sequence[Outcome]) -> tuple[Mask, str]:
    """By the ellipsoid of the first method of ROBUST that can be trusted."""
    trusted = {o.method: o.calibration for o in ran if o.status is Status.TRUSTED}
    for name in ROBUST:
        calibration = trusted.get(name)
        if calibration is not None:
            return inliers(recording, calibration), name
    return np.ones(len(recording.magnetometer.time), dtype=bool), ""


def _judged(recording: Recording, outcome: Outcome, delay: float, inlier: Mask) -> Outcome:
    """With the spread of the field and the heading's error."""
    if outcome.calibration is None:
        return outcome
    norm = np.linalg.norm(outcome.calibration.apply(recording.magnetometer.value), axis=1)
    reference = _lacking(recording, "attitude") is None
    return replace(
        outcome,
        spread=float(norm.std()),
        inlier_spread=float(norm[inlier].std()) if inlier.any() else None,
        strength=float(norm.mean()),
        heading=heading_error(recording, outcome.calibration, delay) if reference else None,
    )


def _doubted(comparison: Comparison, outcome: Outcome) -> Outcome:
    """With what the others show and the method itself has not noticed."""
    doubts = [] if outcome.status is Status.TRUSTED else [outcome.reason]
    before, after = comparison.raw.inlier_spread, outcome.inlier_spread
    if before is not None and after is not None and after > _WORSE * before:
        doubts.append("the strength of the calibrated field varies more than that of the raw field")
    if outcome.status is Status.TRUSTED:
        doubts += _apart(comparison, outcome)
    if not doubts:
        return outcome
    status = Status.DOUBTFUL if outcome.status is Status.TRUSTED else outcome.status
    return replace(outcome, status=status, reason="; ".join(doubts))


def _contradictions(reference: Outcome, calibration: Calibration) -> list[str]:
    """Hard iron and gyroscope bias that are off those of the reference by many sigmas of both, and matter."""
    assert reference.calibration is not None
    assert reference.strength is not None
    doubts = []
    for name, words in (("hard_iron", "hard iron"), ("gyro_bias", "gyroscope bias")):
        here, there = getattr(calibration, name), getattr(reference.calibration, name)
        if calibration is reference.calibration or here is None or there is None:
            continue
        known = (
            np.full(3, np.inf) if name not in reference.calibration.sigma else reference.calibration.sigma[name]
        )
        sigma = np.hypot(known, calibration.sigma.get(name, np.zeros(3)))
        off = float(np.abs((here - there) / sigma).max())
        least = _MATTERS[name] * (reference.strength if name == "hard_iron" else 1.0)
        if off > _MANY and float(np.linalg.norm(here - there)) > least:
            doubts.append(f"its {words} contradicts that of {reference.method} by {off:.0f} sigmas")
    return doubts


def _apart(comparison: Comparison, outcome: Outcome) -> list[str]:
    """Whether its hard iron is far from that of the most accurate method."""
    reference = comparison.reference
    if reference is None or reference.calibration is None or outcome.calibration is None:
        return []
    assert reference.strength is not None
    scale, unit = comparison.recording.field_shown
    apart = float(np.linalg.norm(outcome.calibration.hard_iron - reference.calibration.hard_iron))
    limit = HARD_IRON_LIMIT * reference.strength
    if apart <= limit:
        return _contradictions(reference, outcome.calibration)
    return [
        f"its hard iron is {apart * scale:.1f} {unit} from that of {reference.method} (more than the "
        f"{limit * scale:.1f} that make three degrees of heading)"
    ]
