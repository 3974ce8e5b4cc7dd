"""Assessment of the outcomes of methods by the spread of the field, the heading error, and each other."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import methods
from magyc_gtsam.estimators.autocal.autocal import inliers
from magyc_gtsam.estimators.smoother.reasons import NOT_CONVERGED, TOO_LITTLE_MOTION
from magyc_gtsam.foreign_text import cause_and_action, clauses
from magyc_gtsam.observability import HARD_IRON_LIMIT
from magyc_gtsam.recording import Mask, Recording
from magyc_gtsam.study.outcome import Comparison, MethodOutcome, OutcomeStatus, heading_error

TESTS_THE_MODEL = "smoother"
_OF_RATES = re.compile("gyroscope|clock|angular_rate|stamps")  # in a cause that is not one of the field
ROBUST = ("autocal", "smoother")  # methods that detect disturbed samples
_MANY = 6.0  # joint sigmas from which two methods contradict each other
_MATTERS = {"hard_iron": 0.01, "gyro_bias": 1e-3}  # share of the field, and rad/s; smaller differences do no harm
_WORSE = 1.05  # ratio of the spreads after and before from which a calibration made it worse
UNCALIBRATED = Calibration(np.eye(3), np.zeros(3), method="raw")


def judge(recording: Recording, asked: Sequence[str], ran: Sequence[MethodOutcome]) -> Comparison:
    """Return the outcomes of `run_methods` with the spread of the field, the heading error and any doubts of each."""
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
    """Return the delay of the first trusted method that estimated it, and the method's name."""
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
    """Return the inliers of the ellipsoid of the first trusted method of ROBUST, and the method's name."""
    trusted = {o.method: o.calibration for o in ran if o.status is OutcomeStatus.TRUSTED}
    for name in ROBUST:
        calibration = trusted.get(name)
        if calibration is not None:
            return inliers(recording, calibration), name
    return np.ones(len(recording.magnetometer.time), dtype=bool), ""


def _judged(recording: Recording, outcome: MethodOutcome, delay: float, inlier: Mask) -> MethodOutcome:
    """Return the outcome with the spread of the field and the heading error."""
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
    """Return the outcome with the doubts that the other methods raise."""
    doubts = [] if outcome.status is OutcomeStatus.TRUSTED else [outcome.reason]
    if _varies_more(comparison, outcome):
        doubts.append("the strength of the calibrated field varies more than that of the raw field")
    if outcome.status is OutcomeStatus.TRUSTED:
        doubts += _apart(comparison, outcome) or _refused_log(comparison, outcome.method)
    if not doubts:
        return outcome
    status = OutcomeStatus.DOUBTFUL if outcome.status is OutcomeStatus.TRUSTED else outcome.status
    return replace(outcome, status=status, reason="; ".join(doubts))


def _refused_log(comparison: Comparison, method: str) -> list[str]:
    """Return a message if the method that tests the model finds the log at fault; other methods do not see that.

    Of a log whose iron jumped by 9 µT four methods stated the mean of both irons without a doubt. Too little motion for
    that method says nothing about one that estimates less, and a fault of rates or clocks nothing about one that does
    without rates.
    """
    tested = next((o for o in comparison.outcomes if o.method == TESTS_THE_MODEL), None)
    if tested is None or tested.status is not OutcomeStatus.UNTRUSTED:
        return []
    cause = cause_and_action(next(iter(clauses(tested.reason)), ""))[0]
    known = methods().get(method)
    without_rates = known is not None and "angular_rate" not in known.needs
    if cause.startswith((TOO_LITTLE_MOTION, NOT_CONVERGED)) or (without_rates and _OF_RATES.search(cause)):
        return []
    return [f"{tested.method}, which tests its model, does not trust this log: {cause}"]


def _varies_more(comparison: Comparison, outcome: MethodOutcome) -> bool:
    """Return whether the calibrated field varies more than the raw one, beyond what the stated errors explain.

    An error (dA, dh) of the parameters changes a reading's length by u · A⁻¹ (dA u + dh), with u its unit vector times
    the length; its variance follows from the covariance. Fits of ellipsoids minimise this spread and other methods do
    not, so the smallest spread does not indicate the smallest error.
    """
    before, after, calibration = comparison.raw.inlier_spread, outcome.inlier_spread, outcome.calibration
    if before is None or after is None or calibration is None or after <= _WORSE * before:
        return False
    if calibration.covariance is None:
        return True
    field = calibration.corrected(comparison.recording.magnetometer.value[comparison.inlier])
    across = (field / np.linalg.norm(field, axis=1, keepdims=True)) @ np.linalg.inv(calibration.soft_iron)
    rows, columns = np.triu_indices(3)
    mirrored = np.where(rows == columns, 0.0, across[:, columns] * field[:, rows])
    slope = np.hstack([across[:, rows] * field[:, columns] + mirrored, across])
    slope -= slope.mean(axis=0)
    stated = float(np.einsum("na,na->", slope @ calibration.covariance[:9, :9], slope)) / len(slope)
    return after**2 - before**2 > _MANY**2 * stated


def _contradictions(reference: MethodOutcome, calibration: Calibration, shown: tuple[float, str]) -> list[str]:
    """Return messages on hard iron and gyroscope bias that differ significantly from the reference, and matter.

    This is common for the classic methods, which state the effect of sensor noise or nothing, but not that of their own
    approximations (a biased least-squares fit, derivatives of noisy readings, a field that is not uniform).
    """
    assert reference.calibration is not None
    assert reference.strength is not None
    scale, unit = shown
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
        apart = float(np.linalg.norm(here - there))
        if off > _MANY and apart > least:
            size = f"{apart * scale:.2g} {unit}" if name == "hard_iron" else f"{apart * 1e3:.2g} mrad/s"
            narrow = (
                f"{off:.0f} sigmas of both: its own sigma is too narrow"
                if name in calibration.sigma
                else f"{off:.0f} of the sigmas that {reference.method} states, and it states none itself"
            )
            doubts.append(f"its {words} is {size} from that of {reference.method}, {narrow}")
    return doubts


def _apart(comparison: Comparison, outcome: MethodOutcome) -> list[str]:
    """Return messages if the hard iron is far from that of the most accurate method, or contradicts it."""
    reference = comparison.reference
    if reference is None or reference.calibration is None or outcome.calibration is None:
        return []
    assert reference.strength is not None
    scale, unit = comparison.recording.field_shown
    apart = float(np.linalg.norm(outcome.calibration.hard_iron - reference.calibration.hard_iron))
    limit = HARD_IRON_LIMIT * reference.strength
    if apart <= limit:
        return _contradictions(reference, outcome.calibration, comparison.recording.field_shown)
    return [
        f"its hard iron is {apart * scale:.1f} {unit} from that of {reference.method} (more than the "
        f"{limit * scale:.1f} that make three degrees of heading)"
    ]
