"""Rests of a recording: the seconds in which the means of its sensors hardly change."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.recording import Recording

_SECONDS = 3  # of a rest


def rate_at_rest(recording: Recording) -> Array | None:
    """Return the gyroscope's mean (3,), rad/s, over the rests; None without one."""
    if recording.angular_rate is None:
        return None
    (second, _, rate), (_, _, field) = (  # of all rows: those of a rest that are not samples repeat one
        by_second(recording.time, rows, recording.time[0])
        for rows in (recording.angular_rate, recording.magnetic_field)
    )
    if len(second) < _SECONDS:
        return None
    calm = second[_SECONDS - 1 :] - second[: 1 - _SECONDS] == _SECONDS - 1
    for mean in (rate, field):
        near = np.lib.stride_tricks.sliding_window_view(mean, _SECONDS, axis=0)
        calm &= np.ptp(near, axis=2).max(axis=1) < RULES.rest_same * spread(mean)
    return np.asarray(np.median(rate[: 1 - _SECONDS][calm], axis=0)) if calm.any() else None


def by_second(time: Array, values: Array, begin: float) -> tuple[np.ndarray, np.ndarray, Array]:
    """Return the seconds (k,) from `begin` with samples, their first samples (k,), and the means (k, 3) of values."""
    second = np.floor((time - begin) / RULES.window).astype(int)
    number, first, count = np.unique(second, return_index=True, return_counts=True)
    return number, first, np.add.reduceat(values, first, axis=0) / count[:, None]


def spread(values: Array) -> float:
    """Return the root mean square distance of values (n, 3) from their mean."""
    return float(np.sqrt(values.var(axis=0).sum()))
