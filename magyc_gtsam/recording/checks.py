"""Checks of the arrays of a `Recording`: shape, finiteness, order of time, units, placeholders."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import real_array

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EARTH_FIELD = (20e-6, 70e-6)  # T, the range of the Earth's field at its surface
_FIELD_LIMITS = (2e-6, 3e-3)  # T, median norm; a hard iron of forty times the field still passes
MAGNETOMETER_ALONE = "calibrate the magnetometer alone (`mg.calibrate` with method='autocal')"  # a remedy
NO_GYROSCOPE = "no gyroscope"  # begins the note of a reader that found none, and where it looked
FIELD_RANGE = 0.01  # T, twice the range of the widest common magnetometers
_RATE_LIMIT = 70.0  # rad/s, twice the range of the fastest common gyroscopes (2000 deg/s)
_FEW = 0.01  # share of the rows that may be damaged; more are of another unit
_PLACEHOLDERS = (999, 9999, 99999, 999999, 2**15 - 1, 2**15, 2**16 - 1)  # commonly written for "no value"
_LARGEST = 1e12  # largest value of any channel: 100 A are 1e11 nA
# A placeholder lies this many times farther from the median than any other sample.
_PLACEHOLDER_FACTOR = 10
# Any number this many times farther from the median than the others is an outlier: a 14-bit converter resolves less.
_OUTLIER_FACTOR = 1e4
_OUTLIER_SHARE = 0.05  # largest share of outliers; above it the channel has two levels
# Smallest number of distinct distances among the other samples: a constant channel may be switched on once.
_LEVELS = 3
_FIELD_UNITS = {"µT": 1e-6, "gauss": 1e-4, "milligauss": 1e-7, "nT": 1e-9, "mT": 1e-3}


def frozen(name: str, value: ArrayLike, shape: tuple[Any, ...], nan: bool = False) -> Array:
    """Return a read-only float64 copy of `value`, or `value` itself if it comes from `given_away`.

    Args:
        name: name of the argument, for messages.
        value: the array.
        shape: expected shape; None stands for any length, a final `...` for an optional second dimension.
        nan: whether values that are not finite are allowed.

    Raises:
        MagycError: not numeric, of another shape, or not finite.
    """
    try:
        array = value if _given_away(value) else real_array(value, copy=True)
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: not an array of numbers ({error})") from None
    expected = tuple(s for s in shape if s is not ...)
    may_have_columns = len(expected) < len(shape)
    dimensions_match = array.ndim == len(expected) or (may_have_columns and array.ndim == len(expected) + 1)
    if not dimensions_match or any(e is not None and e != s for e, s in zip(expected, array.shape, strict=False)):
        text = ", ".join("N" if s is None else "k" if s is ... else str(s) for s in shape)
        turned = " (transpose it?)" if array.ndim == 2 and array.shape[::-1] == expected else ""
        columns = columns_of(value)
        pick = f"; it is a table with the columns {columns}: name those of this argument" if columns else ""
        raise MagycError(f"{name}: shape {array.shape}, expected ({text}){turned}{pick}")
    bad = ~np.isfinite(array)
    if not nan and bad.any():
        row = int(np.argwhere(bad)[0][0])
        raise MagycError(
            f"{name}: {bad.reshape(len(array), -1).any(axis=1).sum()} of {len(array)} rows are not finite, "
            f"the first is row {row}; remove those rows (each sensor may keep its own stamps: "
            "Recording.from_streams) or name another column"
        )
    array.flags.writeable = False
    return array


def check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise a MagycError unless `value` is one of `choices`."""
    if value not in choices:
        raise MagycError(f"{name}: must be {' or '.join(map(repr, choices))}, got {value!r}")


def check_interval(start: object, end: object) -> None:
    """Raise a MagycError unless both ends of an interval are numbers of seconds or None."""
    for name, value in (("start", start), ("end", end)):
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool) and value == value
        if value is not None and not number:
            raise MagycError(f"{name}: must be a number of seconds, got {value!r:.40}")


def named_channels(channels: Any) -> Mapping[str, Any]:
    """Return the channels of a recording by name; None stands for none.

    Raises:
        MagycError: not a mapping, or a name that is no text.
    """
    if channels is None:
        return {}
    if not isinstance(channels, Mapping) or not all(isinstance(name, str) for name in channels):
        raise MagycError(f"channels: {{name: (N,) or (N, k)}} is needed, got {channels!r:.60}")
    return channels


