"""Effects outside the catalogue, which a diagnosis must call unknown."""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.scene import MILLIGAUSS, Scene, SimulatedEffect, Stage, direction, lagged, standardised

Result = tuple[Array, dict[str, Any]]


def _servo(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add the magnet of a camera that pans against the heading between end stops at ±50°, with a sweep of its own."""
    assert scene.attitude is not None
    heading = scene.attitude.as_euler("ZYX")[:, 0]
    middle = random.uniform(-np.pi, np.pi)
    asked = np.angle(np.exp(1j * (middle - heading))) + 0.3 * np.sin(2 * np.pi * scene.time / 23.0)
    pan = lagged(np.clip(asked, -np.deg2rad(50), np.deg2rad(50)), scene.step, 0.8)
    first, second = np.linalg.qr(random.standard_normal((3, 2)))[0].T
    return field + size * (np.cos(2 * pan)[:, None] * first + np.sin(2 * pan)[:, None] * second), {}


def _loose(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a battery that slides to the lower side once the roll has passed a threshold."""
    assert scene.attitude is not None
    roll = scene.attitude.as_euler("ZYX")[:, 2]
    tilt = (roll - np.median(roll)) / max(float(np.ptp(roll)), 1e-9)
    side = np.where(tilt > 0.15, 1.0, np.where(tilt < -0.15, -1.0, 0.0))
    last = np.maximum.accumulate(np.where(side != 0, np.arange(len(side)), 0))
    way = direction(random)
    return field + size * lagged(side[last], scene.step, 0.5)[:, None] * way, {"direction": way}


def _product(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add to each axis a share of the product of the two other axes."""
    share = random.uniform(0.5, 1.0, 3) * random.choice([-1.0, 1.0], 3)
    part = field / (500 * MILLIGAUSS)
    return field + size * share * np.roll(part, 1, axis=1) * np.roll(part, 2, axis=1), {"share": share}


def _rate_product(rate: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add to each axis a share of the product of the rates about the two other axes."""
    share = random.uniform(0.5, 1.0, 3) * random.choice([-1.0, 1.0], 3)
    return rate + size * share * np.roll(rate, 1, axis=1) * np.roll(rate, 2, axis=1), {"share": share}


def _deadband(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add magnetisation that lags in one direction, during the faster half of the turns only."""
    speed = np.linalg.norm(scene.angular_rate, axis=1)
    band = np.quantile(speed, 0.5)
    fast = np.clip(1 - band / np.maximum(speed, 1e-9), 0, None)
    first, second = direction(random), direction(random)
    change = -np.cross(scene.angular_rate, field) @ first
    return field - size * (fast * change)[:, None] * second, {"band": float(band)}


def _vibration(rate: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a bias that follows the square of the thrusters' current, as rectified vibration does."""
    way = direction(random)
    shaken = standardised(lagged(scene.environment.current**2, scene.step, 0.4))
    return rate + size * shaken[:, None] * way, {"direction": way}


EFFECTS = {
    "servo-magnet": SimulatedEffect(Stage.IRON, _servo, attitude=True),
    "loose-magnet": SimulatedEffect(Stage.IRON, _loose, attitude=True),
    "axis-product": SimulatedEffect(Stage.ELECTRONICS, _product),
    "rate-product": SimulatedEffect(Stage.GYROSCOPE, _rate_product),
    "deadband-lag": SimulatedEffect(Stage.BODY, _deadband),
    "vibration-bias": SimulatedEffect(Stage.GYROSCOPE, _vibration, ("current",)),
}
