"""Estimate the resolution and the white noise of a sensor from its samples alone."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.recording import Array

_ALTERNATES = 0.55  # share of sign changes of second differences; 0.73 for white noise, near 0 for motion
_LEAST = 50  # nonzero second differences needed to count sign changes


def resolution(value: Array) -> float:
    """Return the smallest change of any axis between neighbours, an upper bound of the sensor's step."""
    change = np.abs(np.diff(value, axis=0))
    return float(change[change > 0].min(initial=np.inf))


def white_noise(value: Array) -> float:
    """Return the largest standard deviation of white noise per sample over the axes; 0 if the signal is smooth."""
    levels = []
    for column in value.T:
        second = np.diff(column, 2)
        moved = np.sign(second[second != 0])
        alternates = float((moved[1:] != moved[:-1]).mean()) if len(moved) > _LEAST else 0.0
        if alternates < _ALTERNATES:
            levels.append(0.0)
            continue
        # The median is robust to spikes and motion; sqrt(6) is the gain of second differences.
        levels.append(float(np.median(np.abs(second))) / (0.6745 * np.sqrt(6)))
    return max(levels)
