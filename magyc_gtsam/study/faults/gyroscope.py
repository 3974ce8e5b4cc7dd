"""Faults of the gyroscope: (value, motion, strength, random) → the changed value; see `signals.Fault`."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.recording import Array
from magyc_gtsam.study.faults.signals import TrueMotion, direction, one_stretch, slow

Random = np.random.Generator
_SPIKE = 2.0  # rad/s


def turned_axes(turn: Array, scene: TrueMotion, angle: float, random: Random) -> Array:
    """Rotate the axes against those of the magnetometer by `angle` deg."""
    return Rotation.from_rotvec(np.deg2rad(angle) * direction(random)).apply(turn)


def scale(turn: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Change all gains by a share."""
    return turn * (1 + share)


def scale_of_one_axis(turn: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Change the gain of one axis by a share."""
    return turn * (1 + share * np.eye(3)[random.integers(3)])


def one_sided_spikes(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Add up to 2 rad/s to a share of the samples, always in one direction."""
    hit = random.random(len(rate)) < share
    return rate + _SPIKE * np.outer(hit * random.random(len(rate)), direction(random))


def bias_steps(rate: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Change the bias for the middle third of the log."""
    part = slice(len(rate) // 3, 2 * len(rate) // 3)
    rate = rate.copy()
    rate[part] += amount * direction(random)
    return rate


def bias_drift(rate: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Change the bias linearly by `amount`, ending at the true one."""
    return rate + amount * np.outer(np.linspace(-1, 0, len(rate)), direction(random))


def bias_wander(turn: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Let the bias wander over minutes with the standard deviation `amount`."""
    return turn + amount * np.outer(slow(scene, random, 60.0), direction(random))


def full_scale(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Limit the rate to a full scale that is a share of the largest rate."""
    level = share * np.abs(rate).max()
    return np.clip(rate, -level, level)


def wrapping_full_scale(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Wrap rates beyond a full scale, a share of the largest rate, to the opposite end of the range."""
    level = share * np.abs(rate).max()
    return (rate + level) % (2 * level) - level


def dead(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Set all axes to zero for a share of the log."""
    rate = rate.copy()
    rate[one_stretch(len(rate), share, random)] = 0.0
    return rate


def dead_band(rate: Array, scene: TrueMotion, width: float, random: Random) -> Array:
    """Set rates smaller than `width` rad/s on an axis to zero."""
    return np.where(np.abs(rate) < width, 0.0, rate)


def cubic(turn: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Add a cubic response, a share of the largest rate at that rate."""
    return turn + share * turn**3 / np.abs(turn).max() ** 2


def gravity(turn: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add a bias that depends on gravity, by `amount` per g."""
    down = scene.attitude.inv().apply([0.0, 0.0, 1.0])
    return turn + amount * np.outer(down @ direction(random), direction(random))


def swapped_axes(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Exchange two axes for a share of the log, which reflects the gyroscope's frame."""
    rate, part, kept = rate.copy(), one_stretch(len(rate), share, random), random.integers(3)
    rate[part] = rate[part][:, (2 * kept - np.arange(3)) % 3]
    return rate


def cycled_axes(turn: Array, scene: TrueMotion, places: float, random: Random) -> Array:
    """Permute the names of all three axes cyclically by `places`, which rotates the frame by 120° per place."""
    return np.roll(turn, int(places), axis=1)


def wrong_unit(rate: Array, scene: TrueMotion, factor: float, random: Random) -> Array:
    """Multiply the rates by a wrong factor."""
    return rate * factor


def vibration(turn: Array, scene: TrueMotion, amplitude: float, random: Random) -> Array:
    """Add an oscillation at 31.7 Hz about two axes, a quarter of a period apart, far above the sampling rate."""
    phase = 2 * np.pi * 31.7 * scene.time
    first, second = direction(random), direction(random)
    return turn + amplitude * (np.outer(np.sin(phase), first) + np.outer(np.cos(phase), second))


def noise_bursts(rate: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Add noise of 0.2 rad/s for a share of the log."""
    rate, part = rate.copy(), one_stretch(len(rate), share, random)
    rate[part] += 0.2 * random.standard_normal(rate[part].shape)
    return rate
