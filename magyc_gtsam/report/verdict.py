"""The verdict on a calibration, shared by terminal, page, JSON, files and exit code."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.field_jumps import beyond_turning, field_jumps
from magyc_gtsam.estimators.smoother.known import ENOUGH
from magyc_gtsam.foreign_text import cause_and_action, clauses
from magyc_gtsam.heading_uncertainty import HeadingUncertainty
from magyc_gtsam.level_turn import TILT
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.time_base import CLOCKS_APART

_STILL = 5e-6  # T, sweep of the field below which the instrument did not move
_INTERVAL = "choose an interval without it (start=, end=)"
_MATTERS = (
    1.0  # deg, by which the heading error of a tilted vehicle exceeds that of a level one if both are stated
)
_CHANNEL = re.compile(r"^(magnetic_field|angular_rate): ")  # with which findings about one sensor begin
_MODEL_ERROR = "what the model does not explain"


@dataclass(frozen=True)
class Verdict:
    """The decision whether to use a result, with its reasons.

    Attributes:
        trusted: whether to use it.
        cause, action: the reason against its use and the remedy, at most 30 words together; "" for a trusted result.
        heading: the heading error to expect; unknown for a result that is not trusted.
        worth: the expected accuracy, as text.
        details: further findings, one sentence each.
        called: the title of a verdict that is not on a calibration.
    """

    trusted: bool
    cause: str = ""
    action: str = ""
    heading: HeadingUncertainty = field(default_factory=lambda: HeadingUncertainty(None, None))
    worth: str = ""
    details: tuple[str, ...] = ()
    called: str = ""

    @property
    def title(self) -> str:
        """`called`, or the title of a verdict on a calibration."""
        return self.called or ("Calibrated" if self.trusted else "Do not use this calibration")

    @property
    def reason(self) -> str:
        """Cause and action in one sentence, or `worth` for a trusted result."""
        if self.trusted:
            return self.worth
        return f"{self.cause}: {self.action}" if self.action else self.cause

    @property
    def sentence(self) -> str:
        """The first line of every output."""
        return f"{'✔' if self.trusted else '✘'} {self.title}: {self.reason}"

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as JSON types."""
        return {
            "trusted": self.trusted,
            "sentence": self.sentence,
            "cause": self.cause,
            "action": self.action,
            "heading": dict(self.heading.to_dict()),
            "details": list(self.details),
        }


def judged(calibration: Calibration, recording: Recording | None = None) -> Verdict:
    """Return the verdict on a calibration.

    Args:
        calibration: the calibration to judge.
        recording: the recording it was made from. Without it the heading error is the one that the method stated,
            the error of single samples is omitted, and jumps of the field are not looked for.
    """
    details = _details(calibration)
    if not calibration.trusted:
        cause, action = _cause(calibration, recording)
        return Verdict(False, cause, action, worth="heading error unknown", details=details)
    if recording is not None and recording.magnetic_field_unit == "counts":
        return Verdict(True, worth=calibration.message or "converged", details=details)
    if recording is None:
        heading = HeadingUncertainty.stated(calibration)
    else:
        heading = HeadingUncertainty.of(recording, calibration)
    return Verdict(True, heading=heading, worth=_worth(calibration, heading), details=details)


def degrees(value: float | None) -> str:
    """Return an angle with two digits, or "unknown"."""
    return "unknown" if value is None else f"{value:.2g}°"


def parts_of_sigma(calibration: Calibration) -> tuple[float, float] | None:
    """Return the two parts of the hard iron's sigma, in T: sensor noise and model error; None where not separated."""
    noise_covariance = calibration.noise_covariance
    if calibration.covariance is None or noise_covariance is None:
        return None
    noise, whole = (
        float(np.linalg.eigvalsh(matrix[6:9, 6:9])[-1]) for matrix in (noise_covariance, calibration.covariance)
    )
    return float(np.sqrt(max(noise, 0.0))), float(np.sqrt(max(whole - noise, 0.0)))


