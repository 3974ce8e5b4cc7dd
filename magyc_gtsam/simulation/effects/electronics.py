"""Effects of the magnetometer's core and electronics."""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.scene import MILLIGAUSS, Scene, SimulatedEffect, Stage, lagged, standardised

Result = tuple[Array, dict[str, Any]]

_LARGE = 500 * MILLIGAUSS


def _timing(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Apply a two-pole anti-alias filter; `size` is its delay at low frequencies."""
    return lagged(lagged(field, scene.step, size / 2), scene.step, size / 2), {}


def _temperature_gain(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Let the sensitivity of each axis change with temperature, 15 s behind the thermometer."""
    share = random.uniform(0.5, 1.0, 3) * random.choice([-1.0, 1.0], 3)
    warm = standardised(lagged(scene.environment.temperature, scene.step, 15.0))
    return field * (1 + size * warm[:, None] * share), {"share": share}


def _gain_drift(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Let the sensitivity of each axis change as the sensor warms up."""
    share = random.uniform(0.5, 1.0, 3) * random.choice([-1.0, 1.0], 3)
    duration = float(scene.time[-1] - scene.time[0])
    warm = standardised(-np.exp(-(scene.time - scene.time[0]) / (random.uniform(0.2, 1.0) * duration)))
    return field * (1 + size * warm[:, None] * share), {"share": share}


def _saturation(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Saturate the core softly, like a hyperbolic tangent, equally on all axes."""
    full = (1 - size) * float(np.abs(field).max())
    knee = 0.85 * full
    beyond = np.clip(np.abs(field) - knee, 0, None)
    soft = np.minimum(np.abs(field), knee) + (full - knee) * np.tanh(beyond / (full - knee))
    return np.sign(field) * soft, {"full_scale": full}


def _cubic(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add an odd response that is cubic for small fields and flattens."""
    share = random.uniform(0.5, 1.0, 3) * random.choice([-1.0, 1.0], 3)
    part = field / _LARGE
    return field + size * share * 1.2 * part**3 / (1 + 0.2 * part**2), {"share": share}


def _axis_delays(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Read the axes one after the other, in a random order, the last one later than the first by `size`."""
    late = size * random.permutation([0.0, 0.5, 1.0])
    read = [np.interp(scene.time - delay, scene.time, axis) for delay, axis in zip(late, field.T, strict=True)]
    return np.column_stack(read), {"delays": late}


def _clock_drift(field: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Let the magnetometer's clock be fast or slow, by `size` over the recording, and right halfway."""
    growth = size * float(random.choice([-1.0, 1.0]))
    late = growth * ((scene.time - scene.time[0]) / (scene.time[-1] - scene.time[0]) - 0.5)
    return np.column_stack([np.interp(scene.time - late, scene.time, axis) for axis in field.T]), {
        "growth": growth
    }


EFFECTS = {
    "timing": SimulatedEffect(Stage.ELECTRONICS, _timing),
    "temperature-gain": SimulatedEffect(Stage.ELECTRONICS, _temperature_gain, ("temperature",)),
    "gain-drift": SimulatedEffect(Stage.ELECTRONICS, _gain_drift),
    "axis-delays": SimulatedEffect(Stage.ELECTRONICS, _axis_delays),
    "clock-drift": SimulatedEffect(Stage.ELECTRONICS, _clock_drift),
    "saturation": SimulatedEffect(Stage.ELECTRONICS, _saturation),
    "cubic": SimulatedEffect(Stage.ELECTRONICS, _cubic),
}
