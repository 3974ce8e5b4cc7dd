"""The simulated surroundings of the sensors: thruster current, temperature, depth, position, acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

import numpy as np
from scipy.interpolate import PchipInterpolator

from magyc_gtsam.recording import Array

GRAVITY = 9.80665
CHANNELS = ("current", "temperature", "depth", "position")
_THERMOCLINE = (14.0, 6.0, 25.0, 6.0)  # °C above it, °C below it, its depth and half its width in m


@dataclass(frozen=True, eq=False)
class Environment:
    """The true values of the channels, on the grid of a scene.

    Attributes:
        current: (n,) A, supply current of the thrusters.
        temperature: (n,) °C, temperature of the electronics.
        position: (n, 3) m, north, east, down.
        acceleration: (n, 3) m/s², acceleration of the vehicle in the world frame, without gravity.
    """

    current: Array
    temperature: Array
    position: Array
    acceleration: Array

    @property
    def depth(self) -> Array:
        """The depth (n,), m."""
        return np.asarray(self.position[:, 2])


def surroundings(time: Array, yaw_rate: Array, seed: int) -> Environment:
    """Return random surroundings, which do not depend on the simulated effects.

    Args:
        time: (n,) s, evenly spaced to well within the time constants of the lags.
        yaw_rate: (n,) rad/s; turning draws some current.
        seed: seed of the random numbers.
    """

    def stream(name: str) -> np.random.Generator:
        return np.random.default_rng([seed, crc32(name.encode())])

    current = _current(time, yaw_rate, stream("current"))
    position = _position(time, stream("position"))
    swell = _swell(time, stream("swell"))
    surge = 0.01 * np.gradient(_low_pass(current, time, 2.0), time)
    acceleration = swell + np.column_stack([surge, 0.3 * surge, np.zeros_like(surge)])
    return Environment(current, _temperature(time, position[:, 2], stream("temperature")), position, acceleration)


def measured(environment: Environment, name: str, rows: np.ndarray, seed: int) -> Array:
    """Return a channel as it is logged, with its own noise and resolution."""
    random = np.random.default_rng([seed, crc32(b"measured " + name.encode())])
    if name == "current":
        reading = 1.02 * environment.current[rows] + 0.05 * random.standard_normal(len(rows))
        return np.asarray(np.round(reading, 1))
    if name == "temperature":
        reading = environment.temperature[rows] + 0.02 * random.standard_normal(len(rows))
        return np.asarray(np.round(16 * reading) / 16)
    if name == "depth":
        return np.asarray(environment.depth[rows] + 0.05 * random.standard_normal(len(rows)))
    noise = random.standard_normal((len(rows), 3)) * [0.3, 0.3, 0.05]
    return np.asarray(environment.position[rows] + noise)


def _current(time: Array, yaw_rate: Array, random: np.random.Generator) -> Array:
    """Return a current of throttle steps with spin-up and inrush, load from the waves, and ripple of the controller."""
    level = np.zeros(len(time))
    at = time[0]
    while at < time[-1]:
        lasting = random.uniform(6, 40)
        throttle = 0.0 if random.random() < 0.25 else random.uniform(0.25, 1.0)
        level[(time >= at) & (time < at + lasting)] = throttle
        at += lasting
    turning = np.abs(yaw_rate) / max(float(np.abs(yaw_rate).max()), 1e-9)
    demand = 14.0 * level + 2.0 * turning * (level > 0)
    speed = _low_pass(demand, time, 0.7)
    inrush = np.clip(demand - speed, 0, None) * 0.6
    load = 1 + 0.08 * _low_pass(random.standard_normal(len(time)), time, 1.5) * np.sqrt(2 * 1.5 / _step(time))
    ripple = 1 + 0.05 * np.sin(2 * np.pi * (7.3 * time + np.cumsum(speed) * _step(time) * 0.9))
    return np.asarray(0.8 + (speed + inrush) * load * ripple)


def _temperature(time: Array, depth: Array, random: np.random.Generator) -> Array:
    """Return the temperature from water by depth, delayed by the housing, and the electronics' own warming."""
    above, below, at, width = _THERMOCLINE
    water = below + (above - below) * 0.5 * (1 - np.tanh((depth - at) / width))
    inside = _low_pass(water, time, 60.0)
    warming = random.uniform(3, 6) * (1 - np.exp(-(time - time[0]) / random.uniform(120, 300)))
    return np.asarray(inside + warming)


def _position(time: Array, random: np.random.Generator) -> Array:
    """Return a position on legs of one to two minutes at 0.8 m/s, at depths between 3 and 60 m."""
    span = float(time[-1] - time[0])
    knots = time[0] + np.concatenate([[0.0], np.cumsum(random.uniform(50, 110, int(span / 50) + 3))])
    course = np.cumsum(random.normal(0, 0.9, len(knots))) + random.uniform(0, 2 * np.pi)
    leg = 0.8 * np.diff(knots, prepend=knots[0])
    horizontal = np.cumsum(leg[:, None] * np.column_stack([np.cos(course), np.sin(course)]), axis=0)
    deep = np.arange(len(knots)) % 2 == random.integers(2)
    depth = np.where(deep, random.uniform(35, 60, len(knots)), random.uniform(3, 20, len(knots)))
    return np.asarray(PchipInterpolator(knots, np.column_stack([horizontal, depth]))(time))


def _swell(time: Array, random: np.random.Generator) -> Array:
    """Return the acceleration (n, 3) m/s² of three waves on each axis."""
    frequency = 2 * np.pi * random.uniform(0.08, 0.3, (3, 3))
    phase = random.uniform(-np.pi, np.pi, (3, 3))
    amplitude = random.uniform(0.05, 0.25, (3, 3))
    return np.asarray((amplitude * np.sin(time[:, None, None] * frequency + phase)).sum(axis=2))


def _step(time: Array) -> float:
    return float(np.median(np.diff(time)))


def _low_pass(value: Array, time: Array, constant: float) -> Array:
    from scipy.signal import lfilter  # imported here because it takes longer than a simulation

    share = _step(time) / (constant + _step(time))
    result, _ = lfilter([share], [1, share - 1], value, zi=[(1 - share) * value[0]])
    return np.asarray(result)
