"""Arrays of real numbers from what a caller gives, without losing what numpy drops silently."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


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


def is_finite(value: Any) -> bool:
    """Return whether `value` is one finite real number, and no bool or text."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and bool(np.isfinite(value))


def is_positive(value: Any) -> bool:
    """Return whether `value` is one finite real number above 0."""
    return is_finite(value) and value > 0
