"""Simulation of recordings with their truth, including effects beyond the sensor model.

The diagnosing code (`magyc_gtsam.gap`) must not import this package, which contains the truth it is tested against.
"""

from __future__ import annotations

from magyc_gtsam.simulation.injection import disturb, inject
from magyc_gtsam.simulation.motion import AMPLITUDES, MOTIONS, RATES
from magyc_gtsam.simulation.sensor import (
    FIELD,
    GYRO_BIAS,
    HARD_IRON,
    MILLIGAUSS,
    SOFT_IRON,
    Simulation,
    simulate,
)

__all__ = [
    "AMPLITUDES",
    "FIELD",
    "GYRO_BIAS",
    "HARD_IRON",
    "MILLIGAUSS",
    "MOTIONS",
    "RATES",
    "SOFT_IRON",
    "Simulation",
    "disturb",
    "inject",
    "simulate",
]
