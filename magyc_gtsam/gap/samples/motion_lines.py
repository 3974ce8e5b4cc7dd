"""Spectral lines of the motion, at whose frequencies any missing effect of the motion makes a tone of the residual."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.recording import Recording

_ORDERS = (1, 2, 3, 4)  # harmonics that a function of a periodic motion has
_LINE = 2  # bins on each side of a frequency that its line may occupy
_BESIDE = 20  # bins on each side that tell the level beside it


def follows_motion(recording: Recording, frequency: float, amplitude: float) -> bool:
    """Return whether a tone may be a misfit of a motion with a line at its frequency, or at a fraction of it.

    The motion has a line where the gyroscope has one. A tone larger than the field's own change in that line, as a
    motor has that shakes the gyroscope, is no misfit of it.

    Args:
        recording: with gyroscope.
        frequency, amplitude: of the tone, Hz and T.
    """
    rates = recording.gyroscope
    step = float(np.median(np.diff(rates.time)))
    duration = float(rates.time[-1] - rates.time[0])
    grid = np.arange(rates.time[0], rates.time[-1], step)
    rate = np.array([np.interp(grid, rates.time, axis) for axis in rates.value.T])
    spectrum = np.abs(np.fft.rfft((rate - rate.mean(axis=1)[:, None]) * np.hanning(len(grid)), axis=1))
    power: Array = (spectrum**2).sum(axis=0)
    strength = float(np.median(np.linalg.norm(recording.magnetometer.value, axis=1)))
    for order in _ORDERS:
        place = round(frequency / order * duration)
        near = power[max(place - _LINE, 1) : place + _LINE + 1]
        beside = power[max(place - _BESIDE, 1) : place + _BESIDE + 1]
        if len(near) and near.max() > RULES.motion_line * np.median(beside):
            swing = (
                4 * np.sqrt(float(near.max())) / len(grid) / (2 * np.pi * frequency / order)
            )  # Hann: half the mean
            if amplitude < strength * swing:
                return True
    return False
