"""How far a vehicle turns between two times: without turns the hard iron and the field of the place look alike."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.model.twin import Twin


def turned(twin: Twin, start: Array, end: Array) -> Array:
    """Return the root mean square rotation (...), rad, of the vehicle from each start to each end (...), s.

    It is that of the world axis that moves most in the sensor, at most 1; 0 without a window in between.
    """
    first, last = (np.searchsorted(twin.time, each, side="right") for each in (start, end))
    total = np.pad(np.cumsum(twin.windows.need("to_sensor"), axis=2), ((0, 0), (0, 0), (1, 0)))
    mean = (total[..., last] - total[..., first]) / np.maximum(last - first, 1)
    result: Array = np.sqrt(np.maximum(1 - (mean**2).sum(axis=0), 0.0)).max(axis=0) * (last > first)
    return result
