"""Readings in steps: removal of the mean error of readings that were rounded, or truncated towards zero.

A reading x with noise σ before it is rounded to steps q has the mean x + e(x),

    e(x) = Σ_k (−1)^k q / (π k) exp(−2 π² k² σ² / q²) sin(2 π k (x − o) / q)

with o any of the steps: nearly zero for σ > q / 2, a staircase for small σ, which would be taken for a non-linear,
clipped or late response. With the x that the model predicts, e(x) is known. (Widrow and Kollár, Quantization Noise,
2008.) An integer conversion that drops the digits behind the point truncates: a positive reading is rounded half a step
lower, a negative one half a step higher,

    e(x − q / 2) + q (Φ(−x / σ) − 1 / 2)

with the steps at multiples of q. The jump by q where the sign changes is there at any noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from magyc_gtsam.estimators.smoother.truncated import middles, nats_gained
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.model.base import problem_of
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.model.refit import Refit, refit
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import fine_twin
from magyc_gtsam.recording import Recording

_TERMS = 8


def without_steps(
    recording: Recording, model: Model, step: float, level: float, truncated: bool = False
) -> Recording:
    """Return the recording without the mean error of its steps.

    Args:
        recording: the data with readings as they were logged.
        model: that predicts the readings; of truncated ones, fitted to them `centred`.
        step: T, of the readings.
        level: T, standard deviation of the model's residual of a sample.
        truncated: whether the readings were truncated towards zero instead of rounded.
    """
    noise = np.sqrt(max(level**2 - step**2 / 12, (0.05 * step) ** 2))
    blurred = step / np.pi * np.exp(-2 * (np.pi * noise / step) ** 2) < RULES.blurred * level
    if blurred and not truncated:
        return recording
    predicting = centred(recording, step) if truncated else recording
    twin = fine_twin(predicting, model)
    time, reading = predicting.magnetometer
    known = np.isin(time, twin.time)
    expected = reading[known] + twin.chain.residuals(twin.state).window.T
    rows = np.flatnonzero(recording.magnetic_field_fresh)[known]
    field = recording.magnetic_field.copy()
    if truncated:
        field[rows] -= truncation(expected, step, noise)
    else:
        steps = recording.magnetic_field[recording.magnetic_field_fresh]
        origin = step * np.angle(np.exp(2j * np.pi * steps / step).mean(axis=0)) / (2 * np.pi)
        field[rows] -= rounding(expected - origin, step, noise)
    return replace(recording, magnetic_field=field)


def rounding(reading: Array, step: float, noise: float) -> Array:
    """Return the mean error of rounding for readings (n, 3), relative to a step."""
    result = np.zeros_like(reading)
    for k in range(1, _TERMS + 1):
        size = (-1) ** k * step / (np.pi * k) * np.exp(-2 * (np.pi * k * noise / step) ** 2)
        result += size * np.sin(2 * np.pi * k * reading / step)
    return result


def truncation(reading: Array, step: float, noise: float) -> Array:
    """Return the mean error of truncation towards zero for readings (n, 3)."""
    result: Array = rounding(reading - step / 2, step, noise) + step * (ndtr(-reading / noise) - 0.5)
    return result


def centred(recording: Recording, step: float) -> Recording:
    """Return truncated readings, each in the middle of what it stands for."""
    return replace(recording, magnetic_field=middles(recording.magnetic_field, np.full(3, step)))


def truncated_fit(recording: Recording, step: float, base: Refit) -> tuple[float, Refit]:
    """Return the nats by which readings are explained better as truncated than as rounded, and their model so.

    Args:
        recording: the data with readings as they were logged.
        step: T, of the readings.
        base: the model fitted to them as they are.
    """
    reading = recording.magnetometer.value / step
    if float(np.abs(reading - np.round(reading)).max()) > RULES.lattice_off:
        return -np.inf, base  # zero is no step
    try:
        fitted = refit(problem_of(centred(recording, step)), base.model, None)
    except MagycError:
        return -np.inf, base  # no minimum
    return nats_gained(base.twin.fit(), fitted.twin.fit()), fitted
