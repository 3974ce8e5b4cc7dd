"""The numbers in the figures of reports, from a recording and its calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.level_turn import vertical
from magyc_gtsam.metrics import heading_error
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.time_base import interpolated
from magyc_gtsam.storage.json_types import json_types

DISTURBED_WEIGHT = 0.5  # a window with a robust weight below this counts as disturbed
_MOST_ROWS = 200_000  # samples per page, half an hour at 100 Hz; a longer log is thinned to every k-th sample
_CELLS = (24, 12)  # number of cells of the coverage map: longitude × latitude, all of the same area


@dataclass(frozen=True, eq=False)
class FieldHistory:
    """The magnetometer's samples before and after calibration; every k-th sample of a long log.

    Attributes:
        time: (n,) s since the first row.
        raw, calibrated: (n, 3) T, sensor axes.
        aligned: (n, 3) T, the calibrated field at the instants of the references, corrected for its delay.
        strength: T, of the calibrated field.
        up: (n, 3) unit vertical in sensor axes, NaN in rows where it is unknown; None without any reference.
        up_from: the source of the vertical, for display; "" without any reference.
        heading_error: (n, 2) deg, magnetic heading minus reference heading, raw and calibrated, each
            about its own mean; None without a reference attitude.
    """

    time: Array
    raw: Array
    calibrated: Array
    aligned: Array
    strength: float
    up: Array | None
    up_from: str
    heading_error: Array | None


@dataclass(frozen=True, eq=False)
class Coverage:
    """Time that the field spent in each cell of direction, in sensor axes.

    Attributes:
        sine: (13,) sine of the latitude, cell edges from −z to +z.
        seconds: (12, 24) s per cell, all cells of the same area.
    """

    sine: Array
    seconds: Array

    @property
    def share(self) -> float:
        """The share of the directions that were visited."""
        return float((self.seconds > 0).mean())

    @property
    def middle(self) -> int:
        """1 if the field pointed to the side of +z most of the time, otherwise −1."""
        return 1 if (self.sine[:-1] + self.sine[1:]) @ self.seconds.sum(axis=1) > 0 else -1


def field_history(recording: Recording, calibration: Calibration) -> FieldHistory:
    """Return the field before and after calibration, with the references that the recording holds."""
    every = -(-int(recording.magnetic_field_fresh.sum()) // _MOST_ROWS)
    if (
        recording.magnetic_field_fresh.all()
    ):  # a slice of the rows: their indices would need as much memory as a column
        fresh = np.arange(0, len(recording.time), every)
    else:
        fresh = np.flatnonzero(recording.magnetic_field_fresh)[::every]
    time, raw = recording.time[fresh], recording.magnetic_field[fresh]
    calibrated = calibration.corrected(raw)
    strength = calibration.field_strength
    if strength is None:
        strength = float(np.median(np.linalg.norm(calibrated, axis=1)))
    aligned = calibrated
    if calibration.delay:  # the magnetometer reads the field at an instant `delay` later
        later = time + calibration.delay
        aligned = interpolated(later, time, calibrated)
    attitude = None if recording.attitude is None else recording.attitude[fresh]
    acceleration = None if recording.acceleration is None else recording.acceleration[fresh]
    if attitude is not None and not np.isfinite(attitude).any():
        attitude = None
    up, up_from = vertical(attitude, acceleration), _up_from(attitude, acceleration)
    error = None
    if attitude is not None:
        error = np.degrees(np.column_stack([heading_error(field, attitude) for field in (raw, aligned)]))
    since = time - recording.time[0]
    return FieldHistory(since, raw, calibrated, aligned, strength, up, up_from, error)


def _up_from(attitude: Array | None, acceleration: Array | None) -> str:
    if attitude is not None:
        return "attitude" if acceleration is not None else "attitude, whose z axis is taken as up"
    return "" if acceleration is None else "accelerometer"


def coverage(time: Array, field: Array) -> Coverage:
    """Return how long `field` (n, 3) pointed into each cell of direction."""
    unit = field / np.linalg.norm(field, axis=1, keepdims=True)
    longitude = np.linspace(-np.pi, np.pi, _CELLS[0] + 1)
    sine = np.linspace(-1, 1, _CELLS[1] + 1)
    visits, _, _ = np.histogram2d(unit[:, 2], np.arctan2(unit[:, 1], unit[:, 0]), bins=(sine, longitude))
    return Coverage(sine, visits * float(np.median(np.diff(time))))


def ellipsoid_outline(matrix: Array, centre: Array, plane: tuple[int, int]) -> Array:
    """Return the outline (121, 2) of {matrix x + centre, ‖x‖ = 1}, projected onto the two axes of `plane`."""
    axes = list(plane)
    silhouette = np.linalg.cholesky((matrix @ matrix.T)[np.ix_(axes, axes)])
    angle = np.linspace(0, 2 * np.pi, 121)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return cast(Array, circle @ silhouette.T + centre[axes])


def disturbed_stretches(time: Array, weight: Array) -> list[tuple[float, float]]:
    """Return (start, end) of the stretches with low weight; those at most three windows apart are joined."""
    low: NDArray[np.int_] = np.flatnonzero(weight < DISTURBED_WEIGHT)
    if not len(low):
        return []
    half = float(np.median(np.diff(time))) / 2
    groups = np.split(low, np.flatnonzero(np.diff(low) > 3) + 1)
    return [(max(float(time[g[0]]) - half, 0.0), float(time[g[-1]]) + half) for g in groups]


def time_unit(time: Array) -> tuple[float, str]:
    """Return seconds per unit of a time axis, and the axis' label."""
    span = float(time[-1] - time[0])
    if span <= 1200:
        return 1.0, "Time (s)"
    return (60.0, "Time (min)") if span <= 3 * 3600 else (3600.0, "Time (h)")


def summary(time: Array, value: Array, most: int = 600) -> tuple[Array, Array, Array, Array]:
    """Return (time, mean, lowest, highest) of at most `most` bins of equal sample count, ignoring NaN."""
    per_bin = -(-len(time) // most)
    bins = len(time) // per_bin
    blocks = value[: bins * per_bin].reshape(bins, per_bin)
    known = np.isfinite(blocks)
    count = known.sum(axis=1)
    mean = np.where(count > 0, np.where(known, blocks, 0).sum(axis=1) / np.maximum(count, 1), np.nan)
    lowest = np.where(count > 0, np.where(known, blocks, np.inf).min(axis=1), np.nan)
    highest = np.where(count > 0, np.where(known, blocks, -np.inf).max(axis=1), np.nan)
    return time[: bins * per_bin].reshape(bins, per_bin).mean(axis=1), mean, lowest, highest


def spread(field: Array, cube: float, most: int = 3000) -> NDArray[np.int_]:
    """Return the rows of `field` (n, 3) to draw: one per cube of side `cube`, so that rest does not hide motion."""
    cells = np.floor(field / cube).astype(np.int64)
    cells -= cells.min(axis=0)
    cell = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, first = np.unique(cell, return_index=True)
    return first[:: -(-len(first) // most)]


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
