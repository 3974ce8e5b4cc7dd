"""Screen a whole recording for faults before the detectors examine every sample.

Each test checks a necessary condition of a fault at a few comparisons per sample; most recordings fail them all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.sensor_faults import full_scale, largest_value, stuck
from magyc_gtsam.sensor_faults.spikes import has_spikes
from magyc_gtsam.sensor_faults.stuck_bit import stuck_bit


def may_be_faulty(recording: Recording, sensors: Sequence[str]) -> bool:
    """Return whether any of the detectors could find a fault in the named sensors' samples."""
    field = recording.magnetometer.value
    if (
        _repeats(recording)
        or _has_zeros(field)
        or any(_may_be_stuck(axis) or _may_be_cut_off(axis) for axis in _axes(field))
        or stuck_bit(field) is not None
    ):
        return True
    if recording.angular_rate is None or "angular_rate" not in sensors:
        return False
    rate = recording.gyroscope.value
    if _has_zeros(rate) or any(_may_be_stuck(axis) or _levels_off(axis) for axis in _axes(rate)):
        return True
    return has_spikes(rate)


def _axes(values: Array) -> Iterator[Array]:
    """Yield the columns of (n, 3) in turn, each copied into the same contiguous array."""
    axis = np.empty(len(values))
    for column in values.T:
        axis[:] = column
        yield axis


def _has_zeros(value: Array) -> bool:
    """Return whether a sample of (n, 3) is zero on all axes."""
    zero = value[:, 0] == 0
    return bool(zero.any()) and bool((zero & (value[:, 1] == 0) & (value[:, 2] == 0)).any())


def _repeats(recording: Recording) -> bool:
    """Return whether the magnetometer repeats one sample as often as a stuck one."""
    fresh = recording.magnetic_field_fresh
    if fresh.all():
        return False
    edges = np.concatenate([[-1], np.flatnonzero(fresh), [len(fresh)]])
    return bool(np.diff(edges).max() > stuck.LEAST_SAMPLES)


def _may_be_stuck(axis: Array) -> bool:
    """Return whether an axis (n,) may hold one value for as long as a stuck axis.

    Any such run contains at least one of the consecutive blocks of half its length.
    """
    half = stuck.LEAST_SAMPLES // 2
    blocks = axis[: len(axis) // half * half].reshape(-1, half)
    alike = blocks[:, 0] == blocks[:, -1]
    if not alike.any():
        return False
    blocks = blocks[alike]
    return bool((blocks == blocks[:, :1]).all(axis=1).any())


def _may_be_cut_off(axis: Array) -> bool:
    """Return whether an axis (n,) reads its own extreme as often as an axis that is cut off."""
    least = max(full_scale.LEAST, full_scale.MOST * len(axis))
    return any(np.count_nonzero(axis == value) > least for value in (axis.max(), axis.min()))


def _levels_off(axis: Array) -> bool:
    """Return whether an axis (n,) repeats its largest value so far consecutively and often, as when cut off."""
    return bool((axis[1:] == axis[:-1]).any()) and any(_repeats_largest(side) for side in (axis, -axis))


def _repeats_largest(side: Array) -> bool:
    largest = np.maximum.accumulate(side)
    again = side[1:] == largest[:-1]  # samples at the largest value so far
    if np.count_nonzero(again) < largest_value.LEAST - 1:
        return False
    often = np.unique(largest[1:][again], return_counts=True)[1]
    return bool(often.max() >= largest_value.LEAST - 1)
