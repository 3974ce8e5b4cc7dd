"""Comparison of the magnetic heading of a calibrated field with a reference attitude."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam import metrics
from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.time_base import interpolated


class HeadingError(NamedTuple):
    """Magnetic minus reference heading about its mean: time (n,) s since the first row, error (n,) deg."""

    time: Array
    error: Array

    @property
    def deviation(self) -> float:
        """The standard deviation, deg."""
        return float(self.error.std())


def heading_error(recording: Recording, calibration: Calibration, delay: float | None = None) -> HeadingError:
    """Return the direction of the horizontal calibrated field in the reference's world axes, which should be constant.

    Args:
        recording: a recording with attitude, whose world z axis is vertical.
        calibration: calibration of its magnetometer.
        delay: lag of the magnetometer, s; None takes the calibration's.

    Raises:
        MagycError: the recording has no reference attitude.
    """
    attitude = recording.attitude
    known = np.zeros(0, dtype=bool) if attitude is None else np.isfinite(attitude).all(axis=1)
    if attitude is None or not known.any():
        raise MagycError(f"recording {recording.name!r} has no reference attitude")
    time, field = recording.magnetometer
    late = np.clip(recording.time[known] + (calibration.delay if delay is None else delay), time[0], time[-1])
    calibrated = calibration.corrected(interpolated(late, time, field))
    error = metrics.heading_error(calibrated, attitude[known])
    return HeadingError(recording.time[known] - recording.time[0], np.rad2deg(error))
