"""Effects that no catalogue has, for `magyc-gtsam study gap --foreign examples/foreign_effects.py`.

Each function takes the arrays of a recording, a factor on its strength and a random generator, and gives back the
arrays that it changes; see `magyc_gtsam.blindtest.from_outside`. What `gap` says of them should be "unknown".
"""

from __future__ import annotations

import numpy as np

Arrays = dict[str, np.ndarray]


def gain_with_temperature(arrays: Arrays, factor: float, random: np.random.Generator) -> Arrays:
    """Each axis of the magnetometer gains or loses sensitivity with temperature, 0.15 % per unit of it."""
    warm = arrays["channel temperature"] - arrays["channel temperature"].mean()
    share = 1.5e-3 * factor * random.choice([-1.0, 1.0], 3)
    return {"magnetic_field": arrays["magnetic_field"] * (1 + warm[:, None] * share)}


def late_in_fast_turns(arrays: Arrays, factor: float, random: np.random.Generator) -> Arrays:
    """The magnetometer lags by 60 ms in the faster half of the turns, and not at all in the slower."""
    time, field = arrays["time"], arrays["magnetic_field"]
    speed = np.linalg.norm(arrays["angular_rate"], axis=1)
    lag = 0.06 * factor * (speed > np.median(speed))
    return {"magnetic_field": np.stack([np.interp(time - lag, time, axis) for axis in field.T], axis=1)}


def gripper(arrays: Arrays, factor: float, random: np.random.Generator) -> Arrays:
    """A gripper's magnet, 2 µT, turns by itself once in 40 to 60 seconds."""
    turn = 2 * np.pi * arrays["time"] / random.uniform(40, 60)
    first, second = np.linalg.qr(random.standard_normal((3, 2)))[0].T
    turned = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return {"magnetic_field": arrays["magnetic_field"] + 2e-6 * factor * turned}


def bias_with_shaking(arrays: Arrays, factor: float, random: np.random.Generator) -> Arrays:
    """The gyroscope rectifies what shakes it: a bias with the square of the acceleration's change."""
    shaken = (np.gradient(arrays["acceleration"], axis=0) ** 2).sum(axis=1)
    way = random.standard_normal(3)
    size = 3e-3 * factor * shaken / max(float(shaken.std()), 1e-12)
    return {"angular_rate": arrays["angular_rate"] + size[:, None] * way / np.linalg.norm(way)}
