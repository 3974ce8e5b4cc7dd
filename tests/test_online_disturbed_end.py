"""The newest windows of a log disagree with those before them, after which something may have changed for good."""

from __future__ import annotations

import numpy as np
import pytest

from magyc_gtsam import OnlineCalibrator, Recording, calibrate
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.reasons import disturbed_end
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.simulation import HARD_IRON, simulate
from magyc_gtsam.study.faults.signals import record

CHANGED = 250.0  # s, after more than the horizon
STEP = np.array([2.25e-6, 1.03e-6, 1.70e-6])  # T


def looks(step):
    """Return of each look from the change on whether the run converged, and the calibration."""
    log = record("moderate", 910, duration=285.0)
    field = log.field + (log.field_time > CHANGED)[:, None] * step
    online, result = OnlineCalibrator(horizon=120.0), []
    for first in range(0, len(field), 20):
        rows = slice(first, first + 20)
        online.update(log.field_time[rows], field[rows], log.rate[rows])
        if log.field_time[rows][-1] > CHANGED + 5:
            result.append((online.converged, online.calibration))
    return result


def test_a_step_that_is_not_yet_found_is_not_trusted_once_its_windows_are_rejected():
    """Its size is within what a place may add, so that it is not decided: 13 looks were trusted, 2.3 µT off."""
    told = 0
    for converged, calibration in looks(STEP):
        if converged and calibration.trusted:
            away = calibration.hard_iron - HARD_IRON - STEP
            assert (np.abs(away) < 3 * calibration.sigma["hard_iron"]).all()
        elif calibration.message.startswith("the field is disturbed in the last "):
            assert "the iron or the gyroscope's bias may have changed for good" in calibration.message
            assert calibration.message.endswith(": keep turning until that is decided")
            assert converged  # the search for a step goes on from the last refit
            told += 1
    assert told > 5


def test_nothing_is_doubted_without_a_change():
    every = looks(0.0 * STEP)
    assert sum(converged and calibration.trusted for converged, calibration in every) > 10
    assert not any("disturbed" in calibration.message for _, calibration in every)


def test_the_end_of_a_recording_is_given_by_its_times():
    log = record("wide", 910, duration=300.0)
    late = log.field_time > 280
    disturbance = 10e-6 * (late * np.sin(log.field_time))[:, None]
    recording = Recording(log.field_time, log.field + disturbance, log.rate)
    fit = fit_field_chain(recording, SmootherOptions())
    assert disturbed_end(fit, 0.0).startswith("the field is disturbed from 28")
    assert disturbed_end(fit).startswith("the field is disturbed in the last ")


def late_jump(seed: int, share: float, size: float) -> tuple[Recording, np.ndarray]:
    """Return a log in whose last part the gyroscope has another bias, and that one."""
    simulated = simulate("wide", 300, 20, seed=seed, magnetometer_noise=3e-7, gyroscope_noise=1e-3)
    recording, jump = simulated.recording, size * np.array([1.0, -1.0, 1.0])
    late = recording.time > (1 - share) * 300
    rate = recording.angular_rate + late[:, None] * jump
    return Recording(recording.time, recording.magnetic_field, rate), simulated.truth.gyro_bias + jump


@pytest.mark.parametrize(("share", "size"), [(0.05, 1e-2), (0.1, 3e-3), (0.2, 1e-2)])
def test_a_late_jump_of_the_gyroscopes_bias_is_doubted_or_in_its_sigma(share: float, size: float) -> None:
    """It was trusted with the bias before the jump, at up to 1,300 sigmas."""
    for seed in (3, 4):
        recording, bias = late_jump(seed, share, size)
        calibration = calibrate(recording)
        away = np.abs(calibration.gyro_bias - bias) / calibration.sigma["gyro_bias"]
        assert not calibration.trusted or away.max() < 3, (calibration.message, away)


def test_without_a_jump_the_gyroscope_is_trusted() -> None:
    calibration = calibrate(late_jump(3, 0.1, 0.0)[0])
    assert calibration.trusted
    assert calibration.sigma["gyro_bias"].max() < 2e-4
