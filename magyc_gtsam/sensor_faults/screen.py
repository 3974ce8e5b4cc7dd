"""What a fault needs to be there at all, asked of a whole recording before its detectors look at every sample.

Most recordings have none of it; each question costs a few comparisons a sample or less.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.sensor_faults import full_scale, largest_value, stuck


def may_be_faulty(recording: Recording, sensors: Sequence[str]) -> bool:
    """Whether any of the detectors could find something in the named sensors' samples."""
    field = recording.magnetometer.value
    if _repeats(recording) or _has_zeros(field) or any(_stands(axis) or _gathers(axis) for axis in _axes(field)):
        return True
    if recording.angular_rate is None or "angular_rate" not in sensors:
        return False
    return any(_stands(axis) or _levels_off(axis) for axis in _axes(recording.gyroscope.value))


def _axes(values: Array) -> Iterator[Array]:
    """The columns of (n, 3) one after the other, each contiguous, in the place of the one before."""
    axis = np.empty(len(values))
    for column in values.T:
        axis[:] = column
        yield axis


def _has_zeros(field: Array) -> bool:
    """Whether a sample of (n, 3) is zero on all axes."""
    zero = field[:, 0] == 0
    return bool(zero.any()) and bool((zero & (field[:, 1] == 0) & (field[:, 2] == 0)).any())


def _repeats(recording: Recording) -> bool:
    """Whether the magnetometer repeats one sample as often as one that stands still."""
    fresh = recording.magnetic_field_fresh
    if fresh.all():
        return False
    edges = np.concatenate([[-1], np.flatnonzero(fresh), [len(fresh)]])
    return bool(np.diff(edges).max() > stuck.LEAST_SAMPLES)


def _stands(axis: Array) -> bool:
    """Whether an axis (n,) may have one value as often in a row as one that stands still.

    Such a run holds one of the blocks of half its length, laid end to end.
    """
    half = stuck.LEAST_SAMPLES // 2
    blocks = axis[: len(axis) // half * half].reshape(-1, half)
    blocks = blocks[blocks[:, 0] == blocks[:, -1]]
    return bool((blocks == blocks[:, :1]).all(axis=1).any())


def _gathers(axis: Array) -> bool:
    """Whether an axis (n,) reads its own extreme as often as one that is cut off."""
    least = max(full_scale.LEAST, full_scale.MOST * len(axis))
    return any(np.count_nonzero(axis == value) > least for value in (axis.max(), axis.min()))


def _levels_off(axis: Array) -> bool:
    """Whether an axis (n,) repeats its largest value so far as one that is cut off does: at once, and often."""
    return bool((axis[1:] == axis[:-1]).any()) and any(_repeats_its_largest(side) for side in (axis, -axis))


def _repeats_its_largest(side: Array) -> bool:
    largest = np.maximum.accumulate(side)
    again = side[1:] == largest[:-1]  # samples at the level that was there before
    if np.count_nonzero(again) < largest_value.LEAST - 1:
        return False
    often = np.unique(largest[1:][again], return_counts=True)[1]
    return bool(often.max() >= largest_value.LEAST - 1)
