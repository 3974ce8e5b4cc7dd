"""How much of the sphere of field directions the sensor has seen."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.recording import Array

_BANDS, _SECTORS = 6, 10  # cells of equal area
_MOST = 2000  # directions that are enough


def coverage(calibration: Calibration, field: Array) -> float:
    """Share of 60 equal cells that the directions of the calibrated field, of `field` (n, 3), visited."""
    direction = calibration.apply(field[:: max(len(field) // _MOST, 1)])
    direction /= np.maximum(np.linalg.norm(direction, axis=1), 1e-300)[:, None]
    band = np.minimum((_BANDS / 2 * (direction[:, 2] + 1)).astype(int), _BANDS - 1)
    turn = np.arctan2(direction[:, 1], direction[:, 0]) / (2 * np.pi) + 0.5
    return len(np.unique(_SECTORS * band + (turn * _SECTORS).astype(int) % _SECTORS)) / (_BANDS * _SECTORS)
