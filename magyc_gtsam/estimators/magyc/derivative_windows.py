"""Averages over windows and the field's differences inside them: what residual (7) of the MAGYC paper works on.

A window is used or not by its own samples alone, so that windows formed while data come in are those of a
whole recording.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.gyro_derivative import Samples as DerivativeSamples
from magyc_gtsam.recording import Array, Recording, Samples

GAUSS = 1e-4  # T; the unit inside, so that the paper's sigmas and tolerances mean what they meant there
LEAST_WINDOWS = 4  # 12 unknowns, 3 equations each
_LEAST_COVERED = 0.4  # share of a window between its first sample and its last
_ON_THE_EDGE = 1e-6  # of a window: stamps that close to an edge belong to what follows


class DerivativeWindows(NamedTuple):
    """Averages over windows: time (n,) s, field (n, 3) T, its derivative (n, 3) T/s, rate (n, 3) rad/s."""

    time: Array
    magnetic_field: Array
    derivative: Array
    angular_rate: Array

    def in_gauss(self) -> DerivativeSamples:
        """Field (n, 3) gauss, derivative (n, 3) gauss/s, rate (n, 3) rad/s."""
        return self.magnetic_field / GAUSS, self.derivative / GAUSS, self.angular_rate


def derivative_windows(recording: Recording, length: float = 1.0) -> DerivativeWindows:
    """The windows of a recording, each of `length` seconds, from where both sensors have begun.

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
    """Refuse what cannot be a window's length in seconds."""
    if not (np.isfinite(length) and length > 0):
        raise MagycError(f"window of {length} s; it must be finite and above 0")


def window_index(time: Array | float, start: float, length: float) -> Array:
    """Which window stamps lie in, counted from `start`; as floats, for stamps may be far from it."""
    return np.floor((np.asarray(time) - start) / length + _ON_THE_EDGE)


def form_windows(magnetometer: Samples, gyroscope: Samples, start: float, length: float) -> DerivativeWindows:
    """All windows from `start` on that samples of both sensors cover.

    The mean of ṁ over a window is (last − first sample)/(their time). Windows between whose first sample and
    last, of either sensor, lies less than 0.4 of its length are left out.
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
    """Means of values[first:stop], each by its own sum, so that what lies outside does not touch its last bit."""
    if not len(first):
        return np.empty((0, values.shape[1]))
    edges = np.stack([first, stop], axis=1).ravel()
    padded = np.vstack([values, np.zeros((1, values.shape[1]))])
    return np.add.reduceat(padded, edges, axis=0)[::2] / (stop - first)[:, None]
