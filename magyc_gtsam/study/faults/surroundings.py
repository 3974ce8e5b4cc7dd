"""Faults of clocks, surroundings and motion: (value, motion, strength, random) → the changed value; see `Fault`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.recording.time_base import interpolated
from magyc_gtsam.simulation.scene import lagged
from magyc_gtsam.study.faults.signals import (
    LoggedSamples,
    TrueMotion,
    direction,
    kept,
    one_stretch,
    slow,
    stretches,
)

Random = np.random.Generator


def delayed(iron: Array, scene: TrueMotion, delay: float, random: Random) -> Array:
    """Delay the magnetometer by `delay` s."""
    return interpolated(scene.time - delay, scene.time, iron)


def wandering_latency(iron: Array, scene: TrueMotion, largest: float, random: Random) -> Array:
    """Let the magnetometer's latency wander between 0 and `largest` s."""
    wander = slow(scene, random, 20.0)
    delay = largest * (wander - wander.min()) / np.ptp(wander)
    return interpolated(scene.time - delay, scene.time, iron)


def stepping_latency(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add `amount` s to the magnetometer's latency in the second half of the log."""
    return interpolated(scene.time - amount * (scene.time > 0.5 * scene.time[-1]), scene.time, iron)


def clock_drift(log: LoggedSamples, scene: TrueMotion, rate: float, random: Random) -> LoggedSamples:
    """Let the magnetometer's clock run fast by `rate`."""
    return replace(log, field_time=log.field_time * (1 + rate))


def jitter(log: LoggedSamples, scene: TrueMotion, amount: float, random: Random) -> LoggedSamples:
    """Add a random error of deviation `amount` s to the magnetometer's stamps."""
    step = log.field_time[1] - log.field_time[0]
    off = np.clip(amount * random.standard_normal(len(log.field_time)), -0.49 * step, 0.49 * step)
    return replace(log, field_time=log.field_time + off)


def lost_samples(log: LoggedSamples, scene: TrueMotion, share: float, random: Random) -> LoggedSamples:
    """Remove a share of the rows at random."""
    return kept(log, random.random(len(log.field_time)) >= share)


def lost_bursts(log: LoggedSamples, scene: TrueMotion, share: float, random: Random) -> LoggedSamples:
    """Remove a share of the rows, 30 in a row."""
    return kept(log, ~stretches(len(log.field_time), share, 30, random))


def slow_log(log: LoggedSamples, scene: TrueMotion, rows: float, random: Random) -> LoggedSamples:
    """Keep only one of every `rows` rows."""
    return kept(log, np.arange(len(log.field_time)) % int(rows) == 0)


def swell(angles: tuple[Array, Array], scene: TrueMotion, period: float, random: Random) -> tuple[Array, Array]:
    """Add roll and pitch of 10° and yaw of 3° in a swell of period `period` s; the log of this fault has 1 Hz."""
    angle, derivative = angles
    frequency, phase = 2 * np.pi / period, random.uniform(0, 2 * np.pi, 3)
    amplitude = np.deg2rad([10.0, 10.0, 3.0])
    argument = frequency * scene.time[:, None] + phase
    return angle + amplitude * np.sin(argument), derivative + amplitude * frequency * np.cos(argument)


def mostly_at_rest(
    angles: tuple[Array, Array], scene: TrueMotion, share: float, random: Random
) -> tuple[Array, Array]:
    """Stop the motion for the last share of the log."""
    angle, derivative = angles
    moving = scene.time < (1 - share) * scene.time[-1]
    last = int(moving.sum()) - 1
    return np.where(moving[:, None], angle, angle[last]), np.where(moving[:, None], derivative, 0.0)


def nearly_level(
    angles: tuple[Array, Array], scene: TrueMotion, share: float, random: Random
) -> tuple[Array, Array]:
    """Reduce roll and pitch by a share."""
    gain = np.array([1 - share, 1 - share, 1.0])
    return angles[0] * gain, angles[1] * gain


def current_with_pitch(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add the field of a current that is proportional to pitch (nose-up thrust), fixed in the vehicle."""
    pitch = scene.angles[:, 1]
    return iron + amount * np.outer((pitch - pitch.mean()) / pitch.std(), direction(random))


def current_with_turning(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add the field of a current that follows the rate of turn (rudder, thruster)."""
    rate = np.abs(scene.rate[:, 2])
    return iron + amount * np.outer((rate - rate.mean()) / rate.std(), direction(random))


def switched_current(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add the field of an unlogged current that is switched about every half minute; its state at the end is
    the truth.
    """
    state = np.resize(np.repeat(random.integers(0, 2, 100), round(30 / scene.step)), len(iron))
    return iron + amount * np.outer(state - state[-1], direction(random))


def steel_by_heading(world: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add a field that depends on heading, as between the two sides of a lawn-mower pattern, where heading implies
    place.
    """
    side = np.tanh(3 * np.sin(scene.angles[:, 2]))
    return world + amount * np.outer(side, direction(random))


def stay_beside_steel(world: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add a constant field for one stay of 40 % of the time."""
    world = world.copy()
    world[one_stretch(len(world), 0.4, random)] += amount * direction(random)
    return world


def passes_of_steel(world: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add ten passages of 6 s beside steel."""
    result = world.copy()
    for at in random.uniform(0, scene.time[-1], 10):
        result += amount * np.outer(np.exp(-0.5 * ((scene.time - at) / 2) ** 2), direction(random))
    return result


def gradient_on_an_arm(world: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add a field gradient to a sensor at the end of an arm, so that the field depends on the attitude."""
    gradient = random.standard_normal((3, 3))
    gradient = gradient + gradient.T
    gradient -= np.eye(3) * np.trace(gradient) / 3  # trace zero by Maxwell's equations
    return world + amount * scene.attitude.apply(direction(random)) @ (gradient / np.linalg.norm(gradient))


def wandering_field(world: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Let the field of the place wander over half minutes with the standard deviation `amount`."""
    return world + amount * np.stack([slow(scene, random, 30.0) for _ in range(3)], axis=1)


def weakening_field(world: Array, scene: TrueMotion, share: float, random: Random) -> Array:
    """Weaken the field linearly by a share."""
    return world * (1 - share * scene.time / scene.time[-1])[:, None]


def eddy_currents(body: Array, scene: TrueMotion, constant: float, random: Random) -> Array:
    """Add a plate beside the sensor: a third of the field across it is delayed, by a time constant in s."""
    normal = direction(random)
    late = lagged(body, scene.step, constant) - body
    return body + (late @ normal)[:, None] * normal * 0.33


def rotating_iron(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add a magnet that rotates at 0.7 Hz on the vehicle."""
    phase = 2 * np.pi * 0.7 * scene.time
    return iron + amount * np.column_stack([np.cos(phase), np.sin(phase), np.zeros_like(phase)])


def iron_that_swings(iron: Array, scene: TrueMotion, amount: float, random: Random) -> Array:
    """Add a hanging magnetic load, whose field follows roll."""
    roll = scene.angles[:, 0]
    return iron + amount * np.outer(roll / max(roll.std(), 1e-9), direction(random))


def helper_at_the_start(iron: Array, scene: TrueMotion, duration: float, random: Random) -> Array:
    """Add the field of a tool of 20 µT beside the sensor for the first `duration` s."""
    return iron + 20e-6 * np.outer(scene.time < duration, direction(random))


def magnet_and_gap(log: LoggedSamples, scene: TrueMotion, amount: float, random: Random) -> LoggedSamples:
    """Interrupt the log for a minute in the middle, with another hard iron before the interruption."""
    middle = 0.5 * log.field_time[-1]
    before = log.field_time < middle
    log = replace(log, field=log.field + amount * np.outer(before, direction(random)))
    return kept(log, (log.field_time < middle - 30) | (log.field_time > middle + 30))