def given_notes(notes: Any) -> tuple[str, ...]:
    """Return the notes of a recording; a text is one note.

    Raises:
        MagycError: neither a text nor a list of texts.
    """
    texts = (notes,) if isinstance(notes, str) else tuple(notes) if isinstance(notes, list | tuple) else (notes,)
    if not all(isinstance(text, str) for text in texts):
        raise MagycError(f"notes: a text or a list of texts is needed, got {notes!r:.60}")
    return texts


def columns_of(value: Any) -> str:
    """Return the first 20 column names of a data frame, separated by commas; "" for any other object."""
    if not (hasattr(value, "columns") and hasattr(value, "iloc")):
        return ""
    return ", ".join(map(str, list(value.columns)[:20]))


def given_away(array: Array) -> Array:
    """Make an array read-only, so that `frozen` takes it without copying; a view is copied first."""
    if not (array.flags.owndata and array.flags.c_contiguous):
        array = array.copy()
    array.flags.writeable = False
    return array


def _given_away(value: ArrayLike) -> TypeGuard[Array]:
    return (
        type(value) is np.ndarray
        and value.dtype == np.float64
        and value.flags.owndata
        and value.flags.c_contiguous
        and not value.flags.writeable
    )


def check_ascending(time: Array) -> None:
    """Raise a MagycError unless the time stamps (n,) s ascend strictly."""
    step = np.diff(time)
    if (step > 0).all():
        return
    row = int(np.flatnonzero(step <= 0)[0]) + 1
    what = "repeats" if step[row - 1] == 0 else "goes back"
    raise MagycError(
        f"time: {what} at row {row} ({time[row - 1]:.6f} s, then {time[row]:.6f} s; "
        f"{(step <= 0).sum()} such rows); it must ascend strictly: remove repeats, or cut where a clock was reset"
    )


def check_field_unit(magnetic_field: Array) -> None:
    """Raise a MagycError unless the field (n, 3) can be in tesla; the message names the likely unit."""
    square = np.einsum("ni,ni->n", magnetic_field, magnetic_field)
    norm = float(np.median(np.sqrt(square, out=square), overwrite_input=True))
    low, high = _FIELD_LIMITS
    if low <= norm <= high:
        if max(magnetic_field.max(), -magnetic_field.min()) > FIELD_RANGE:
            beyond = np.flatnonzero((np.abs(magnetic_field) > FIELD_RANGE).any(axis=1))
            raise MagycError(
                f"magnetic_field: {len(beyond)} of {len(magnetic_field)} rows are beyond {FIELD_RANGE:g} T, which no "
                f"magnetometer measures, the first is row {beyond[0]}; remove those rows"
            )
        return
    if not norm:
        raise MagycError(
            f"magnetic_field: zero in {np.mean(square == 0):.0%} of {len(square)} rows, which no magnetometer "
            "measures; check that it is connected and its driver runs, or name another source (magnetic_field=)"
        )
    centre = np.log(np.sqrt(EARTH_FIELD[0] * EARTH_FIELD[1]))
    unit = min(_FIELD_UNITS, key=lambda u: abs(np.log(max(norm, 1e-300) * _FIELD_UNITS[u]) - centre))
    guess = norm * _FIELD_UNITS[unit]
    likely = f"; likely unit: {unit}" if 0.2 * EARTH_FIELD[0] <= guess <= 10 * EARTH_FIELD[1] else ""
    counts = ""
    if norm > high and (magnetic_field == np.rint(magnetic_field)).all():
        likely += ", or raw counts" if likely else "; likely raw counts"
        counts = "; of raw counts give the tesla per count, or 'counts' to compare methods only"
    raise MagycError(
        f"magnetic_field: median norm {norm:.4g} is not a field in tesla "
        f"(the Earth's is 20e-6 to 70e-6, {low:g} to {high:g} is accepted){likely}; "
        f"convert it, or read it in its unit (magnetic_unit=){counts}"
    )


def impossible_rates(angular_rate: Array) -> Mask:
    """Return the rows (n,) beyond what gyroscopes measure, if they are few and all others are within any range.

    Such rows were damaged on their way. In another unit the readings would not stop at half the limit.
    """
    above = angular_rate.max(axis=1, initial=0.0) > _RATE_LIMIT
    beyond: Mask = above | (angular_rate.min(axis=1, initial=0.0) < -_RATE_LIMIT)
    if beyond.any() and (beyond.mean() > _FEW or np.abs(angular_rate[~beyond]).max() > 0.5 * _RATE_LIMIT):
        beyond[:] = False
    return beyond


