"""Arrays of real numbers from what a caller gives, without losing what numpy drops silently."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError


def real_array(value: Any, copy: bool = False) -> NDArray[np.float64]:
    """Return `value` as float64 in C order; NaN where a masked array is masked.

    Args:
        value: array, list, table or number.
        copy: whether the result must not share memory with `value`.

    Raises:
        TypeError, ValueError: it is complex, or holds other things than numbers.
    """
    if getattr(getattr(value, "dtype", None), "kind", "") == "c":
        raise TypeError("complex, and numpy would drop the imaginary part")
    if isinstance(value, np.ma.MaskedArray):
        return np.ascontiguousarray(np.ma.filled(value.astype(np.float64), np.nan))
    return np.array(value, dtype=np.float64, order="C", copy=copy or None)


def numbers(name: str, value: Any) -> NDArray[np.float64]:
    """Return `value` as a new float64 array; unlike `real_array` without text and booleans that look like numbers.

    Raises:
        MagycError: it holds anything but numbers.
    """
    try:
        if np.asarray(value).dtype.kind not in "iuf" or _holds_booleans(value):
            raise TypeError
        return real_array(value, copy=True)
    except (TypeError, ValueError, OverflowError):
        raise MagycError(f"{name} must be numbers, got {reprlib.repr(value)}") from None


def _holds_booleans(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_holds_booleans, value))
    return isinstance(value, bool | np.bool_)


def is_finite(value: Any) -> bool:
    """Return whether `value` is one finite real number, and no bool or text."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and bool(np.isfinite(value))


def is_positive(value: Any) -> bool:
    """Return whether `value` is one finite real number above 0."""
    return is_finite(value) and value > 0
