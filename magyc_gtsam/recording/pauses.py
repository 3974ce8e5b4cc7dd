"""Pauses of a channel: short ones are interpolated, in long ones its value is not known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.recording.checks import Array

# s, longest pause that is interpolated; or in spacings of the channel's own values, whichever is longer
LONGEST = 10.0
LONGEST_SPACINGS = 5.0


def known_at(time: Array, own: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) of the times at which a channel with values at its `own` times (k,) is known.

    It is not within a long pause, nor before its first and after its last value if these are as far from the ends.
    """
    have = np.isin(time, own)
    if len(own) < 2:
        return have
    spacing = np.diff(np.concatenate([time[:1], own, time[-1:]]))
    long = spacing > max(LONGEST, LONGEST_SPACINGS * float(np.median(np.diff(own))))
    known: NDArray[np.bool_] = have | ~long[np.searchsorted(own, time)]
    return known


def filled(time: Array, column: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return one column (n,) of a channel with its NaN interpolated, and the mask of `known_at`."""
    have = np.isfinite(column)
    if have.all() or not have.any():
        return column, have
    result: Array = np.interp(time, time[have], column[have])
    return result, known_at(time, time[have])


def spans(time: Array, known: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the first and last time of each run of rows that are not known."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~known, [False]]).astype(int)))
    return [(float(time[first]), float(time[end - 1])) for first, end in edges.reshape(-1, 2)]
