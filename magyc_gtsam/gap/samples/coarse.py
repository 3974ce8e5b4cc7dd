"""Quantisation with steps that are coarse relative to the noise: removal of the mean rounding error.

A reading x with noise σ before it is rounded to steps q has the mean x + e(x),

    e(x) = Σ_k (−1)^k q / (π k) exp(−2 π² k² σ² / q²) sin(2 π k (x − o) / q)

with o any of the steps: nearly zero for σ > q / 2, a staircase for small σ, which would be taken for a non-linear,
clipped or late response. With the x that the model predicts, e(x) is known. (Widrow and Kollár, Quantization Noise,
2008.)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import fine_twin
from magyc_gtsam.recording import Recording

_TERMS = 8


def unrounded(recording: Recording, model: Model, step: float, level: float) -> Recording:
    """Return the recording without the mean rounding error.

    Args:
        recording: the data with readings as they were rounded.
        model: that predicts the readings.
        step: T, of the rounding.
        level: T, standard deviation of the model's residual of a sample.
    """
    noise = np.sqrt(max(level**2 - step**2 / 12, (0.05 * step) ** 2))
    if step / np.pi * np.exp(-2 * (np.pi * noise / step) ** 2) < RULES.blurred * level:
        return recording
    twin = fine_twin(recording, model)
    time, reading = recording.magnetometer
    known = np.isin(time, twin.time)
    expected = reading[known] + twin.chain.residuals(twin.state).window.T
    steps = recording.magnetic_field[recording.magnetic_field_fresh]
    origin = step * np.angle(np.exp(2j * np.pi * steps / step).mean(axis=0)) / (2 * np.pi)
    field = recording.magnetic_field.copy()
    rows = np.flatnonzero(recording.magnetic_field_fresh)[known]
    field[rows] -= rounding(expected - origin, step, noise)
    return replace(recording, magnetic_field=field)


def rounding(reading: Array, step: float, noise: float) -> Array:
    """Return e(x) for readings (n, 3), relative to a step."""
    result = np.zeros_like(reading)
    for k in range(1, _TERMS + 1):
        size = (-1) ** k * step / (np.pi * k) * np.exp(-2 * (np.pi * k * noise / step) ** 2)
        result += size * np.sin(2 * np.pi * k * reading / step)
    return result
