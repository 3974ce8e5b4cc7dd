"""Assessment of the heading on the same motion and effects without noise, against the true attitude."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from magyc_gtsam import metrics
from magyc_gtsam.blindtest.generator import noise_free
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.calibrated import calibrated_on_time
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.fingerprint import fingerprint
from magyc_gtsam.simulation.effects import EFFECTS


def heading_errors(scenario: Scenario, result: dict[str, Any]) -> tuple[float, float] | None:
    """Return the systematic heading error, deg, with the twelve parameters alone and with the added effects.

    It is None for real recordings, whose reference has noise, for foreign effects, and for exchanged axes, where the
    calibrated field is in the gyroscope's axes but the attitude in the magnetometer's.
    """
    if scenario.set == "real" or "axis-order" in scenario.names or not set(scenario.names) <= EFFECTS.keys():
        return None
    recording = noise_free(scenario)
    before, after = (Calibration.from_dict(result[key]) for key in ("base", "calibration"))
    return heading_error(before, recording), heading_error(after, recording)


def heading_error(calibration: Calibration, recording: Recording) -> float:
    """Return the standard deviation, deg, of the calibrated field's heading against the attitude's.

    The recording is the fitted one or the same without its noise, so that dated effects hold at their times.
    """
    own = {"recordings": [fingerprint(recording)]}
    corrected = calibrated_on_time(replace(calibration, diagnostics={**calibration.diagnostics, **own}), recording)
    assert corrected.attitude is not None
    rows = corrected.magnetic_field_fresh
    return metrics.heading_deviation(corrected.magnetic_field[rows], corrected.attitude[rows])
