"""The signals to which a calibration is applied: those of a recording, or arrays given by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.calibration.followed import followed
from magyc_gtsam.factors.effects.signals import Signals, channels_by_kind
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import real_array
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.axes import OWN_AXES
from magyc_gtsam.recording.checks import columns_of, frozen, named_channels
from magyc_gtsam.recording.pauses import filled
from magyc_gtsam.recording.stamps import origin_of, seconds

_VECTORS = ("magnetic_field", "angular_rate", "acceleration")
_KNOWN = ("time", *_VECTORS, "channels")


def given_signals(value: ArrayLike | Recording, name: str, signals: Mapping[str, Any]) -> dict[str, Any]:
    """Return the signals by name: all those of a recording, or the array `value` under `name`; and `signals`.

    Raises:
        MagycError: a signal has an unknown name, or the recording does not have `name`.
    """
    unknown = sorted(signals.keys() - set(_KNOWN))
    if unknown:
        raise MagycError(f"apply: no signal {', '.join(map(repr, unknown))}; there are {', '.join(_KNOWN)}")
    if isinstance(value, Recording):
        if getattr(value, name) is None:
            raise MagycError(f"apply: recording {value.name!r:.60} has no {name}")
        return {k: getattr(value, k) for k in _KNOWN} | dict(signals)
    return {**signals, name: value}


def check_field_units(recording: ArrayLike | Recording, unit: str) -> None:
    """Raise a MagycError if a recording is not in the unit of the field, "T" or "counts", of a calibration."""
    if isinstance(recording, Recording) and recording.magnetic_field_unit != unit:
        raise MagycError(
            f"magnetic_field: must be in {unit}, the unit of the calibration, got a recording in "
            f"{recording.magnetic_field_unit}; read the log in that unit (magnetic_unit=), or calibrate it anew"
        )


def check_axes(recording: ArrayLike | Recording, configuration: Mapping[str, Any]) -> None:
    """Raise a MagycError if the gyroscope of a recording is in other axes than that of a calibration.

    Bias and terms of the gyroscope would be taken from the wrong axes.
    """
    own = configuration.get("gyroscope_axes", OWN_AXES)
    if not isinstance(recording, Recording) or recording.angular_rate is None or recording.gyroscope_axes == own:
        return
    remedy = "leave out gyroscope_axes=" if own == OWN_AXES else f"read it in these axes (gyroscope_axes='{own}')"
    raise MagycError(
        f"gyroscope axes: the calibration was made with the gyroscope's axes {own}, and the log is read with "
        f"{recording.gyroscope_axes}: {remedy}"
    )


def as_signals(name: str, rows: int, given: Mapping[str, Any], terms: Sequence[Term]) -> Signals:
    """Return the result of `given_signals` as the `Signals` of a number of rows; times are NaN without one.

    Args:
        name: the array to which the calibration is applied, for messages.
        rows: its number of rows.
        given: the other signals.
        terms: those of the calibration.

    Raises:
        MagycError: a signal does not hold numbers or has another number of rows, or there are too few rows for the
            terms.
    """
    if not rows and any(term.subtracted for term in terms):
        raise MagycError(f"{name}: 0 rows, at least 1 is needed by a calibration with terms")
    memory = [term.name for term in terms if term.remembers]
    if memory and rows == 1:
        raise MagycError(
            f"{name}: 1 row; {' and '.join(memory)} depends on what came before, so it needs the whole recording"
        )
    held = {k: v for k, v in given.items() if v is not None}
    time = np.full(rows, np.nan)
    if "time" in held:
        time = frozen("time", seconds("time", held["time"], origin_of(held["time"])), (rows,))
    columns = {
        k: frozen(k, np.atleast_2d(vectors(k, held[k])), (rows, 3), nan=True).T for k in _VECTORS if k in held
    }
    channels = {
        k: frozen(f"channel {k!r}", v, (rows, ...), nan=True)
        for k, v in named_channels(held.get("channels")).items()
    }
    return Signals(
        time,
        rate=columns.get("angular_rate"),
        acceleration=columns.get("acceleration"),
        channels={
            kind: np.stack([_filled(time, row) for row in value])
            for kind, value in channels_by_kind(followed(channels, terms) if terms else {}).items()
            if np.isfinite(value).any()
        },
    )


def _filled(time: Array, row: Array) -> Array:
    """Return a channel (n,) with its NaN interpolated linearly, where it has finite samples and their times."""
    return filled(time, row)[0] if np.isfinite(time).all() else row


def vectors(name: str, value: ArrayLike) -> Array:
    """Return `value` as an array (N, 3) or (3,).

    Raises:
        MagycError: it is not numeric or has another shape; the message starts with `name`.
    """
    try:
        array = real_array(value)
    except (TypeError, ValueError):
        raise MagycError(
            f"{name}: expected an array (N, 3) or (3,) of numbers, got {value!r:.40}; mg.read reads a log"
        ) from None
    if array.ndim not in (1, 2) or array.shape[-1] != 3:
        columns = columns_of(value)
        pick = f"; it is a table with the columns {columns}: name three" if columns else ""
        raise MagycError(f"{name}: shape {array.shape}, expected (N, 3) or (3,){pick}")
    return array
