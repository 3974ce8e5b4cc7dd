"""The graph of the studies of calibration inside SLAM: units, blocks of samples, and where the calibration starts."""

import sys
from pathlib import Path

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, H

from magyc_gtsam.factors import KeyframeField

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from vehicle import Vehicle

NO_IRON = np.array([1.0, 0, 0, 1, 0, 1])
UNIT = 50e-6  # T per unit of the hard iron
SIGMA = 1e-6  # T, magnetometer
ISOTROPIC = gtsam.noiseModel.Isotropic.Sigma


def block(vehicle: Vehicle, k: int, keyframes: int, step: int, bias: np.ndarray) -> KeyframeField:
    """The samples of the last `keyframes` keyframes up to k, every `step`-th of the magnetometer's."""
    rows = slice((k - keyframes) * vehicle.every, k * vehicle.every + 1)
    time_, rate, field = (getattr(vehicle.recording, n)[rows] for n in ("time", "angular_rate", "magnetic_field"))
    magnetometer = (time_[1:][::step], field[1:][::step])
    return KeyframeField.from_samples(magnetometer, (time_, rate), time_[-1], bias=bias)


def calibration_start(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, free: str = "Ah") -> None:
    """Vague priors on soft and hard iron, tight ones where they are not free."""
    graph.addPriorVector(A(0), NO_IRON, ISOTROPIC(6, 0.3 if "A" in free else 1e-4))
    graph.addPriorPoint3(H(0), np.zeros(3), ISOTROPIC(3, 1.0 if "h" in free else 1e-4))
    values.insert(A(0), NO_IRON)
    values.insert(H(0), np.zeros(3))
