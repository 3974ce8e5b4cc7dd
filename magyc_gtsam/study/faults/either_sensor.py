"""Faults of either sensor: (value, motion, strength, random) → the changed value; see `signals.Fault`."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.scene import lagged
from magyc_gtsam.study.faults.signals import Change, TrueMotion, one_stretch

Random = np.random.Generator


def spikes(size: float) -> Change:
    """Return a fault that adds a normally distributed error of deviation `size` per axis to a share of the samples."""

    def change(value: Array, scene: TrueMotion, share: float, random: Random) -> Array:
        hit = random.random(len(value)) < share
        return value + np.where(hit[:, None], size * random.standard_normal(value.shape), 0)

    return change


def zero_rows(value: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Set a share of the rows to zero on all axes."""
    return np.where((random.random(len(value)) < share)[:, None], 0.0, value)


def stuck_axis(value: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Hold the value of one axis for a share of the log."""
    value, part, axis = value.copy(), one_stretch(len(value), share, random), random.integers(3)
    value[part, axis] = value[part.start, axis]
    return value


def flickering_axis(bit: float) -> Change:
    """Return a fault that holds the value of one axis for a share of the log, except for its last bit."""

    def change(value: Array, scene: TrueMotion, share: float, random: Random) -> Array:
        value = np.round(value / bit) * bit
        part, axis = one_stretch(len(value), share, random), random.integers(3)
        value[part, axis] = value[part.start, axis] + bit * random.integers(0, 2, part.stop - part.start)
        return value

    return change


def flipped_axis(value: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Reverse the sign of one axis for a share of the log."""
    value, part = value.copy(), one_stretch(len(value), share, random)
    value[part, random.integers(3)] *= -1
    return value


def held(value: Array, scene: TrueMotion, rows: float, random: Random) -> Array:
    """Repeat every value for `rows` rows."""
    return value[np.arange(len(value)) // int(rows) * int(rows)]


def low_pass(value: Array, scene: TrueMotion, constant: float, random: Random) -> Array:
    """Apply a first-order filter with a time constant in s."""
    return lagged(value, scene.step, constant)


def coarse(value: Array, scene: TrueMotion, step: float, random: Random) -> Array:
    """Round to multiples of `step`."""
    return np.round(value / step) * step
