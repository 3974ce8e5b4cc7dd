"""Outcomes of methods judged by the spread of the field, the heading's error, and each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.autocal.autocal import inliers
from magyc_gtsam.observability import HARD_IRON_LIMIT
from magyc_gtsam.recording import Mask, Recording
from magyc_gtsam.study.heading import heading_error
from magyc_gtsam.study.outcome import Comparison, MethodOutcome, OutcomeStatus

ROBUST = ("autocal", "smoother")  # which tell disturbed samples from others
_MANY = 6.0  # sigmas of both together, from which two methods contradict each other
_MATTERS = {"hard_iron": 0.01, "gyro_bias": 1e-3}  # of the field, and rad/s: below, a contradiction does no harm
_WORSE = 1.05  # spread after over spread before, from which a calibration made it worse
UNCALIBRATED = Calibration(np.eye(3), np.zeros(3), method="raw")


def judge(recording: Recording, asked: Sequence[str], ran: Sequence[MethodOutcome]) -> Comparison:
    """The outcomes of `run_methods` side by side: the spread of the field and the heading's error of each."""
    delay, delay_from = _delay(ran)
    inlier, inlier_from = _inliers(recording, ran)
    raw = MethodOutcome("raw", OutcomeStatus.UNTRUSTED, "", calibration=UNCALIBRATED)
    judged = [_judged(recording, outcome, delay, inlier) for outcome in (raw, *ran)]
    not_run = tuple(asked[len(ran) :])
    comparison = Comparison(
        recording, judged[0], tuple(judged[1:]), delay, delay_from, inlier, inlier_from, not_run
    )
    return replace(comparison, outcomes=tuple(_doubted(comparison, outcome) for outcome in comparison.outcomes))


def _delay(ran: Sequence[MethodOutcome]) -> tuple[float, str]:
    """Of the first method that estimated it and can be trusted."""
    for outcome in ran:
        calibration = outcome.calibration
        if (
            outcome.status is OutcomeStatus.TRUSTED
            and calibration is not None
            and calibration.delay_sigma is not None
        ):
            return calibration.delay, outcome.method
    return 0.0, ""


def _inliers(recording: Recording, ran: Sequence[MethodOutcome]) -> tuple[Mask, str]:
    """By the ellipsoid of the first method of ROBUST that can be trusted."""
    trusted = {o.method: o.calibration for o in ran if o.status is OutcomeStatus.TRUSTED}
    for name in ROBUST:
        calibration = trusted.get(name)
        if calibration is not None:
            return inliers(recording, calibration), name
    return np.ones(len(recording.magnetometer.time), dtype=bool), ""


def _judged(recording: Recording, outcome: MethodOutcome, delay: float, inlier: Mask) -> MethodOutcome:
    """With the spread of the field and the heading's error."""
    if outcome.calibration is None:
        return outcome
    norm = np.linalg.norm(outcome.calibration.corrected(recording.magnetometer.value), axis=1)
    attitude = recording.attitude
    reference = (
        attitude is not None and bool(np.isfinite(attitude).any()) and recording.magnetic_field_unit != "counts"
    )
    return replace(
        outcome,
        spread=float(norm.std()),
        inlier_spread=float(norm[inlier].std()) if inlier.any() else None,
        strength=float(norm.mean()),
        heading=heading_error(recording, outcome.calibration, delay) if reference else None,
    )


def _doubted(comparison: Comparison, outcome: MethodOutcome) -> MethodOutcome:
    """With what the others show and the method itself has not noticed."""
    doubts = [] if outcome.status is OutcomeStatus.TRUSTED else [outcome.reason]
    before, after = comparison.raw.inlier_spread, outcome.inlier_spread
    if before is not None and after is not None and after > _WORSE * before:
        doubts.append("the strength of the calibrated field varies more than that of the raw field")
    if outcome.status is OutcomeStatus.TRUSTED:
        doubts += _apart(comparison, outcome)
    if not doubts:
        return outcome
    status = OutcomeStatus.DOUBTFUL if outcome.status is OutcomeStatus.TRUSTED else outcome.status
    return replace(outcome, status=status, reason="; ".join(doubts))


def _contradictions(reference: MethodOutcome, calibration: Calibration) -> list[str]:
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


def _apart(comparison: Comparison, outcome: MethodOutcome) -> list[str]:
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
