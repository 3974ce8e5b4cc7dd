"""The papers' studies on real recordings: Fig. 6 of the review, and Tables IV and V of Autocal.

The first recording is the reference, M1 of the Autocal paper: one without outliers from the same unit as the others.
No truth is needed. An accelerometer is calibrated like a magnetometer, with gravity in place of the field (section
III-C1 of that paper).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.engine import Row
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.metrics import (
    RunScores,
    model,
    normalised_model_error,
    real_data_cost,
    scores,
    sensor_estimation_error,
)
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.study.autocal import VARIANTS, triangular, variants
from magyc_gtsam.study.drawing import Panel, draw_panels
from magyc_gtsam.study.review import PUBLISHED as REVIEWED
from magyc_gtsam.study.rows import HERE, Running, study_rows

Sensor = Literal["magnetometer", "accelerometer"]
METHODS = {**{name: (name, {}) for name in REVIEWED}, **VARIANTS}
_GRAVITY = 50e-6 / 9.80665  # T per m/s², to process an accelerometer's readings as those of a magnetometer
_THIN = 5000  # number of samples of a track; the papers' have 300 to 600

# Autocal, Tables IV and V: deviation (40) and error (41) in % of the paper's unit of 100, without outliers (M2, A2) and
# the worst of the tracks with outliers.
PUBLISHED: dict[Sensor, dict[str, tuple[tuple[float, float], tuple[float, float]]]] = {
    "magnetometer": {
        "ellipsoid": ((2.0, 0.73), (48.8, 11.01)),
        "dorveaux": ((55.8, 18.08), (136.4, 25.51)),
        "kok-schon": ((2.1, 0.71), (26.6, 6.65)),
        "vasconcelos": ((2.0, 0.71), (41604.4, 17.95)),
        "magical": ((2.1, 0.71), (205.5, 27.76)),
        "l1-ellipsoid": ((2.5, 0.75), (6.4, 1.47)),
        "autocal, l1": ((1.9, 0.72), (3.8, 1.01)),
        "autocal, cauchy": ((2.0, 0.72), (2.2, 0.81)),
        "autocal, geman-mcclure": ((1.9, 0.73), (2.6, 0.84)),
        "autocal, huber": ((2.0, 0.71), (5.3, 1.19)),
    },
    "accelerometer": {
        "ellipsoid": ((0.6, 1.35), (15.1, 9.00)),
        "dorveaux": ((0.6, 1.34), (8.2, 5.16)),
        "kok-schon": ((0.5, 1.34), (9.8, 4.82)),
        "vasconcelos": ((0.6, 1.34), (8.2, 5.16)),
        "magical": ((0.5, 1.34), (4.1, 2.78)),
        "l1-ellipsoid": ((0.6, 1.34), (1.2, 1.41)),
        "autocal, l1": ((0.6, 1.34), (1.1, 1.40)),
        "autocal, cauchy": ((0.6, 1.34), (1.3, 1.43)),
        "autocal, geman-mcclure": ((1.0, 1.35), (1.9, 1.47)),
        "autocal, huber": ((0.5, 1.34), (0.9, 1.39)),
    },
}


class TrackPair(NamedTuple):
    """One method on one track, and the reference track."""

    sensor: Sensor
    reference: str
    track: str
    method: str


def real_rows(
    recordings: Mapping[str, Recording], sensor: Sensor = "magnetometer", running: Running = HERE
) -> list[Row]:
    """Return one row per track and method.

    Args:
        recordings: {name: recording}, the reference first.
        sensor: the sensor that is calibrated.
        running: execution of the study.

    Raises:
        MagycError: there are no recordings, or one lacks the sensor.
    """
    if not recordings:
        raise MagycError("real tracks: there are no recordings; give one or more logs, the reference first")
    tracks = {name: track_of(recording, sensor) for name, recording in recordings.items()}
    names = [name for name in METHODS if name in variants() or name in REVIEWED]
    chosen = [TrackPair(sensor, next(iter(tracks)), track, method) for track in tracks for method in names]
    return study_rows(f"real-{sensor}", partial(worked, tracks=tracks), chosen, running)


def track_of(recording: Recording, sensor: Sensor) -> Recording:
    """Return the sensor's samples alone, thinned to a number that the methods can process."""
    if sensor == "magnetometer":
        time, value = recording.magnetometer.time, recording.magnetometer.value
    else:
        if recording.acceleration is None:
            raise MagycError(
                f"{recording.name}: has no accelerometer; choose another log, or --sensor magnetometer"
            )
        time, value = recording.time, recording.acceleration * _GRAVITY
    step = -(-len(time) // _THIN)
    return Recording(time[::step], value[::step], name=recording.name)


def worked(unit: TrackPair, tracks: Mapping[str, Recording]) -> Row:
    """Run a method on one track and return all three measures."""
    reference = tracks[unit.reference]
    found, own = _calibrated(unit.method, tracks[unit.track]), _calibrated(unit.method, reference)
    samples = tracks[unit.track].magnetic_field
    row: dict[str, list[object]] = {
        "trusted": [found is not None and found.converged],
        "cost": [np.inf],  # (81)
        "trivial": [_trivial_cost(samples)],
        "deviation": [np.inf],  # (40)
        "error": [np.inf],  # (41)
    }
    if found is not None:
        row["cost"] = [real_data_cost(*model(found), samples)]
        away = sensor_estimation_error(*model(found), reference.magnetic_field)
        row["error"] = [away / _strength(reference.magnetic_field)]
        if own is not None:
            row["deviation"] = [
                normalised_model_error(triangular(found), found.hard_iron, triangular(own), own.hard_iron)
            ]
    return row


def over_tracks(rows: Sequence[Row], method: str) -> RunScores:
    """Return accuracy and robustness (77), (78) of a method by (81) at δ = 1, as in Fig. 6."""
    own = [row for row in rows if row["method"] == method]
    return scores([row["cost"] for row in own], [row["trivial"] for row in own], [np.nan] * len(own))


def _calibrated(name: str, track: Recording) -> Calibration | None:
    method, options = METHODS[name]
    try:
        return calibrate(track, method, **options)
    except MagycError:
        return None


def _strength(samples: Array) -> float:
    """Return half the width of the middle of the samples."""
    low, high = np.quantile(samples, [0.01, 0.99], axis=0)
    return float(np.median(np.linalg.norm(samples - 0.5 * (low + high), axis=1)))


def _trivial_cost(samples: Array) -> float:
    """Return the cost (81) without calibration: T = I and h = 0 in units of the mean field."""
    strength = float(np.mean(np.linalg.norm(samples, axis=1)))
    return real_data_cost(np.eye(3) * strength, np.zeros(3), samples)


def draw(target: Path, rows: list[Row]) -> None:
    """Draw (81), (40) and (41) of each method over the tracks, numbered from 1."""
    tracks = list(dict.fromkeys(row["track"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    x = list(range(1, len(tracks) + 1))
    panels = []
    for column, title in (("cost", "J_r (81)"), ("deviation", "deviation (40)"), ("error", "error (41)")):
        lines = {method: [row[column] or np.nan for row in rows if row["method"] == method] for method in methods}
        panels.append(Panel(title, "track", "", x, lines))
    draw_panels(target, panels)
