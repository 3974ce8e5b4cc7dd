"""Which rows of a recording carry a sample of a sensor, and which only repeat an earlier one."""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording.checks import Array, Mask

HELD_GYROSCOPE = 0.3  # share of exact repeats from which a gyroscope counts as sample-held
LONGEST_HOLD = 0.2  # s; a rate that repeats for longer is measured: the instrument is at rest


def row_mask(name: str, mask: Any, rows: int) -> Mask:
    """Return a read-only copy of a mask (rows,); every row where it is None. A mask of every row takes no memory.

    Raises:
        MagycError: another shape; the message starts with `name`.
    """
    every: Mask = np.broadcast_to(np.True_, rows)
    if mask is None:
        return every
    result = np.array(mask, dtype=bool)
    if result.shape != (rows,):
        raise MagycError(f"{name}: shape {result.shape}, expected ({rows},), one flag per row")
    if result.all():
        return every
    result.flags.writeable = False
    return result


def fresh_rows(time: Array, values: Array, held_share: float = 0.0, longest_hold: float = np.inf) -> Mask:
    """Return the mask (n,) of the rows that do not repeat the row before them exactly.

    Args:
        time: (n,) s.
        values: (n, 3) samples of the sensor.
        held_share: share of exact repeats up to which every row counts as a sample.
        longest_hold: s since the last fresh row, after which a repeat counts as a sample.
    """
    fresh = np.ones(len(time), dtype=bool)
    repeats = (values[1:] == values[:-1]).all(axis=1)
    if repeats.mean() > held_share:
        fresh[1:] = ~repeats
        last_fresh = np.maximum.accumulate(np.where(fresh, time, -np.inf))
        fresh |= time - last_fresh > longest_hold
    return fresh
