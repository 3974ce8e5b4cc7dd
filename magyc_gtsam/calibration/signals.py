"""The signals to which a calibration is applied: those of a recording, or arrays given by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.effects.signals import Signals, channels_by_kind
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import real_array
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.checks import columns_of


def given_signals(value: ArrayLike | Recording, name: str, signals: Mapping[str, Any]) -> dict[str, Any]:
    """Return the signals by name: all those of a recording, or the array `value` under `name` and `signals`.

    Raises:
        MagycError: a signal has an unknown name.
    """
    known = ("time", "magnetic_field", "angular_rate", "acceleration", "channels")
    if isinstance(value, Recording):
        return {k: getattr(value, k) for k in known} | dict(signals)
    unknown = sorted(signals.keys() - set(known))
    if unknown:
        raise MagycError(f"apply: no signal {', '.join(map(repr, unknown))}; there are {', '.join(known)}")
    return {**signals, name: value}


def as_signals(rows: int, given: Mapping[str, Any]) -> Signals:
    """Return the result of `given_signals` as the `Signals` of the given number of rows; times are NaN without one."""

    def columns(name: str) -> Array | None:
        return None if given.get(name) is None else np.atleast_2d(vectors(name, given[name])).T

    time = np.full(rows, np.nan) if given.get("time") is None else np.asarray(given["time"], dtype=np.float64)
    channels = channels_by_kind(given.get("channels") or {})
    return Signals(
        time,
        rate=columns("angular_rate"),
        acceleration=columns("acceleration"),
        channels={kind: np.stack([_filled(time, row) for row in value]) for kind, value in channels.items()},
    )


def _filled(time: Array, row: Array) -> Array:
    """Return a channel (n,) with its NaN interpolated linearly; zeros if it has no finite sample."""
    known = np.isfinite(row)
    if known.all() or not np.isfinite(time).all():
        return row
    return np.interp(time, time[known], row[known]) if known.any() else np.zeros_like(row)


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
