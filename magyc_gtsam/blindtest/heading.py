"""Heading as the scorer judges it: on the same motion and effects without noise, against the true attitude."""

from __future__ import annotations

from typing import Any

from magyc_gtsam import metrics
from magyc_gtsam.blindtest.generator import noise_free
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.calibration import Calibration
from magyc_gtsam.recording import Recording
from magyc_gtsam.simulation.effects import EFFECTS


def heading_errors(scenario: Scenario, result: dict[str, Any]) -> tuple[float, float] | None:
    """Systematic heading error in degrees with the twelve parameters and with the effects that were added.

    None for real recordings, whose reference is not free of noise, for effects from outside, and where the axes
    are exchanged: the calibrated field is then in the gyroscope's axes, the attitude in the magnetometer's.
    """
    if scenario.set == "real" or "axis-order" in scenario.names or not set(scenario.names) <= EFFECTS.keys():
        return None
    recording = noise_free(scenario)
    before, after = (Calibration.from_dict(result[key]) for key in ("base", "calibration"))
    return heading_error(before, recording), heading_error(after, recording)


def heading_error(calibration: Calibration, recording: Recording) -> float:
    """Standard deviation, in degrees, of the heading of the calibrated field against the attitude's."""
    assert recording.attitude is not None
    return metrics.heading_deviation(calibration.apply(recording), recording.attitude)