def _worth(calibration: Calibration, heading: HeadingUncertainty) -> str:
    if calibration.covariance is None:
        systematic = f"heading error unknown, {calibration.method or 'the method'} states no uncertainty"
    elif heading.systematic is None:
        systematic = "systematic heading error unknown (1σ beyond 90°)"
    else:
        systematic = f"systematic heading error at most {degrees(heading.systematic)} (1σ)"
        if heading.tilted is not None and heading.tilted > heading.systematic + _MATTERS:
            systematic += f", level; {degrees(heading.tilted)} when tilted by {TILT:.0f}°"
    if heading.per_sample is None:
        return systematic
    return f"{systematic}; single samples {degrees(heading.per_sample)} by sensor noise"


def _cause(calibration: Calibration, recording: Recording | None) -> tuple[str, str]:
    """Return the reason why the calibration is not trusted, and the remedy."""
    if recording is not None and recording.magnetic_field_unit != "counts":
        jumps = field_jumps(recording)
        if jumps:
            times = [f"{jump.time:.0f} s" for jump in jumps]
            listed = times[0] if len(times) == 1 else f"{', '.join(times[:-1])} and {times[-1]}"
            return f"the field jumped at {listed}", f"run `mg.find_gap`, or {_INTERVAL}"
        swept = beyond_turning(recording, calibration.field_strength)
        if swept is not None:
            size = f"the field changed by {swept * 1e6:.0f} µT, more than turning makes it"
            return f"a magnet came near ({size})", _INTERVAL
    apart = next((note for note in recording.notes if note.startswith(CLOCKS_APART)), None) if recording else None
    if apart is not None:
        return apart.partition(" (")[0], clauses(apart)[1]
    first = next(iter(clauses(calibration.message)), "the method did not converge")
    observability = calibration.observability
    motion = "too little motion" in first or "not observable" in first or calibration.converged
    if observability is not None and not observability.observable and motion:
        missing = list(dict.fromkeys(w.remedy for w in observability.weak if w.sigma > w.limit))
        cause = f"too little motion to determine the {observability.weak[0].what}"
        if recording is not None and float(np.ptp(recording.magnetic_field, axis=0).max()) < _STILL:
            cause = "the instrument hardly moved"
        return cause, _joined_remedies(missing) + _or_by_a_fact(calibration.message)
    return cause_and_action(_CHANNEL.sub("", first))


def _or_by_a_fact(message: str) -> str:
    """Return the options of the cheapest fact that would be enough for this motion; "" if none is."""
    said = next((clause for clause in clauses(message) if clause.startswith(ENOUGH)), "")
    options = said.removeprefix(ENOUGH).partition("(")[2].partition(":")[0]
    return f"; or give {options}" if options else ""


def _joined_remedies(remedies: list[str]) -> str:
    """Return one action that covers several remedies."""
    turn, pitch = "turn through all headings", "pitch or roll by 20° or more"
    if any(turn in remedy for remedy in remedies) and any(pitch in remedy for remedy in remedies):
        remedies = [turn, pitch]
    *first, last = sorted(remedies[:2], key=lambda remedy: remedy.startswith("record"))
    again = last if last.startswith("record") else f"{last}, and record again"
    return ", ".join([*first, again])


def _details(calibration: Calibration) -> tuple[str, ...]:
    sentences = clauses(calibration.message)
    parts = parts_of_sigma(calibration)
    if parts is not None and calibration.trusted and _MODEL_ERROR not in calibration.message:
        noise, model = (f"{value * 1e6:.2g} µT" for value in parts)
        sentences.append(f"hard iron ±1σ: sensor noise {noise}, {_MODEL_ERROR} {model}")
    observability = calibration.observability
    if observability is None:
        sentences.append("the method does not say whether the motion was sufficient: judge by the figures")
    else:
        weak = [weakness.sentence for weakness in observability.weak]
        sentences += [sentence for sentence in weak if sentence not in calibration.message]
    return tuple(dict.fromkeys(sentences))


def said(sentence: str) -> str:
    """Return the clause as a sentence, with a capital letter and a full stop."""
    return sentence[:1].upper() + sentence[1:].removesuffix(".") + "."
