"""Time stamps in seconds: calendar stamps converted (numpy, pandas, datetime), counts of another unit refused."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError

_LONGEST_STEP = 5.0  # s, median; larger steps are counts of another unit
_FEW = 10  # rows, of which nothing can be said
_NANOSECONDS = "datetime64[ns]"


def seconds(name: str, time: Any, origin: int = 0) -> Any:
    """Calendar stamps (numpy, pandas, datetime) and durations as float64 s; anything else as it is.

    Args:
        name: for error messages.
        time: (N,) stamps.
        origin: ns since 1970 that becomes 0 s; see `origin_of`.

    Raises:
        MagycError: a stamp is missing (NaT).
    """
    stamps = _nanoseconds(time)
    if stamps is None:
        return time
    if (missing := stamps == np.iinfo(np.int64).min).any():
        raise MagycError(
            f"{name}: {missing.sum()} of {len(stamps)} stamps are missing (NaT), the first is row "
            f"{int(np.argmax(missing))}; remove those rows"
        )
    return (stamps - origin) / 1e9


def origin_of(time: Any) -> int:
    """ns since 1970 of the first calendar stamp; 0 for durations and numbers, which count from where they count."""
    array = time if isinstance(time, np.ndarray) else getattr(time, "to_numpy", lambda: np.asarray(time))()
    stamps = _nanoseconds(time)
    return 0 if stamps is None or not len(stamps) or array.dtype.kind == "m" else int(stamps[0])


def _nanoseconds(time: Any) -> NDArray[np.int64] | None:
    if isinstance(time, list | tuple) and not (len(time) and isinstance(time[0], datetime | np.datetime64)):
        return None
    array = np.asarray(time)
    if array.dtype == object and array.ndim == 1 and len(array) and isinstance(array[0], datetime):
        # With a zone (pandas' too), numpy would leave the zone out.
        array = np.array([np.datetime64(int(_since_1970(t)), "ns") for t in array])
    if array.dtype.kind == "M":
        return array.astype(_NANOSECONDS).astype(np.int64)
    if array.dtype.kind == "m":
        return array.astype("timedelta64[ns]").astype(np.int64)
    return None


def _since_1970(moment: Any) -> int:
    """ns; pandas' stamps know their nanoseconds, Python's their microseconds."""
    if hasattr(moment, "value"):
        return int(moment.value)
    zone = moment.utcoffset()
    plain = np.datetime64(moment.replace(tzinfo=None), "us").astype(np.int64)
    return int(plain) * 1000 - (round(zone.total_seconds() * 1e9) if zone else 0)


def check_seconds(name: str, time: NDArray[np.float64]) -> None:
    """Refuse numbers that count something else than seconds.

    Raises:
        MagycError: the median step is larger than 5 s; the likely unit is named.
    """
    step = float(np.median(np.diff(time), overwrite_input=True)) if len(time) >= _FEW else 0.0
    if step > _LONGEST_STEP:
        units = (("ms", 1e3), ("µs", 1e6), ("ns", 1e9))
        likely, per_second = next(((u, s) for u, s in units if step / s <= _LONGEST_STEP), units[-1])
        raise MagycError(
            f"{name}: steps by {step:g} from row to row, which is no sensor's in seconds; likely unit: {likely}; "
            f"divide by {per_second:g}, or pass datetime64"
        )
