"""Faults of either sensor: (value, motion, strength, random) → the changed value; see `signals.Fault`."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.scene import lagged
from magyc_gtsam.study.faults.signals import Change, TrueMotion, one_stretch

Random = np.random.Generator


def spikes(size: float) -> Change:
    """In a share of the samples something of about `size` adds, in any direction."""

    def change(value: Array, scene: TrueMotion, share: float, random: Random) -> Array:
        hit = random.random(len(value)) < share
        return value + np.where(hit[:, None], size * random.standard_normal(value.shape), 0)

    return change


def zero_rows(value: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """A share of the rows reads zero on all axes."""
    return np.where((random.random(len(value)) < share)[:, None], 0.0, value)


def stuck_axis(value: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """One axis keeps its value for a share of the log."""
    value, part, axis = value.copy(), one_stretch(len(value), share, random), random.integers(3)
    value[part, axis] = value[part.start, axis]
    return value


def flickering_axis(bit: float) -> Change:
    """One axis keeps its value for a share of the log, but for its last bit."""

    def change(value: Array, scene: TrueMotion, share: float, random: Random) -> Array:
        value = np.round(value / bit) * bit
        part, axis = one_stretch(len(value), share, random), random.integers(3)
        value[part, axis] = value[part.start, axis] + bit * random.integers(0, 2, part.stop - part.start)
        return value

    return change


def flipped_axis(value: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """One axis has the wrong sign for a share of the log."""
    value, part = value.copy(), one_stretch(len(value), share, random)
    value[part, random.integers(3)] *= -1
    return value


def held(value: Array, scene: TrueMotion, rows: float, random: Random) -> Array:
    """Every value is repeated for so many rows."""
    return value[np.arange(len(value)) // int(rows) * int(rows)]


def low_pass(value: Array, scene: TrueMotion, constant: float, random: Random) -> Array:
    """A filter of the first order, with such a time constant in s."""
    return lagged(value, scene.step, constant)


def coarse(value: Array, scene: TrueMotion, step: float, random: Random) -> Array:
    """In steps."""
    return np.round(value / step) * step
