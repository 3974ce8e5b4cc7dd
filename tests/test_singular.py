"""Readings without noise of their own, of which the model's equations have no finite solution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

import magyc_gtsam as mg
from magyc_gtsam.factors.errors import SingularError


def _smoothed() -> mg.Recording:
    recording = mg.simulate("moderate", 240, 50, seed=0, magnetometer_noise=1e-7, gyroscope_noise=1e-3).recording
    low_pass = butter(2, 0.002)
    field, rate = (filtfilt(*low_pass, x, axis=0) for x in (recording.magnetic_field, recording.angular_rate))
    return mg.Recording(recording.time, field, rate)


def _interpolated() -> mg.Recording:
    recording = mg.simulate("moderate", 240, 20, seed=29, magnetometer_noise=1e-6, gyroscope_noise=1e-3).recording
    time = np.arange(0, 239, 1 / 60)
    field, rate = (
        np.stack([np.interp(time, recording.time, axis) for axis in x.T], axis=1)
        for x in (recording.magnetic_field, recording.angular_rate)
    )
    return mg.Recording(time, field, rate)


@pytest.mark.parametrize("made", [_smoothed, _interpolated])
def test_readings_without_noise_are_refused_with_the_remedy(made: Callable[[], mg.Recording]) -> None:
    """They raised a LinAlgError."""
    with pytest.raises(SingularError, match="no noise of their own; log each sensor's own samples"):
        mg.calibrate(made())


def test_online_they_give_no_calibration_and_do_not_end_the_run() -> None:
    recording = _smoothed()
    calibrator = mg.OnlineCalibrator()
    for first in range(0, len(recording.time), 500):
        part = slice(first, first + 500)
        calibrator.update(recording.time[part], recording.magnetic_field[part], recording.angular_rate[part])
    assert not calibrator.converged
