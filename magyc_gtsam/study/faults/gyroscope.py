"""Faults of the gyroscope: (value, motion, strength, random) → the changed value; see `signals.Fault`."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.recording import Array
from magyc_gtsam.study.faults.signals import TrueMotion, direction, one_stretch, slow

Random = np.random.Generator
_SPIKE = 2.0  # rad/s


def turned_axes(turn: Array, scene: TrueMotion, angle: float, random: Random) -> Array:
    """The axes are turned against those of the magnetometer, by deg."""
    return Rotation.from_rotvec(np.deg2rad(angle) * direction(random)).apply(turn)


def scale(turn: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """All gains are off by a share."""
    return turn * (1 + share)


def scale_of_one_axis(turn: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """One gain is off by a share."""
    return turn * (1 + share * np.eye(3)[random.integers(3)])


def one_sided_spikes(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """In a share of the samples something of up to 2 rad/s adds, always in one direction."""
    hit = random.random(len(rate)) < share
    return rate + _SPIKE * np.outer(hit * random.random(len(rate)), direction(random))


def bias_steps(rate: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """The bias was another one for the middle third."""
    part = slice(len(rate) // 3, 2 * len(rate) // 3)
    rate = rate.copy()
    rate[part] += amount * direction(random)
    return rate


def bias_drift(rate: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """The bias moves evenly by so much, and ends at the true one."""
    return rate + amount * np.outer(np.linspace(-1, 0, len(rate)), direction(random))


def bias_wander(turn: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """The bias wanders over minutes with such a deviation."""
    return turn + amount * np.outer(slow(scene, random, 60.0), direction(random))


def full_scale(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """The full scale is a share of the largest rate."""
    level = share * np.abs(rate).max()
    return np.clip(rate, -level, level)


def wrapping_full_scale(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """The same, and what is beyond comes back from the other side."""
    level = share * np.abs(rate).max()
    return (rate + level) % (2 * level) - level


def dead(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """All axes read zero for a share of the log."""
    rate = rate.copy()
    rate[one_stretch(len(rate), share, random)] = 0.0
    return rate


def dead_band(rate: Array, scene: TrueMotion, width: float, random: Random) -> Array:
    """What is smaller than `width` rad/s on an axis reads zero."""
    return np.where(np.abs(rate) < width, 0.0, rate)


def cubic(turn: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Bent by a share of the largest rate, with its cube."""
    return turn + share * turn**3 / np.abs(turn).max() ** 2


def gravity(turn: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """The bias depends on gravity, by so much per g."""
    down = scene.attitude.inv().apply([0.0, 0.0, 1.0])
    return turn + amount * np.outer(down @ direction(random), direction(random))


def swapped_axes(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Two axes are exchanged for a share of the log, which mirrors the gyroscope's frame."""
    rate, part, kept = rate.copy(), one_stretch(len(rate), share, random), random.integers(3)
    rate[part] = rate[part][:, (2 * kept - np.arange(3)) % 3]
    return rate


def cycled_axes(turn: Array, scene: TrueMotion, places: float, random: Random) -> Array:
    """All three axes have each other's names, so many places on: another frame, turned by 120°."""
    return np.roll(turn, int(places), axis=1)


def wrong_unit(rate: Array, scene: TrueMotion, factor: float, random: Random) -> Array:
    """Multiplied with a wrong factor."""
    return rate * factor


def vibration(turn: Array, scene: TrueMotion, amplitude: float, random: Random) -> Array:
    """Turns to and fro at 31.7 Hz about two axes, a quarter of a period apart, sampled far too slowly."""
    phase = 2 * np.pi * 31.7 * scene.time
    first, second = direction(random), direction(random)
    return turn + amplitude * (np.outer(np.sin(phase), first) + np.outer(np.cos(phase), second))


def noise_bursts(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """For a share of the log the noise is 0.2 rad/s."""
    rate, part = rate.copy(), one_stretch(len(rate), share, random)
    rate[part] += 0.2 * random.standard_normal(rate[part].shape)
    return rate
