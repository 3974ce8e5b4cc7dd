"""Effects of iron and currents on the vehicle, which add fields in the sensor frame."""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.scene import Scene, SimulatedEffect, Stage, direction, lagged, standardised, wandering

Result = tuple[Array, dict[str, Any]]


def _motor_current(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add the field of the supply's cable, delayed by 60 ms by shields and housing."""
    way = direction(random)
    current = lagged(scene.environment.current, scene.step, 0.06)
    return field + size * standardised(current)[:, None] * way, {"direction": way}


def _squared(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a field with the square of the supply's current, as of a converter that works half of each period."""
    way = direction(random)
    power = standardised(lagged(scene.environment.current**2, scene.step, 0.1))
    return field + size * power[:, None] * way, {"direction": way}


def _temperature(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a magnet that changes with temperature, 25 s behind the thermometer and slightly more than in proportion."""
    way = direction(random)
    warm = standardised(lagged(scene.environment.temperature, scene.step, 25.0))
    return field + size * (warm + 0.06 * warm**2)[:, None] * way, {"direction": way}


def _step(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a step in hard iron within a third of a second, as of slipping payload."""
    way = direction(random)
    at = scene.time[0] + random.uniform(0.25, 0.75) * (scene.time[-1] - scene.time[0])
    moved = 0.5 * (1 + np.tanh((scene.time - at) / 0.15))
    return field + size * moved[:, None] * way, {"direction": way, "time": float(at)}


def _drift(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a random walk of knots every 20 s, interpolated smoothly."""
    drift = size * wandering(scene.time, 20.0, random)
    return field + drift, {"reached": drift[-1] - drift[0]}


def _hysteresis(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add the hysteresis of a bar of steel by Prandtl and Ishlinskii: a sum of play operators with different coercive
    fields.
    """
    bar = direction(random)
    way = bar + 0.3 * direction(random)
    way /= np.linalg.norm(way)
    along = (field - field.mean(axis=0)) @ bar
    coercive = np.array([0.04, 0.09, 0.16, 0.25]) * np.ptp(along)
    weight = size / (len(coercive) * coercive)
    played = np.empty((len(along), len(coercive)))
    values = along.tolist()
    for column, width in enumerate(coercive.tolist()):
        state = values[0]
        played[:, column] = [state := min(max(state, value - width), value + width) for value in values]
    loop = (played - along[:, None]) @ weight
    return field + loop[:, None] * way, {"bar": bar, "direction": way}


EFFECTS = {
    "motor-current": SimulatedEffect(Stage.IRON, _motor_current, ("current",)),
    "current-squared": SimulatedEffect(Stage.IRON, _squared, ("current",)),
    "temperature-hard-iron": SimulatedEffect(Stage.IRON, _temperature, ("temperature",)),
    "hard-iron-step": SimulatedEffect(Stage.IRON, _step),
    "hard-iron-drift": SimulatedEffect(Stage.IRON, _drift),
    "hysteresis": SimulatedEffect(Stage.IRON, _hysteresis),
}
