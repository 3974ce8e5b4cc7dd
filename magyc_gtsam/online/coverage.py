"""Measure how much of the sphere of field directions the sensor has seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.recording import Array, Mask

BANDS, SECTORS = 6, 10  # cells of equal area: bands from −z to +z, sectors about z from −x on
_MOST = 2000  # directions that are evaluated


def coverage(calibration: Calibration, field: Array) -> float:
    """Return the share of 60 equal cells that the directions of the calibrated `field` (n, 3) visited."""
    direction = calibration.apply(field[:: max(len(field) // _MOST, 1)])
    direction /= np.maximum(np.linalg.norm(direction, axis=1), 1e-300)[:, None]
    return float(cells(direction).mean())


def cells(direction: Array) -> Mask:
    """Return (60,) whether unit vectors (n, 3) visited each cell; the cells are ordered by band."""
    return np.bincount(cell_of(direction), minlength=BANDS * SECTORS) > 0


def cell_of(direction: Array) -> NDArray[np.intp]:
    """Return the cells (n,) of unit vectors (n, 3)."""
    band = np.clip((BANDS / 2 * (direction[:, 2] + 1)).astype(np.intp), 0, BANDS - 1)
    turn = np.arctan2(direction[:, 1], direction[:, 0]) / (2 * np.pi) + 0.5
    cell: NDArray[np.intp] = SECTORS * band + (turn * SECTORS).astype(np.intp) % SECTORS
    return cell
