"""Masks of the rows of a recording that carry a new sample of a sensor, rather than repeat an earlier one."""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording.checks import Array, Mask
from magyc_gtsam.recording.repeats import due, repeats_so_far, repetition

HELD_GYROSCOPE = 0.3  # share of exact repeats from which a gyroscope may be held
LONGEST_HOLD = 0.2  # s; a rate that repeats for longer is measured: the instrument is at rest


def row_mask(name: str, mask: Any, rows: int) -> Mask:
    """Return a read-only copy of a mask (rows,); every row where it is None. A mask of every row takes no memory.

    Raises:
        MagycError: another shape; the message starts with `name`.
    """
    every: Mask = np.broadcast_to(np.True_, rows)
    if mask is None:
        return every
    result = np.array(mask)
    if result.dtype != bool and not np.isin(result, (0, 1)).all():
        raise MagycError(f"{name}: one flag per row is needed, got {result.dtype} values other than 0 and 1")
    result = result.astype(bool)
    if result.shape != (rows,):
        raise MagycError(f"{name}: shape {result.shape}, expected ({rows},), one flag per row")
    if result.all():
        return every
    result.flags.writeable = False
    return result


def fresh_rows(values: Array) -> Mask:
    """Return the mask (n,) of the rows (n, 3) that do not repeat the row before them exactly."""
    fresh = np.ones(len(values), dtype=bool)
    fresh[1:] = (values[1:] != values[:-1]).any(axis=1)
    return fresh


def fresh_rates(time: Array, rate: Array) -> Mask:
    """Return the mask (n,) of the rows (n, 3) that are samples of a gyroscope; every row unless it is held.

    Samples in coarse steps may equal the one before: of these the share that is held tells which rows are samples.
    """
    repeats = rate[1:] == rate[:-1]
    fresh = np.append(True, ~repeats.all(axis=1))
    if 1 - fresh[1:].mean() <= HELD_GYROSCOPE:
        return np.ones(len(time), dtype=bool)
    last_fresh = np.maximum.accumulate(np.where(fresh, time, -np.inf))
    result: Mask = due(repeats_so_far(fresh), repetition(time, repeats).rows) | (time - last_fresh > LONGEST_HOLD)
    return result


def sample_masks(
    time: Array,
    magnetic_field: Array,
    angular_rate: Array | None,
    field_fresh: Any = None,
    rate_fresh: Any = None,
    field_stamped: Any = None,
) -> dict[str, Mask]:
    """Check the masks of a recording that are given, and derive the others from the data.

    Args:
        time: (n,) s.
        magnetic_field, angular_rate: (n, 3) samples.
        field_fresh, rate_fresh, field_stamped: (n,) as in `Recording`, or None.

    Returns:
        `magnetic_field_fresh`, `angular_rate_fresh` and `magnetic_field_stamped`.

    Raises:
        MagycError: a mask of another shape, a fresh row that is not stamped, fewer than 3 fresh rows.
    """
    if field_stamped is None:
        field_stamped = field_fresh
    if field_fresh is None:
        field_fresh = fresh_rows(magnetic_field)
    if rate_fresh is None and angular_rate is not None:
        rate_fresh = fresh_rates(time, angular_rate)
    given = {
        "magnetic_field_fresh": field_fresh,
        "angular_rate_fresh": rate_fresh,
        "magnetic_field_stamped": field_stamped,
    }
    masks = {name: row_mask(name, mask, len(time)) for name, mask in given.items()}
    fresh = masks["magnetic_field_fresh"]
    not_stamped = fresh & ~masks["magnetic_field_stamped"]
    if not_stamped.any():
        raise MagycError(
            f"magnetic_field_stamped: row {int(np.argmax(not_stamped))} is fresh in magnetic_field_fresh and must "
            "be stamped too"
        )
    if fresh.sum() < 3:
        raise MagycError(
            "magnetic_field: fewer than 3 different samples, all others repeat the row before; "
            "the sensor is stuck or the wrong column was read"
        )
    return masks
