"""Screen a whole recording for faults before the detectors examine every sample.

Each test checks a necessary condition of a fault at a few comparisons per sample; most recordings fail them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.recording import Array, Recording, Samples
from magyc_gtsam.sensor_faults import full_scale, largest_value, stuck
from magyc_gtsam.sensor_faults.cut_off import ROUNDING
from magyc_gtsam.sensor_faults.single_samples import has_placeholders
from magyc_gtsam.sensor_faults.spikes import has_spikes
from magyc_gtsam.sensor_faults.stuck_bit import stuck_bit


def may_be_faulty(recording: Recording, sensors: Sequence[str]) -> bool:
    """Return whether any of the detectors could find a fault in the named sensors' samples."""
    field = recording.magnetometer.value
    turns = recording.angular_rate is not None and "angular_rate" in sensors
    if _repeats(recording) or _field_stands_out(field) or (turns and _rate_stands_out(recording.gyroscope)):
        return True
    # Last, since these are the detector's own tests.
    return stuck_bit(field) is not None or (turns and stuck_bit(recording.gyroscope.value) is not None)


def _field_stands_out(field: Array) -> bool:
    seen = _seen(field)
    return seen.zeros or seen.stuck or seen.at_extreme > max(full_scale.LEAST, full_scale.MOST * len(field))


def _rate_stands_out(gyroscope: Samples) -> bool:
    rate = gyroscope.value
    seen = _seen(rate)
    cut_off = seen.again and _levels_off(rate)
    return seen.stuck or cut_off or has_spikes(rate) or (seen.zeros and has_placeholders(gyroscope))


class _Seen(NamedTuple):
    """What the samples (n, 3) of a sensor have that faults have, too.

    zeros: a sample that is zero on all axes; stuck: an axis that may hold one value for as long as a stuck axis; again:
    an axis that repeats the value before; at_extreme: most samples of an axis at its largest or at its smallest value.
    """

    zeros: bool
    stuck: bool
    again: bool
    at_extreme: int


def _seen(value: Array) -> _Seen:
    """Look at samples (n, 3).

    Any run of a stuck axis contains at least one of the consecutive blocks of half its length.
    """
    half = stuck.LEAST_SAMPLES // 2
    if compiled.loops:
        found = np.empty(4)
        compiled.loops.look(half, compiled.given(value), found)
        return _Seen(bool(found[0]), bool(found[1]), bool(found[2]), int(found[3]))
    same = value[1:] == value[:-1]
    whole = value[: len(value) // half * half].reshape(-1, half, value.shape[1])
    held = (whole == whole[:, :1]).all(axis=1)
    most = max(
        np.count_nonzero(value == extreme, axis=0).max() for extreme in (value.max(axis=0), value.min(axis=0))
    )
    return _Seen(bool((value == 0).all(axis=1).any()), bool(held.any()), bool(same.any()), int(most))


def _repeats(recording: Recording) -> bool:
    """Return whether the magnetometer repeats one sample as often as a stuck one."""
    fresh = recording.magnetic_field_fresh
    if fresh.all():
        return False
    edges = np.concatenate([[-1], np.flatnonzero(fresh), [len(fresh)]])
    return bool(np.diff(edges).max() > stuck.LEAST_SAMPLES)


def _levels_off(rate: Array) -> bool:
    """Return whether an axis of rates (n, 3) repeats its largest value so far at once and often, as when cut off."""
    change = np.abs(np.diff(rate, axis=0))
    least = largest_value.LEAST_STEPS * float(change.min(where=change > ROUNDING, initial=np.inf))
    again = (change == 0).any(axis=0)
    return any(_repeats_largest(side, least) for axis in rate.T[again] for side in (axis, -axis))


def _repeats_largest(side: Array, least: float) -> bool:
    largest = np.maximum.accumulate(side)
    again = (side[1:] == largest[:-1]) & (side[1:] >= least)  # samples at the largest value so far
    if np.count_nonzero(again) < largest_value.LEAST - 1:
        return False
    often = np.unique(largest[1:][again], return_counts=True)[1]
    return bool(often.max() >= largest_value.LEAST - 1)
