"""The heading uncertainty of a calibration over a level turn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.level_turn import LevelTurn, MisalignmentError, calibrated, level_turn
from magyc_gtsam.recording import Array, Recording

UNKNOWN_FROM = 90.0  # deg; a heading with a larger standard deviation is unknown


@dataclass(frozen=True)
class HeadingUncertainty:
    """The largest standard deviation of heading over a level turn.

    Attributes:
        systematic: deg, due to the calibration's covariance and shared by all samples; None without a covariance or
            above 90°.
        tilted: deg, the same of the vehicle pitched or rolled by `TILT`, at most 90; None without recording or
            covariance.
        per_sample: deg, due to the magnetometer's noise in one sample; None if the noise is unknown or above 90°.
    """

    systematic: float | None
    per_sample: float | None
    tilted: float | None = None

    @classmethod
    def of(cls, recording: Recording, calibration: Calibration) -> HeadingUncertainty:
        """Compute the uncertainty that terminal, page and files show."""
        turn = turn_of(recording, calibration)
        noise = calibration.noise.get("magnetic_field")
        per_sample = _known(turn.per_sample(noise, calibration.soft_iron)) if noise else None
        level = systematic(turn, calibration)
        if level is None:
            return cls(None, per_sample)
        tilted = (systematic(each, calibration) for each in turn.tilted())
        largest = max(float(sigma.max()) for sigma in tilted if sigma is not None)
        return cls(_known(level), per_sample, min(largest, UNKNOWN_FROM))

    @classmethod
    def stated(cls, calibration: Calibration) -> HeadingUncertainty:
        """Return the uncertainty that the method stored, for use without the recording: same turn, same covariance."""
        sigma = None if calibration.observability is None else calibration.observability.heading_sigma
        return cls(None if sigma is None or not sigma < UNKNOWN_FROM else sigma, None)

    def to_dict(self) -> Mapping[str, float | None]:
        """Return the fields as JSON types, with units in the names."""
        return {"systematic_deg": self.systematic, "per_sample_deg": self.per_sample, "tilted_deg": self.tilted}


def systematic(turn: LevelTurn, calibration: Calibration) -> Array | None:
    """Return the standard deviation (n,) deg of heading on a turn by all that the calibration leaves uncertain.

    None without a covariance.
    """
    if calibration.covariance is None:
        return None
    misalignment = MisalignmentError.of(calibration.diagnostics)
    return turn.systematic(calibration.covariance, calibration.soft_iron, misalignment)


def turn_of(recording: Recording, calibration: Calibration) -> LevelTurn:
    """Return the level turn over which a calibration is judged."""
    strength = calibration.field_strength
    if strength is None:
        field = calibrated(recording.magnetic_field, calibration.soft_iron, calibration.hard_iron)
        strength = float(np.median(np.linalg.norm(field, axis=1)))
    return level_turn(recording, calibration.soft_iron, calibration.hard_iron, strength)


def _known(sigma: Array) -> float | None:
    """Return the largest standard deviation, or None where heading is unknown."""
    worst = float(sigma.max())
    return worst if worst < UNKNOWN_FROM else None
