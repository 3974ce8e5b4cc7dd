"""Spectral lines of the motion and of logged channels, at which a misfit of what follows them makes a tone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.recording import Recording

_ORDERS = (1, 2, 3, 4)  # harmonics that a function of a periodic signal has
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
    strength = float(np.median(np.linalg.norm(recording.magnetometer.value, axis=1)))
    return any(
        amplitude < strength * rate / (2 * np.pi * frequency / order)
        for order, rate in _lines(rates.time, rates.value, frequency)
    )


def follows_channels(time: Array, added: Array, frequency: float, amplitude: float) -> bool:
    """Return whether a tone may be a misfit of effects of channels, in which they have a line at its frequency.

    A motor controller's ripple makes one, if the sensor of the current follows it in part, or late.

    Args:
        time: (n,) s.
        added: (3, n) T, what these effects add to the readings.
        frequency, amplitude: of the tone, Hz and T.
    """
    return bool(added.any()) and any(amplitude < size for _, size in _lines(time, added.T, frequency, (1,)))


def _lines(
    time: Array, value: Array, frequency: float, orders: Sequence[int] = _ORDERS
) -> Iterator[tuple[int, float]]:
    """Yield the orders of which signals (n, k) have a line at a frequency, Hz, and the line's amplitude."""
    step, duration = float(np.median(np.diff(time))), float(time[-1] - time[0])
    grid = np.arange(time[0], time[-1], step)
    signal = np.array([np.interp(grid, time, axis) for axis in value.T])
    spectrum = np.abs(np.fft.rfft((signal - signal.mean(axis=1)[:, None]) * np.hanning(len(grid)), axis=1))
    power: Array = (spectrum**2).sum(axis=0)
    for order in orders:
        place = round(frequency / order * duration)
        near = power[max(place - _LINE, 1) : place + _LINE + 1]
        beside = power[max(place - _BESIDE, 1) : place + _BESIDE + 1]
        if len(near) and near.max() > RULES.motion_line * np.median(beside):
            yield order, 4 * np.sqrt(float(near.max())) / len(grid)  # Hann: half the mean
