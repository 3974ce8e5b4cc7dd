"""A whole recording as a calibration corrects it."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration.calibration import Calibration
from magyc_gtsam.calibration.elsewhere import TermWarning
from magyc_gtsam.factors.effects.corrections import lag_of
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.held import with_equal_samples

# Standard deviation of the calibrated strength, relative to it: another unit's calibration gives a quarter, real logs
# with their own up to 7 %.
_UNEVEN = 0.12


def calibrated(calibration: Calibration, recording: Recording) -> Recording:
    """Return a recording with calibrated field and, if the calibration has a bias, angular rate.

    Each value stays at its stamp; `without_lag` takes the lag of the magnetometer from its stamps.

    Raises:
        MagycError: a term needs a signal that the recording lacks.

    Warns:
        UserWarning: as `Calibration.apply`, but of terms (`on_recording` returns these sentences).
    """
    rate = recording.angular_rate
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TermWarning)
        if rate is not None and calibration.gyro_bias is not None:
            rate = calibration.apply_gyroscope(recording)
        field = calibration.apply(recording)
    return replace(recording, magnetic_field=field, angular_rate=rate)


def uneven(recording: Recording) -> list[str]:
    """Return a note if the strength of a calibrated field varies more than with the instrument's own calibration."""
    low, middle, high = np.quantile(np.linalg.norm(recording.magnetometer.value, axis=1), [0.16, 0.5, 0.84])
    varies = 0.5 * float(high - low) / max(float(middle), 1e-300)
    if varies < _UNEVEN:
        return []
    return [
        f"the strength of the calibrated field varies by {varies:.0%}: is the log of the calibration's instrument, "
        "with the same iron? A field that varies along the way does the same"
    ]


def without_lag(recording: Recording, lag: float) -> Recording:
    """Return a recording whose magnetometer has stamps earlier by `lag` in s."""
    if lag == 0:
        return recording
    time, field = recording.magnetometer
    gyroscope = None if recording.angular_rate is None else recording.gyroscope
    return with_equal_samples(recording.with_samples((time - lag, field), gyroscope))


def calibrated_on_time(calibration: Calibration, recording: Recording) -> Recording:
    """Return the calibrated recording with the lag of the magnetometer by the calibration's terms taken from it."""
    return without_lag(calibrated(calibration, recording), lag_of(calibration.terms))
