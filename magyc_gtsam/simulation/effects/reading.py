"""Effects of sampling, bus and logger on the magnetometer's readings, and exchanged axes of the gyroscope."""

from __future__ import annotations

from itertools import permutations, product
from typing import Any

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.scene import Scene, SimulatedEffect, Stage, direction

Result = tuple[Array, dict[str, Any]]


def _coloured(reading: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add AR(2) noise: a damped resonance at 0.05 to 0.2 Hz, as of a swinging mount."""
    from scipy.signal import lfilter

    step = float(np.median(np.diff(scene.row_time)))
    frequency, decay = random.uniform(0.05, 0.2), random.uniform(1.5, 4.0)
    radius = np.exp(-step / decay)
    poles = [1.0, -2 * radius * np.cos(2 * np.pi * frequency * step), radius**2]
    settling = int(10 * decay / step)
    noise = lfilter([1.0], poles, random.standard_normal((len(reading) + settling, 3)), axis=0)[settling:]
    return reading + size * noise / noise.std(), {"frequency": frequency, "decay": decay}


def _spikes(reading: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add a spike in a random direction to one sample in a hundred; after three in ten of them also to the next
    sample.
    """
    hit = random.random(len(reading)) < 0.0077
    hit[1:] |= hit[:-1] & (random.random(len(reading) - 1) < 0.3)
    height = size * random.gamma(4.0, 0.25, len(reading)) * hit
    way = random.standard_normal(reading.shape)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return reading + height[:, None] * way, {"samples": int(hit.sum())}


def _tone(reading: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Add aliased mains hum: an ellipse at a frequency that wanders like that of the grid."""
    step = float(np.median(np.diff(scene.row_time)))
    frequency = random.uniform(0.08, 0.42) / step
    phase = 2 * np.pi * frequency * (scene.row_time - scene.row_time[0])
    phase += np.cumsum(random.standard_normal(len(reading))) * np.sqrt(step) * 0.02
    major, minor = direction(random), 0.4 * direction(random)
    return reading + size * (np.cos(phase)[:, None] * major + np.sin(phase)[:, None] * minor), {
        "frequency": frequency
    }


def _quantised(reading: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Round to counts, with an origin that is not exactly zero."""
    origin = random.uniform(-0.5, 0.5, 3) * size
    return np.round((reading - origin) / size) * size + origin, {}


def _held(shown: np.ndarray, scene: Scene, size: float, random: np.random.Generator) -> tuple[np.ndarray, dict]:
    """Let the magnetometer measure every 1 + size log periods on its own clock; rows repeat the last value."""
    step = float(np.median(np.diff(scene.row_time)))
    own = (1 + size) * step
    start = scene.row_time[0] - random.uniform(0, own)
    tick = start + np.floor((scene.row_time - start) / own) * own
    measured = np.maximum(np.searchsorted(scene.time, tick + 0.5 * scene.step, side="right") - 1, 0)
    return np.minimum(measured, shown), {"period": own}


def _axes(angular_rate: Array, scene: Scene, size: float, random: np.random.Generator) -> Result:
    """Permute and reverse the gyroscope's axes by one of the 47 signed permutations other than the identity."""
    choices = [(order, sign) for order in permutations(range(3)) for sign in product((1.0, -1.0), repeat=3)][1:]
    order, sign = choices[int(random.integers(len(choices)))]
    return angular_rate[:, list(order)] * sign, {"order": list(order), "sign": list(sign)}


EFFECTS = {
    "coloured-noise": SimulatedEffect(Stage.READING, _coloured),
    "spikes": SimulatedEffect(Stage.READING, _spikes),
    "tone": SimulatedEffect(Stage.READING, _tone),
    "quantisation": SimulatedEffect(Stage.QUANTISED, _quantised),
    "sample-hold": SimulatedEffect(Stage.SAMPLING, _held),
    "axis-order": SimulatedEffect(Stage.AXES, _axes),
}
