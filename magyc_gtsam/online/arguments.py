"""The arguments of `OnlineCalibrator`: one sample or a block, as arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import real_array
from magyc_gtsam.recording import Array


def scalar(name: str, value: ArrayLike) -> float:
    """Return one number.

    Raises:
        MagycError: the value is not a number.
    """
    try:
        return float(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: not a number ({error})") from None


def vector(name: str, value: ArrayLike | None) -> Array:
    """Return a copy (3,) of one sample, NaN for None."""
    if value is None:
        return np.full(3, np.nan)
    try:
        array = real_array(value, copy=True)
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: not an array of numbers ({error})") from None
    if array.shape != (3,):
        raise MagycError(f"{name}: shape {array.shape} for one stamp, expected (3,)")
    return array


def block(name: str, value: ArrayLike, vectors: int) -> Array:
    """Return an array (N,) or (N, 3) from one sample or a block."""
    try:
        array = real_array(value, copy=True)
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: not an array of numbers ({error})") from None
    if array.ndim == vectors:
        array = array[None]
    if array.ndim != vectors + 1 or (vectors and array.shape[1] != 3):
        raise MagycError(
            f"{name}: shape {array.shape}, expected {'(N, 3) or (3,)' if vectors else '(N,) or a number'}"
        )
    return array
