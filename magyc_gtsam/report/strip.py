"""A log at a glance: strength of the raw field and turn rate over time, in few steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.report.analysis import summary
from magyc_gtsam.storage.json_types import json_types

_STEPS = 400
_DIGITS = 4


def strip_of(recording: Recording) -> dict[str, Any]:
    """{quantity: {"time", "mean", "low", "high"}} as lists, JSON types; null where nothing was measured.

    Args:
        recording: of any length.

    Returns:
        "field" in µT (or counts) and, where there is a gyroscope, "rate" in °/s, each with its "unit"; "start" and
        "end" of the recording; times in s since the log's first row.
    """
    shown, unit = recording.field_shown
    time, field = recording.magnetometer
    result: dict[str, Any] = {
        "start": float(recording.time[0]),
        "end": float(recording.time[-1]),
        "field": _steps(time, np.linalg.norm(field, axis=1) * shown) | {"unit": unit},
        "rate": None,
    }
    if recording.angular_rate is not None:
        time, rate = recording.gyroscope
        result["rate"] = _steps(time, np.degrees(np.linalg.norm(rate, axis=1))) | {"unit": "°/s"}
    return result


def _steps(time: Array, value: Array) -> dict[str, Any]:
    names = ("time", "mean", "low", "high")
    columns = zip(names, summary(time, value, most=_STEPS), strict=True)
    return {name: json_types(np.round(column, _DIGITS)) for name, column in columns}
