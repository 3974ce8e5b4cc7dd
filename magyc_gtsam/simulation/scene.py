"""The scene on which effects act, and the stages from the world's field to the logged rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any
from zlib import crc32

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.environment import Environment, surroundings

MILLIGAUSS = 1e-7  # T


class Stage(Enum):
    """The stages at which effects act, in the order of the signal path, with the quantity at each stage."""

    WORLD = "field in the world frame, (n, 3) T"
    BODY = "true field at the sensor, (n, 3) T"
    IRON = "field with soft and hard iron, (n, 3) T"
    ELECTRONICS = "field as the sensor turns it into numbers, (n, 3) T"
    SAMPLING = "row of the fine grid that each logged row shows, (rows,)"
    READING = "logged field with its noise, (rows, 3) T"
    QUANTISED = "logged field in its last step, (rows, 3) T"
    GYROSCOPE = "angular rate without bias and noise, (n, 3) rad/s"
    AXES = "logged angular rate, (rows, 3) rad/s"


@dataclass(frozen=True, eq=False)
class Scene:
    """True state of vehicle and surroundings, on a grid finer than the rows of the log.

    Attributes:
        time: (n,) s.
        attitude: n rotations sensor→world; None where it is unknown, as in some real recordings.
        angular_rate: (n, 3) rad/s, sensor frame.
        field: (3,) T, world.
        rows: (rows,) index of each logged row on the grid.
        seed: seed of the surroundings.
    """

    time: Array
    attitude: Rotation | None
    angular_rate: Array
    field: Array
    rows: np.ndarray
    seed: int

    @cached_property
    def environment(self) -> Environment:
        """The surroundings that the channels measure."""
        return surroundings(self.time, self.angular_rate[:, 2], self.seed)

    @property
    def step(self) -> float:
        """The interval between grid points, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def row_time(self) -> Array:
        """The times (rows,) of the logged rows, s."""
        return self.time[self.rows]


Apply = Callable[[Any, Scene, float, np.random.Generator], tuple[Any, dict[str, Any]]]


@dataclass(frozen=True)
class SimulatedEffect:
    """One effect: `apply(value, scene, size, random)` returns the changed value and the random parameters drawn.

    Attributes:
        stage: the stage at which it acts.
        apply: the physics; `size` is in the unit of its published strength.
        needs: channels required to find the effect.
        attitude: whether the physics needs the attitude.
    """

    stage: Stage
    apply: Apply
    needs: tuple[str, ...] = ()
    attitude: bool = False


@dataclass(frozen=True)
class Applied:
    """An effect as applied: its size in `unit`, and the random parameters drawn (directions, times, …)."""

    name: str
    factor: float
    size: float
    unit: str
    drawn: dict[str, Any]


@dataclass(frozen=True)
class RequestedEffect:
    """A requested effect with its name, strength and own stream of random numbers."""

    name: str
    effect: SimulatedEffect
    factor: float
    size: float
    unit: str
    seed: int

    def apply(self, value: Any, scene: Scene) -> tuple[Any, Applied]:
        """Return the value with the effect, and the effect as applied."""
        random = np.random.default_rng([self.seed, crc32(self.name.encode())])
        changed, drawn = self.effect.apply(value, scene, self.size, random)
        return changed, Applied(self.name, self.factor, self.size, self.unit, drawn)


class Chain:
    """The requested effects, applied stage by stage; `applied` records each as applied."""

    def __init__(self, chosen: Sequence[RequestedEffect], scene: Scene) -> None:
        self.scene = scene
        self.applied: list[Applied] = []
        self._chosen = list(chosen)

    def pass_through(self, stage: Stage, value: Any) -> Any:
        """Return `value` after all effects of a stage, applied in the requested order."""
        for chosen in self._chosen:
            if chosen.effect.stage is stage:
                value, applied = chosen.apply(value, self.scene)
                self.applied.append(applied)
        return value


def direction(random: np.random.Generator) -> Array:
    """Return a unit vector (3,) with uniformly distributed direction."""
    vector = random.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def standardised(value: Array) -> Array:
    """Return `value` (n,) minus its mean, divided by its standard deviation."""
    return np.asarray((value - value.mean()) / max(float(value.std()), 1e-300))


def lagged(value: Array, step: float, constant: float) -> Array:
    """Return `value` (n, ...) after a first-order lag with a mean delay of `constant` s, starting settled."""
    from scipy.signal import lfilter

    pole = (constant / step) / (1 + constant / step)
    first = pole * value[:1]
    result, _ = lfilter([1 - pole], [1, -pole], value, axis=0, zi=first)
    return np.asarray(result)


def wandering(time: Array, spacing: float, random: np.random.Generator) -> Array:
    """Return a random walk (n, 3) of zero mean and unit deviation, smooth between knots every `spacing` s."""
    knots = np.arange(time[0], time[-1] + 2 * spacing, spacing)
    walk = np.cumsum(random.standard_normal((len(knots), 3)), axis=0)
    drift = PchipInterpolator(knots, walk)(time)
    drift -= drift.mean(axis=0)
    result: Array = drift / np.sqrt((drift**2).sum(axis=1).mean())
    return result
