"""Time stamps in seconds: conversion of calendar stamps (numpy, pandas, datetime), and a check of the unit."""

from __future__ import annotations

from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_finite

_LONGEST_STEP = 5.0  # s, median; larger steps are counts of another unit
_SHORTEST_HOLE = (0.5, 10)  # s, and median steps: a hole is longer than both
_FEWEST_ROWS = 10  # below this the median step is not judged
_NANOSECONDS = "datetime64[ns]"


class Hole(NamedTuple):
    """A hole in the time stamps: the last stamp before it in s, and its duration in s."""

    start: float
    duration: float


def holes(time: NDArray[np.float64]) -> tuple[Hole, ...]:
    """Return the holes in time stamps (n,) s: steps longer than 10 median steps and 0.5 s."""
    shortest, median_steps = _SHORTEST_HOLE
    step = np.diff(time)
    long = np.flatnonzero(step > shortest)
    if len(long):
        long = long[step[long] > median_steps * float(np.median(step))]
    return tuple(Hole(float(time[i]), float(step[i])) for i in long)


def seconds(name: str, time: Any, origin: int = 0) -> Any:
    """Return calendar stamps (numpy, pandas, datetime) or durations as float64 s; any other value unchanged.

    Args:
        name: name of the argument, for messages.
        time: (N,) stamps.
        origin: the stamp, in ns since 1970, that becomes 0 s; see `origin_of`.

    Raises:
        MagycError: a stamp is missing (NaT).
    """
    stamps = _nanoseconds(time)
    if stamps is None:
        return time
    if (missing := stamps == np.iinfo(np.int64).min).any():
        raise MagycError(
            f"{name}: {missing.sum()} of {stamps.size} stamps are missing (NaT), the first is row "
            f"{int(np.argmax(missing))}; remove those rows"
        )
    return (stamps - origin) / 1e9


def moment(name: str, time: Any) -> float:
    """Return one stamp in s: a number, or a calendar stamp (numpy, pandas, datetime), which becomes s since 1970.

    Args:
        name: name of the argument, for messages.
        time: the stamp.

    Raises:
        MagycError: it is neither, not finite, or missing (NaT).
    """
    value = time
    if isinstance(time, np.datetime64 | datetime):
        value = float(np.atleast_1d(seconds(name, [time]))[0])
    if not is_finite(value):
        raise MagycError(f"{name}: a number of s since 1970, or a date, is needed, got {time!r:.60}")
    return float(value)


def origin_of(time: Any) -> int:
    """Return the first calendar stamp in ns since 1970; 0 for durations and numbers, which have their own origin."""
    stamps = _nanoseconds(time)
    return int(stamps.flat[0]) if stamps is not None and stamps.size and is_calendar(time) else 0


def is_calendar(time: Any) -> bool:
    """Return whether stamps are dates, of numpy, pandas or datetime, and no durations or numbers."""
    if _nanoseconds(time) is None:
        return False
    array = time if isinstance(time, np.ndarray) else getattr(time, "to_numpy", lambda: np.asarray(time))()
    return bool(array.dtype.kind != "m")


def _nanoseconds(time: Any) -> NDArray[np.int64] | None:
    if isinstance(time, list | tuple) and not (len(time) and isinstance(time[0], datetime | np.datetime64)):
        return None
    array = np.asarray(time)
    if array.dtype == object and array.ndim < 2 and array.size and isinstance(array.flat[0], datetime):
        # numpy ignores the time zone of such objects.
        array = np.array([np.datetime64(int(_since_1970(t)), "ns") for t in array.flat]).reshape(array.shape)
    if array.dtype.kind == "M":
        return array.astype(_NANOSECONDS).astype(np.int64)
    if array.dtype.kind == "m":
        return array.astype("timedelta64[ns]").astype(np.int64)
    return None


def _since_1970(moment: Any) -> int:
    """Return a datetime or pandas stamp in ns since 1970."""
    if hasattr(moment, "value"):
        return int(moment.value)
    zone = moment.utcoffset()
    plain = np.datetime64(moment.replace(tzinfo=None), "us").astype(np.int64)
    return int(plain) * 1000 - (round(zone.total_seconds() * 1e9) if zone else 0)


def check_seconds(name: str, time: NDArray[np.float64]) -> None:
    """Check that time stamps (n,) can be in seconds.

    Raises:
        MagycError: the median step is larger than 5 s; the message names the likely unit.
    """
    step = float(np.median(np.diff(time), overwrite_input=True)) if len(time) >= _FEWEST_ROWS else 0.0
    if step > _LONGEST_STEP:
        units = (("ms", 1e3), ("µs", 1e6), ("ns", 1e9))
        likely, per_second = next(((u, s) for u, s in units if step / s <= _LONGEST_STEP), units[-1])
        raise MagycError(
            f"{name}: the median step must be at most {_LONGEST_STEP:g} s, got {step:g}; likely unit: {likely}; "
            f"divide by {per_second:g}, or pass datetime64"
        )
