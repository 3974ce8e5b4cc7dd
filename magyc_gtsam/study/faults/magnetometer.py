"""Faults of the magnetometer: (value, motion, strength, random) → the changed value; see `signals.Fault`."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.study.faults.signals import TrueMotion, direction, one_stretch, stretches

Random = np.random.Generator
_SPIKE = 30e-6  # T


def one_sided_spikes(field: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Add 15 to 45 µT to a share of the samples, always in one direction."""
    hit = random.random(len(field)) < share
    return field + np.where(hit, random.uniform(0.5, 1.5, len(field)), 0)[:, None] * _SPIKE * direction(random)


def one_axis_spikes(field: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Add 30 µT on average to one axis in a share of the samples, always with one sign."""
    hit = random.random(len(field)) < share
    return field + np.outer(hit * random.exponential(_SPIKE, len(field)), np.eye(3)[random.integers(3)])


def frozen(field: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Hold the values of all axes for a share of the log."""
    field, part = field.copy(), one_stretch(len(field), share, random)
    field[part] = field[part.start]
    return field


def full_scale(field: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Limit the field to a full scale that a share of the samples exceeds."""
    level = np.quantile(np.abs(field).max(axis=1), 1 - share)
    return np.clip(field, -level, level)


def wrapping_full_scale(field: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Wrap fields beyond a full scale, which a share of the samples exceeds, to the opposite end of the range."""
    level = np.quantile(np.abs(field).max(axis=1), 1 - share)
    return (field + level) % (2 * level) - level


def moving_mean(iron: Array, scene: TrueMotion, window: float, random: Random) -> Array:
    """Replace each reading by the mean of the last `window` s."""
    from scipy.ndimage import uniform_filter1d

    width = round(window / scene.step)
    return np.asarray(uniform_filter1d(iron, width, axis=0, origin=(width - 1) // 2))


def noise_bursts(field: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Add noise of 10 µT for a share of the log."""
    loud = stretches(len(field), share, 100, random)
    return field + 1e-5 * loud[:, None] * random.standard_normal(field.shape)


def late_axis(iron: Array, scene: TrueMotion, delay: float, random: Random) -> Array:
    """Delay one axis by `delay` s against the others."""
    iron, axis = iron.copy(), random.integers(3)
    iron[:, axis] = np.interp(scene.time - delay, scene.time, iron[:, axis])
    return iron


def cubic(iron: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Add a cubic response, a share of the largest reading at that reading."""
    largest = np.abs(iron).max()
    return iron + share * iron**3 / largest**2


def dead_zone(iron: Array, scene: TrueMotion, width: float, random: Random) -> Array:
    """Reduce the magnitude on each axis by `width` T, and to zero where it is smaller."""
    return np.sign(iron) * np.maximum(np.abs(iron) - width, 0)


def hysteresis(iron: Array, scene: TrueMotion, width: float, random: Random) -> Array:
    """Apply a play of `width` T: the reading follows only once the field has moved by that much."""
    low, high = iron - width, iron + width
    result, value = np.empty_like(iron), iron[0]
    for i in range(len(iron)):  # each value depends on the one before
        value = np.clip(value, low[i], high[i])
        result[i] = value
    return result


def offset_drift(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Change the offset linearly by `amount`, ending at the true hard iron."""
    return iron + amount * np.outer(scene.time / scene.time[-1] - 1, direction(random))


def offset_walk(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Let the offset walk at random, by `amount` over the log, ending at the true hard iron."""
    walk = np.cumsum(random.standard_normal(iron.shape), axis=0) / np.sqrt(len(iron))
    return iron + amount * (walk - walk[-1])


def iron_step(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Change the hard iron before a time in the middle of the log."""
    before = scene.time < scene.time[-1] * random.uniform(0.3, 0.7)
    return iron + amount * np.outer(before, direction(random))


def iron_steps(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add two steps in hard iron, the last one at some 70 % of the log."""
    share = scene.time / scene.time[-1]
    parts = (share < random.uniform(0.2, 0.4), share < random.uniform(0.6, 0.8))
    return iron + amount * sum(np.outer(part, direction(random)) for part in parts)


def scale_drift(iron: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Change the gain of one axis linearly by a share, ending at the true one."""
    gain = np.ones_like(iron)
    gain[:, random.integers(3)] += share * (scene.time / scene.time[-1] - 1)
    return iron * gain


def reset_flips(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Switch the offset between two values about every 20 s, as a failing set/reset does, ending at the true one."""
    state = np.repeat(random.integers(0, 2, 1 + int(scene.time[-1] / 20)), round(20 / scene.step))
    state = np.resize(state, len(iron))
    return iron + amount * np.outer(state - state[-1], direction(random))


def hum(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add a mains field of 50.3 Hz, far above the sampling rate."""
    phase = 2 * np.pi * 50.3 * scene.time + random.uniform(0, 2 * np.pi)
    return iron + amount * np.outer(np.sin(phase), direction(random))
