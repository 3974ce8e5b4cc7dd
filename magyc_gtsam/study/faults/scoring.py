"""Classification of a result as right, wrong or refused, by comparison with the truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.level_turn import LevelTurn, MisalignmentError
from magyc_gtsam.recording import Array
from magyc_gtsam.simulation import FIELD, GYRO_BIAS, HARD_IRON, SOFT_IRON

SIGMAS = 3.0  # stated sigmas beyond which a result is wrong
HARD_IRON_MATTERS = 0.5e-6  # T, which turns the heading by a degree where the horizontal field is 28 µT
HEADING_MATTERS = 0.5  # deg
_ALIGNED = np.eye(3)
# Terms that depend on a change: the true readings at rest contain no loop and no tone to correct.
_DYNAMIC = ("timing", "hysteresis", "tone")
# Terms that turn the calibrated field to the gyroscope's axes; the hard iron and its sigma are in the magnetometer's.
_TURNING = ("misalignment", "axis-order")
_APART = 1e-3  # s between readings at rest, during which nothing changes
_RELATIVE_STEP = 1e-9  # step relative to a term's value for its numerical derivative where it has no sigma
OUTCOMES = ("wrong and trusted", "right and trusted", "refused", "crashed")


@dataclass(frozen=True)
class FaultScore:
    """The outcome of one method on one recording.

    Attributes:
        outcome: one of OUTCOMES.
        hard_iron, heading: largest error in T and deg (over a level turn); NaN without a calibration.
        hard_iron_sigmas, heading_sigmas: largest errors in stated sigmas.
        axes_covered: share of the hard iron's three axes on which its error is within one stated sigma.
        message: the message of the result.
    """

    outcome: str
    hard_iron: float
    hard_iron_sigmas: float
    heading: float
    heading_sigmas: float
    axes_covered: float
    message: str

    def row(self) -> dict[str, Any]:
        """Return the score by name."""
        return asdict(self)


def refused(message: str) -> FaultScore:
    """Return the score of a method without a calibration."""
    return FaultScore("refused", np.nan, np.nan, np.nan, np.nan, np.nan, message)


def crashed(error: Exception) -> FaultScore:
    """Return the score of a method that ended in an unexpected exception, which is a defect."""
    return FaultScore("crashed", np.nan, np.nan, np.nan, np.nan, np.nan, f"{type(error).__name__}: {error}")


def score(
    calibration: Calibration | None,
    message: str = "",
    body_R_sensor: Array = _ALIGNED,
    end: float = 0.0,
    largest: float = np.inf,
) -> FaultScore:
    """Score a calibration with its terms by the truth of `signals.record` at the end of the log.

    Args:
        calibration: the result.
        message: the reason why there is no result.
        body_R_sensor: (3, 3) from the sensor's axes to the body's, in which the field is given and the heading judged.
        end: end of the log, s.
        largest: reading of the magnetometer that it cannot exceed, T, in a level turn either.
    """
    if calibration is None or calibration.covariance is None:
        return refused(message or "no calibration with a covariance")
    off = np.abs(_remaining_hard_iron(calibration, end))
    covariance = calibration.covariance.copy()
    covariance[6:9, 6:9] += _term_covariance(calibration, end)
    sigma = np.sqrt(np.diag(covariance)[6:9])
    heading, heading_sigma = _heading(calibration, covariance, body_R_sensor, end, largest)
    iron_wrong = bool(((off > SIGMAS * sigma) & (off > HARD_IRON_MATTERS)).any())
    heading_wrong = bool(((heading > SIGMAS * heading_sigma) & (heading > HEADING_MATTERS)).any())
    outcome = "refused"
    if calibration.trusted:
        outcome = "wrong and trusted" if iron_wrong or heading_wrong else "right and trusted"
    return FaultScore(
        outcome,
        float(off.max()),
        float((off / sigma).max()),
        float(heading.max()),
        float((heading / heading_sigma).max()),
        float((off <= sigma).mean()),
        calibration.message,
    )


def _standing(calibration: Calibration, readings: Array, end: float) -> Array:
    """Return readings (n, 3) T of an instrument at rest, calibrated as at the end of the log."""
    at_rest = replace(calibration, terms=tuple(term for term in calibration.terms if term.name not in _DYNAMIC))
    time = end + _APART * np.arange(len(readings))
    return at_rest.corrected(readings, time=time, angular_rate=np.tile(GYRO_BIAS, (len(readings), 1)))


def _remaining_hard_iron(calibration: Calibration, end: float) -> Array:
    """Return the error (3,) in T of the hard iron, including terms such as a step that add to it at the end."""
    own = replace(calibration, terms=tuple(term for term in calibration.terms if term.name not in _TURNING))
    left: Array = calibration.soft_iron @ _standing(own, np.stack([HARD_IRON, HARD_IRON]), end)[-1]
    return left


def _term_covariance(calibration: Calibration, end: float) -> Array:
    """Return the covariance (3, 3) in T² that the terms add to that of the hard iron."""
    covariance, left = np.zeros((3, 3)), _remaining_hard_iron(calibration, end)
    for i, term in enumerate(calibration.terms):
        if term.side != "magnetometer":
            continue
        slope = np.zeros((3, len(term.value)))
        for k, step in enumerate(np.diag(np.maximum(term.sigma, _RELATIVE_STEP))):
            moved = replace(term, value=term.value + step)
            terms = (*calibration.terms[:i], moved, *calibration.terms[i + 1 :])
            slope[:, k] = (_remaining_hard_iron(replace(calibration, terms=terms), end) - left) / step[k]
        covariance += slope @ term.covariance @ slope.T
    return covariance


def _heading(
    calibration: Calibration, covariance: Array, body_R_sensor: Array, end: float, largest: float
) -> tuple[Array, Array]:
    """Return the error (n,) deg of the calibrated heading over a level turn, and its stated sigma."""
    heading = np.arange(0.0, 360.0, 10.0)
    angle = np.deg2rad(heading)
    north, east, down = FIELD  # level turn about the body's z axis
    forward, right = north * np.cos(angle) + east * np.sin(angle), -north * np.sin(angle) + east * np.cos(angle)
    body = np.column_stack([forward, right, np.full_like(angle, down)])
    reading = np.clip(body @ body_R_sensor @ SOFT_IRON.T + HARD_IRON, -largest, largest)
    field = _standing(calibration, reading, end)
    angle = np.arctan2(body[:, 1], body[:, 0])  # angle of the horizontal field in body axes
    error = np.arctan2(field[:, 1], field[:, 0]) - angle
    error = np.abs(np.rad2deg(np.angle(np.exp(1j * error))))
    scale, dip = (
        float(np.cbrt(np.linalg.det(SOFT_IRON))),
        float(np.degrees(np.arctan2(down, np.hypot(north, east)))),
    )
    ahead, left, _ = body_R_sensor  # the body's axes in those of the sensor
    turn = LevelTurn(np.degrees(angle), scale * body @ body_R_sensor, ahead, left, dip, "the body's z axis")
    stated = turn.systematic(covariance, calibration.soft_iron, MisalignmentError.of(calibration.diagnostics))
    return error, np.maximum(stated, 1e-6)
