"""Effects on the gyroscope beyond a constant bias."""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.environment import GRAVITY
from magyc_gtsam.simulation.scene import Scene, SimulatedEffect, Stage, direction, lagged, standardised, wandering

Result = tuple[Array, dict[str, Any]]


def _scale(rate: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add scale errors, and half as large non-orthogonalities of the axes, without rotation."""
    matrix = random.standard_normal((3, 3)) * (0.5 + 0.5 * np.eye(3))
    matrix = matrix + matrix.T
    matrix *= size * np.sqrt(3) / np.linalg.norm(matrix)
    return rate + rate @ matrix.T, {"matrix": matrix}


def _quadratic(rate: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a scale error that grows with the rate's magnitude on each axis and levels off."""
    share = random.uniform(0.6, 1.0, 3) * random.choice([-1.0, 1.0], 3)
    return rate + size * share * rate * np.abs(rate) / (1 + 0.3 * np.abs(rate)), {"share": share}


def _temperature(rate: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a bias that follows the chip's own temperature, with a lag of 8 s behind the thermometer."""
    way = direction(random)
    warm = standardised(lagged(scene.environment.temperature, scene.step, 8.0))
    return rate + size * warm[:, None] * way, {"direction": way}


def _bias_step(rate: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Let the zero jump, as after a shock, and creep for the last tenth of the way."""
    way, at = direction(random), scene.time[0] + random.uniform(0.25, 0.75) * (scene.time[-1] - scene.time[0])
    since = np.clip(scene.time - at, 0.0, None)
    moved = (since > 0) * (1 - 0.1 * np.exp(-since / 2.0))
    return rate + size * moved[:, None] * way, {"direction": way, "time": float(at)}


def _drift(rate: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Let the zero wander: a random walk of knots every minute, interpolated smoothly."""
    drift = size * wandering(scene.time, 60.0, random)
    return rate + drift, {"reached": drift[-1] - drift[0]}


def _acceleration(rate: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a bias proportional to the specific force, which bends the proof mass."""
    matrix = random.standard_normal((3, 3))
    matrix *= size * np.sqrt(3) / np.linalg.norm(matrix)
    assert scene.attitude is not None
    force = scene.attitude.inv().apply(scene.environment.acceleration - [0.0, 0.0, GRAVITY])
    return rate + force / GRAVITY @ matrix.T, {"matrix": matrix}


EFFECTS = {
    "gyro-scale": SimulatedEffect(Stage.GYROSCOPE, _scale),
    "gyro-quadratic": SimulatedEffect(Stage.GYROSCOPE, _quadratic),
    "temperature-gyro": SimulatedEffect(Stage.GYROSCOPE, _temperature, ("temperature",)),
    "gyro-bias-step": SimulatedEffect(Stage.GYROSCOPE, _bias_step),
    "gyro-bias-drift": SimulatedEffect(Stage.GYROSCOPE, _drift),
    "g-sensitivity": SimulatedEffect(Stage.GYROSCOPE, _acceleration, ("acceleration",), attitude=True),
}
