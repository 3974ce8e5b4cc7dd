"""Summary of a log for display: strength of the raw field and turn rate over time, in few steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.report.analysis import summary
from magyc_gtsam.storage.json_types import json_types

_STEPS = 400
_DIGITS = 4


def strip_of(recording: Recording) -> dict[str, Any]:
    """Return a summary of the field strength and the turn rate over time, as JSON types.

    Args:
        recording: a recording of any length.

    Returns:
        "start" and "end" of the recording in s, "field" in µT (or counts) and "rate" in °/s; each of the two with its
        "unit" and the lists "time", "mean", "low" and "high". "rate" is None without a gyroscope.
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
