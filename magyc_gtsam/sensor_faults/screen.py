"""What a fault needs to be there at all, asked of a whole recording before its detectors look at every sample.

Most recordings have none of it; each question costs a few comparisons a sample or less.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.sensor_faults import cut_off, full_scale, stuck


def may_be_faulty(recording: Recording, sensors: Sequence[str]) -> bool:
    """Whether any of the detectors could find something in the named sensors' samples."""
    field = np.ascontiguousarray(recording.magnetometer.value.T)
    if _repeats(recording) or _has_zeros(field) or _stands(field) or _gathers(field):
        return True
    if recording.angular_rate is None or "angular_rate" not in sensors:
        return False
    rate = np.ascontiguousarray(recording.gyroscope.value.T)
    return _stands(rate) or _levels_off(rate)


def _has_zeros(field: Array) -> bool:
    """Whether a sample of (3, n) is zero on all axes."""
    zero = field[0] == 0
    return bool(zero.any()) and bool((zero & (field[1] == 0) & (field[2] == 0)).any())


def _repeats(recording: Recording) -> bool:
    """Whether the magnetometer repeats one sample as often as one that stands still."""
    fresh = recording.magnetic_field_fresh
    if fresh.all():
        return False
    edges = np.concatenate([[-1], np.flatnonzero(fresh), [len(fresh)]])
    return bool(np.diff(edges).max() > stuck.LEAST_SAMPLES)


def _stands(values: Array) -> bool:
    """Whether an axis of (3, n) may have one value as often in a row as one that stands still.

    Such a run holds one of the blocks of half its length, laid end to end.
    """
    half = stuck.LEAST_SAMPLES // 2
    blocks = values[:, : values.shape[1] // half * half].reshape(-1, half)
    blocks = blocks[blocks[:, 0] == blocks[:, -1]]
    return bool((blocks == blocks[:, :1]).all(axis=1).any())


def _gathers(field: Array) -> bool:
    """Whether an axis of (3, n) reads its own extreme as often as one that is cut off."""
    least = max(full_scale.LEAST, full_scale.MOST * field.shape[1])
    return any(np.count_nonzero(row == value) > least for row in field for value in (row.max(), row.min()))


def _levels_off(rate: Array) -> bool:
    """Whether an axis of (3, n) repeats its largest value so far as one that is cut off does: at once, and often."""
    repeating = rate[(rate[:, 1:] == rate[:, :-1]).any(axis=1)]
    return any(_repeats_its_largest(side) for row in repeating for side in (row, -row))


def _repeats_its_largest(side: Array) -> bool:
    largest = np.maximum.accumulate(side)
    again = side[1:] == largest[:-1]  # samples at the level that was there before
    if np.count_nonzero(again) < cut_off.LEAST - 1:
        return False
    often = np.unique(largest[1:][again], return_counts=True)[1]
    return bool(often.max() >= cut_off.LEAST - 1)
