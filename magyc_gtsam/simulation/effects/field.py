"""Effects on the field before the sensor: the place, objects passed, plates, steel, and the mounting."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.scene import Scene, SimulatedEffect, Stage, direction, lagged, standardised

Result = tuple[Array, dict[str, Any]]


def _gradient(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a deep source, whose field grows with the inverse cube of the distance."""
    sign = random.choice([-1.0, 1.0])
    depth = scene.environment.depth
    below = 300.0 - (depth - depth.mean())
    stronger = standardised(below**-3.0) * size * sign
    return field * (1 + stronger)[:, None], {"sign": sign}


def _anomaly(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a dipole on the sea bed that the vehicle passes once at 8 m."""
    at = scene.time[0] + random.uniform(0.25, 0.75) * (scene.time[-1] - scene.time[0])
    position = scene.environment.position
    nearest = np.array([np.interp(at, scene.time, axis) for axis in position.T])
    course = np.array([np.interp(at + 1.0, scene.time, axis) for axis in position.T]) - nearest
    aside = np.cross(course, direction(random))
    away = position - (nearest + 8.0 * aside / max(float(np.linalg.norm(aside)), 1e-12))
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    moment = direction(random)
    dipole = (3 * (away @ moment)[:, None] * away / distance**2 - moment) / distance**3
    dipole *= size / np.linalg.norm(dipole, axis=1).max()
    return field + dipole, {"time": float(at), "moment": moment}


def _eddy_plane(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a plate's eddy currents, which oppose the change of flux during a turn and decay in 30 ms."""
    normal = direction(random)
    way = normal + 0.1 * direction(random)
    way /= np.linalg.norm(way)
    change = -np.cross(scene.angular_rate, field) @ normal
    return field - size * lagged(change, scene.step, 0.03)[:, None] * way, {"normal": normal}


def _load(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Let the supply's current change the permeability of a core beside the sensor."""
    core = direction(random)
    matrix = size * (np.outer(core, core) - 0.3 * np.eye(3))
    current = standardised(lagged(scene.environment.current, scene.step, 0.05))
    return field + current[:, None] * (field @ matrix), {"matrix": matrix}


def _soft_step(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Bring a steel rod near the sensor within half a second, of which the field magnetises the length most."""
    rod, at = direction(random), scene.time[0] + random.uniform(0.25, 0.75) * (scene.time[-1] - scene.time[0])
    matrix = size * (np.outer(rod, rod) - 0.2 * np.eye(3))
    there = 0.5 * (1 + np.tanh((scene.time - at) / 0.2))
    return field + there[:, None] * (field @ matrix), {"matrix": matrix, "time": float(at)}


def _misalignment(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Rotate the magnetometer relative to the gyroscope."""
    turned = size * direction(random)
    return Rotation.from_rotvec(turned).apply(field), {"rotation_vector": turned}


EFFECTS = {
    "field-gradient": SimulatedEffect(Stage.WORLD, _gradient, ("depth",), attitude=True),
    "local-anomaly": SimulatedEffect(Stage.WORLD, _anomaly, attitude=True),
    "eddy-plane": SimulatedEffect(Stage.BODY, _eddy_plane),
    "load-soft-iron": SimulatedEffect(Stage.BODY, _load, ("current",)),
    "soft-iron-step": SimulatedEffect(Stage.BODY, _soft_step),
    "misalignment": SimulatedEffect(Stage.BODY, _misalignment),
}
