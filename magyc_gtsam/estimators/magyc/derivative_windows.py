"""Window averages, and differences of the field within windows, for residual (7) of the MAGYC paper.

Whether a window is used depends on its own samples alone, so that windows formed online are the same as those of the
whole recording.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.gyro_derivative import Samples as DerivativeSamples
from magyc_gtsam.factors.numbers import is_positive
from magyc_gtsam.recording import Array, Recording, Samples

GAUSS = 1e-4  # T; the internal unit, in which the paper's sigmas and tolerances are stated
LEAST_WINDOWS = 4  # for 12 unknowns, with 3 equations each
_LEAST_COVERED = 0.4  # least share of a window between its first and its last sample
_ON_THE_EDGE = 1e-6  # share of a window; stamps this close before an edge belong to the next window


class DerivativeWindows(NamedTuple):
    """Averages over windows: time (n,) s, field (n, 3) T, its derivative (n, 3) T/s, rate (n, 3) rad/s."""

    time: Array
    magnetic_field: Array
    derivative: Array
    angular_rate: Array

    def in_gauss(self) -> DerivativeSamples:
        """Return field (n, 3) gauss, derivative (n, 3) gauss/s and rate (n, 3) rad/s."""
        return self.magnetic_field / GAUSS, self.derivative / GAUSS, self.angular_rate


def derivative_windows(recording: Recording, length: float = 1.0) -> DerivativeWindows:
    """Return the windows of a recording, each of `length` seconds, from the time at which both sensors have started.

    Raises:
        MagycError: no gyroscope, or fewer than 4 windows.
    """
    check_length(length)
    magnetometer, gyroscope = recording.magnetometer, recording.gyroscope
    rate = gyroscope.value
    if recording.angular_rate_is == "interval-mean":  # to the value at the stamp, between two intervals
        rate = np.vstack([0.5 * (rate[:-1] + rate[1:]), rate[-1:]])
    start = max(magnetometer.time[0], gyroscope.time[0])
    windows = form_windows(magnetometer, Samples(gyroscope.time, rate), start, length)
    if len(windows.time) < LEAST_WINDOWS:
        raise MagycError(
            f"{len(windows.time)} windows of {length:g} s are covered by two or more samples of magnetometer and "
            f"gyroscope, at least {LEAST_WINDOWS} are needed; record for longer, or choose a longer window"
        )
    return windows


def check_length(length: float) -> None:
    """Raise `MagycError` unless `length` can be a window's length in seconds."""
    if not is_positive(length):
        raise MagycError(f"window: must be finite and above 0 s, got {length!r}")


def window_index(time: Array | float, start: float, length: float) -> Array:
    """Return the index of the window of each stamp, counted from `start`; as floats, because it may be very large."""
    return np.floor((np.asarray(time) - start) / length + _ON_THE_EDGE)


def form_windows(magnetometer: Samples, gyroscope: Samples, start: float, length: float) -> DerivativeWindows:
    """Return all windows from `start` on that samples of both sensors cover.

    The mean of ṁ over a window is (last − first sample)/(their time difference). Windows in which the first and last
    sample of either sensor are less than 0.4 of the length apart are left out.
    """
    mag_index = window_index(magnetometer.time, start, length)
    gyro_index = window_index(gyroscope.time, start, length)
    windows = np.intersect1d(mag_index, gyro_index)
    windows = windows[windows >= 0]
    first, stop = np.searchsorted(mag_index, windows), np.searchsorted(mag_index, windows, side="right")
    gyro_first, gyro_stop = (
        np.searchsorted(gyro_index, windows),
        np.searchsorted(gyro_index, windows, side="right"),
    )
    span = magnetometer.time[stop - 1] - magnetometer.time[first]
    gyro_span = gyroscope.time[gyro_stop - 1] - gyroscope.time[gyro_first]
    used = np.minimum(span, gyro_span) >= _LEAST_COVERED * length
    first, stop, gyro_first, gyro_stop = first[used], stop[used], gyro_first[used], gyro_stop[used]
    return DerivativeWindows(
        _means(magnetometer.time[:, None], first, stop)[:, 0],
        _means(magnetometer.value, first, stop),
        (magnetometer.value[stop - 1] - magnetometer.value[first]) / span[used, None],
        _means(gyroscope.value, gyro_first, gyro_stop),
    )


def _means(values: Array, first: np.ndarray, stop: np.ndarray) -> Array:
    """Return the means of values[first:stop], each summed separately, so that other values do not affect rounding."""
    if not len(first):
        return np.empty((0, values.shape[1]))
    edges = np.stack([first, stop], axis=1).ravel()
    padded = np.vstack([values, np.zeros((1, values.shape[1]))])
    return np.add.reduceat(padded, edges, axis=0)[::2] / (stop - first)[:, None]