def check_rate_unit(time: Array, angular_rate: Array) -> None:
    """Raise a MagycError unless the angular rate (n, 3) can be in rad/s."""
    if max(angular_rate.max(), -angular_rate.min()) > _RATE_LIMIT:
        largest = np.abs(angular_rate).max(axis=1)
        row = int(largest.argmax())
        damaged = np.flatnonzero(impossible_rates(angular_rate))
        if len(damaged):
            raise MagycError(
                f"angular_rate: {len(damaged)} of {len(largest)} rows are beyond {_RATE_LIMIT:g} rad/s, which no "
                f"gyroscope measures, the first is row {damaged[0]}; remove those rows"
            )
        raise MagycError(
            f"angular_rate: {largest[row]:.4g} at row {row} ({time[row]:.3f} s) is beyond {_RATE_LIMIT:g} rad/s; "
            "likely unit: deg/s or mrad/s; convert it, or read it in its unit (angular_unit=)"
        )


def unit_quaternions(attitude: Array) -> Array:
    """Return quaternions (n, 4) at norm 1 exactly; rows of NaN stay.

    Raises:
        MagycError: a norm differs from 1 by more than 0.01.
    """
    norm = np.linalg.norm(attitude, axis=1)
    known = np.isfinite(norm)
    wrong = known & (np.abs(norm - 1) > 0.01)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise MagycError(
            f"attitude: quaternion of norm {norm[row]:.4g} at row {row}, 1 is expected (x, y, z, w, "
            "sensor→world); mark rows without a reference with NaN"
        )
    # Normalised quaternions keep every bit, so that an interval of a recording has the values of the whole.
    unit = attitude / np.where(np.abs(norm - 1) < 1e-14, 1.0, norm)[:, None]
    unit.flags.writeable = False
    return unit


def no_values(column: Array) -> Mask:
    """Return the mask (n,) of the samples that stand for "no value": −99999 among temperatures, 1e30, infinity.

    A current that is off most of the time, or surges when it is switched on, has no such samples.
    """
    missing = np.abs(column) > _LARGEST
    known = np.isfinite(column) & ~missing
    candidate = known & np.isin(np.abs(column), _PLACEHOLDERS)
    if not (known & ~candidate).any():
        return missing
    distance = np.where(known, np.abs(column - np.median(column[known & ~candidate])), 0.0)
    if candidate.any():
        largest = float(distance[known & ~candidate].max(initial=0.0))
        missing |= candidate & (distance > _PLACEHOLDER_FACTOR * largest) & (largest > 0)
    remaining = distance[known & ~missing]
    if remaining.max(initial=0.0) <= _OUTLIER_FACTOR * float(np.quantile(remaining, 1 - _OUTLIER_SHARE)):
        return missing
    levels, count = np.unique(remaining[remaining > 0], return_counts=True)
    above = np.cumsum(count[::-1])[::-1]
    jumps = (levels[1:] > _OUTLIER_FACTOR * levels[:-1]) & (above[1:] <= _OUTLIER_SHARE * len(remaining))
    jumps[: _LEVELS - 1] = False
    if jumps.any():
        missing |= known & (distance > levels[np.argmax(jumps)])
    return missing


def without_no_values(name: str, value: Array) -> tuple[Array, str | None]:
    """Return a channel (n,) or (n, k) with NaN for its placeholders, and a note, or None if there were none."""
    columns = value.reshape(len(value), -1)
    missing = np.column_stack([no_values(column) for column in columns.T]) if columns.size else columns > 0
    if not missing.any():
        return value, None
    row, place = np.argwhere(missing)[0]
    kept = columns[:, place][~missing[:, place] & np.isfinite(columns[:, place])]
    clean = np.where(missing, np.nan, columns).reshape(value.shape)
    clean.flags.writeable = False
    others = f", where the others are {kept.min():.4g} to {kept.max():.4g}" if len(kept) else ""
    return clean, (
        f"channel {name!r}: {missing.any(axis=1).sum()} of {len(value)} samples are not values and were left out, the "
        f"first is {columns[row, place]:g} in row {row}{others}; a sample without a value is best written as NaN"
    )
