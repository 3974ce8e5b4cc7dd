"""What effects act on: the scene, and the stages from the world's field to the logged rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any
from zlib import crc32

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.environment import Environment, surroundings

MILLIGAUSS = 1e-7  # T


class Stage(Enum):
    """Where an effect acts, and on what; in the order of the signal's way."""

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
    """Truth about vehicle and surroundings, on a grid finer than the rows of the log.

    Attributes:
        time: (n,) s.
        attitude: n rotations sensor→world; None where nobody knows (a real recording).
        angular_rate: (n, 3) rad/s, sensor frame.
        field: (3,) T, world.
        rows: (rows,) index of each logged row on the grid.
        seed: of the surroundings.
    """

    time: Array
    attitude: Rotation | None
    angular_rate: Array
    field: Array
    rows: np.ndarray
    seed: int

    @cached_property
    def environment(self) -> Environment:
        """What the channels measure."""
        return surroundings(self.time, self.angular_rate[:, 2], self.seed)

    @property
    def step(self) -> float:
        """s between grid points."""
        return float(np.median(np.diff(self.time)))

    @property
    def row_time(self) -> Array:
        """(rows,) s."""
        return self.time[self.rows]


Apply = Callable[[Any, Scene, float, np.random.Generator], tuple[Any, dict[str, Any]]]


@dataclass(frozen=True)
class SimulatedEffect:
    """One effect: `apply(value, scene, size, random)` gives the changed value and what was drawn.

    Attributes:
        stage: where it acts.
        apply: the physics; `size` is in the unit of its published strength.
        needs: channels without which nobody could find it.
        attitude: whether the physics needs to know the attitude.
    """

    stage: Stage
    apply: Apply
    needs: tuple[str, ...] = ()
    attitude: bool = False


@dataclass(frozen=True)
class Applied:
    """An effect as it was applied: its size in `unit`, and what was drawn (directions, times, …)."""

    name: str
    factor: float
    size: float
    unit: str
    drawn: dict[str, Any]


@dataclass(frozen=True)
class Chosen:
    """An effect with its name and strength, and its own stream of random numbers."""

    name: str
    effect: SimulatedEffect
    factor: float
    size: float
    unit: str
    seed: int

    def apply(self, value: Any, scene: Scene) -> tuple[Any, Applied]:
        """The value with the effect, and the truth about it."""
        random = np.random.default_rng([self.seed, crc32(self.name.encode())])
        changed, drawn = self.effect.apply(value, scene, self.size, random)
        return changed, Applied(self.name, self.factor, self.size, self.unit, drawn)


class Chain:
    """The chosen effects, applied stage by stage; `applied` collects the truth."""

    def __init__(self, chosen: Sequence[Chosen], scene: Scene) -> None:
        self.scene = scene
        self.applied: list[Applied] = []
        self._chosen = list(chosen)

    def pass_through(self, stage: Stage, value: Any) -> Any:
        """`value` after all effects of a stage, in the order in which they were asked for."""
        for chosen in self._chosen:
            if chosen.effect.stage is stage:
                value, applied = chosen.apply(value, self.scene)
                self.applied.append(applied)
        return value


def direction(random: np.random.Generator) -> Array:
    """(3,) unit vector, all directions alike."""
    vector = random.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def standardised(value: Array) -> Array:
    """`value` (n,) about its mean, in units of its own deviation."""
    return np.asarray((value - value.mean()) / max(float(value.std()), 1e-300))


def lagged(value: Array, step: float, constant: float) -> Array:
    """First-order lag of `value` (n, ...), whose mean delay is exactly `constant` s; starts settled."""
    from scipy.signal import lfilter

    pole = (constant / step) / (1 + constant / step)
    first = pole * value[:1]
    result, _ = lfilter([1 - pole], [1, -pole], value, axis=0, zi=first)
    return np.asarray(result)
