"""The path of a sample from the world's field to the log, and the places at which a fault can change it.

This module must not import code that detects faults (`estimators`, `sensor_faults`, `gap`, `online`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field as attribute
from typing import Any
from zlib import crc32

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.simulation import FIELD, GYRO_BIAS, HARD_IRON, SOFT_IRON
from magyc_gtsam.simulation.motion import MOTIONS, kinematics
from magyc_gtsam.simulation.scene import lagged

FINER = 10  # points of the fine grid per logged row
NOISE = (1e-6, 5e-3)  # T and rad/s per sample


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """The true motion of the vehicle, on the fine grid.

    Attributes:
        time: (n,) s.
        rows: indices of the logged rows on the grid.
        angles: (n, 3) rad, roll, pitch, heading.
        attitude: n rotations sensor→world.
        rate: (n, 3) rad/s, sensor frame.
    """

    time: Array
    rows: np.ndarray
    angles: Array
    attitude: Rotation
    rate: Array

    @property
    def step(self) -> float:
        """The interval between points of the fine grid, s."""
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True, eq=False)
class LoggedSamples:
    """The logged samples: stamps (n,) s and values (n, 3) of both sensors, T and rad/s.

    `body_R_sensor` (3, 3) turns the magnetometer's axes into the body's, which are those of the gyroscope.
    """

    field_time: Array
    field: Array
    rate_time: Array
    rate: Array
    body_R_sensor: Array = attribute(default_factory=lambda: np.eye(3))

    def recording(self, name: str) -> Recording:
        """Return the log as a reader would return it."""
        if len(self.field_time) == len(self.rate_time) and (self.field_time == self.rate_time).all():
            return Recording(self.field_time, self.field, self.rate, name=name)
        return Recording.from_streams((self.field_time, self.field), (self.rate_time, self.rate), name=name)


Change = Callable[[Any, TrueMotion, float, np.random.Generator], Any]


@dataclass(frozen=True)
class Fault:
    """A fault that changes a signal at one place of its path.

    Attributes:
        place: where it acts: "angles" ((n, 3) rad and its derivative, on the fine grid), "world" and "body" ((n, 3) T,
            the field in world and sensor axes), "iron" ((n, 3) T, with soft and hard iron), "field" ((rows, 3) T, with
            noise), "turn" ((n, 3) rad/s, on the fine grid), "rate" ((rows, 3) rad/s, with bias and noise) or "log" (a
            `LoggedSamples`).
        change: (value, motion, strength, random) → the changed value.
        weak, strong: the strengths of the study by default, in `unit`.
        shows: whether data without the cause's own channel show it on every motion; if not, it resembles misaligned
            chips.
        rate: rate of the log, Hz.
        turns: whether it rotates the axes of the gyroscope, which are the body's.
        cuts: whether no reading of the magnetometer can exceed the largest one.
    """

    place: str
    change: Change
    weak: float
    strong: float
    unit: str
    shows: bool = True
    rate: float = 10.0
    turns: bool = False
    cuts: bool = False

    @property
    def between(self) -> float:
        """The geometric mean of `weak` and `strong`; a number of rows is a whole one."""
        return self._of((self.weak * self.strong) ** 0.5)

    @property
    def slight(self) -> float:
        """As far below `weak` as `between` is above it."""
        return self._of(self.weak * (self.weak / self.strong) ** 0.5) if self.strong else 0.0

    def _of(self, size: float) -> float:
        return max(round(size), 1) if self.unit.startswith(("rows", "places")) else size


def record(
    motion: str,
    seed: int,
    fault: Fault | None = None,
    strength: float = 0.0,
    name: str = "",
    duration: float = 600.0,
) -> LoggedSamples:
    """Return the log of an instrument with a fault, on one of the simulator's motions."""
    random = np.random.default_rng([seed, crc32(motion.encode())])
    own = np.random.default_rng([seed, crc32(name.encode())])
    rate = fault.rate if fault else 10.0
    path = MOTIONS[motion](random)
    time = np.arange(round(duration * rate) * FINER) / (rate * FINER)
    rows = np.arange(0, len(time), FINER)
    noise = random.standard_normal((2, len(rows), 3)) * np.reshape(NOISE, (2, 1, 1))

    def changed(place: str, value: Any) -> Any:
        return fault.change(value, scene, strength, own) if fault is not None and fault.place == place else value

    scene = TrueMotion(time, rows, *_turned(path(time)))
    if fault is not None and fault.place == "angles":
        scene = TrueMotion(time, rows, *_turned(fault.change(path(time), scene, strength, own)))
    world = changed("world", np.tile(FIELD, (len(time), 1)))
    body = changed("body", scene.attitude.inv().apply(world))
    iron = changed("iron", body @ SOFT_IRON.T + HARD_IRON)
    readings = changed("field", iron[rows] + noise[0])
    turn = changed("turn", scene.rate)
    rates = changed("rate", turn[rows] + GYRO_BIAS + noise[1])
    between = Rotation.align_vectors(turn, scene.rate)[0].as_matrix() if fault and fault.turns else np.eye(3)
    log = LoggedSamples(time[rows], readings, time[rows], rates, between)
    return log if fault is None or fault.place != "log" else fault.change(log, scene, strength, own)


def _turned(angles: tuple[Array, Array]) -> tuple[Array, Rotation, Array]:
    return angles[0], *kinematics(*angles)


def direction(random: np.random.Generator) -> Array:
    """Return a unit vector (3,) with uniformly distributed direction."""
    vector = random.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def slow(scene: TrueMotion, random: np.random.Generator, correlation: float) -> Array:
    """Return an Ornstein–Uhlenbeck process (n,) of unit deviation, correlated over `correlation` s."""
    white = random.standard_normal(len(scene.time))
    walk = lagged(white, scene.step, correlation)
    return np.asarray((walk - walk.mean()) / walk.std())


def stretches(count: int, share: float, length: int, random: np.random.Generator) -> np.ndarray:
    """Return (count,) bool: stretches of `length` rows at random places that cover about a share of all."""
    blocks = int(np.ceil(count / length))
    chosen = random.permutation(blocks) < round(share * blocks)
    return np.repeat(chosen, length)[:count]


def one_stretch(count: int, share: float, random: np.random.Generator) -> slice:
    """Return one random stretch of a share of all rows."""
    length = round(share * count)
    first = int(random.integers(0, count - length + 1))
    return slice(first, first + length)


def kept(log: LoggedSamples, rows: np.ndarray) -> LoggedSamples:
    """Return the log reduced to some rows of both sensors."""
    return LoggedSamples(log.field_time[rows], log.field[rows], log.rate_time[rows], log.rate[rows])
