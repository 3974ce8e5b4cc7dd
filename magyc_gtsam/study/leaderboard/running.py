"""Run of every method on every recording, with the calibration judged on the unit's other recordings."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.engine import Progress, Row, run_many, write_rows
from magyc_gtsam.estimators import methods
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.storage.files import sha256
from magyc_gtsam.study.comparison import run_methods
from magyc_gtsam.study.leaderboard.collections import kind_of
from magyc_gtsam.study.leaderboard.optics import Reference, reference_of
from magyc_gtsam.study.leaderboard.reading import Reader, read_public
from magyc_gtsam.study.outcome import OutcomeStatus

DELIVERED, OPTICS = (
    "as delivered",
    "own optics",
)  # rows in addition to the methods: the reading as delivered, and the lower bound by the optics


@dataclass(frozen=True)
class LeaderboardLog:
    """A recording of the leaderboard: name, file, collection, unit and role."""

    name: str
    file: Path
    collection: str
    unit: str
    judges: bool


@dataclass(frozen=True)
class MethodOnLog:
    """A unit of work: calibrate `log` by `method` and judge on `others`; the logs `same` of the unit give the
    reference.
    """

    log: LeaderboardLog
    method: str
    others: tuple[LeaderboardLog, ...]
    same: tuple[LeaderboardLog, ...]
    reader: Reader


class HeadingScore(NamedTuple):
    """Circular deviation of the magnetic heading, and rms angle of the direction to its mean, deg."""

    heading: float
    direction: float


def logs_of(files: Sequence[Path]) -> tuple[list[LeaderboardLog], list[Path]]:
    """Return the recordings with a known unit, and the names of the other files."""
    logs, unknown = [], []
    for file in files:
        kind = kind_of(file.stem)
        if kind is None:
            unknown.append(file)
        else:
            logs.append(LeaderboardLog(file.stem, file, kind.collection.name, kind.unit, kind.judges))
    return logs, unknown


def tasks_of(logs: Sequence[LeaderboardLog], names: Sequence[str], reader: Reader) -> dict[str, MethodOnLog]:
    """Return {name of its row: task} for every recording that another one of its unit can judge.

    A row's name contains the checksum of its recording, so that a run into an old folder uses no row of other data.
    """
    tasks = {}
    for log in logs:
        same = tuple(other for other in logs if other.unit == log.unit and other.judges)
        others = tuple(other for other in same if other != log)
        if not others:
            continue
        digest = sha256(log.file)[:8]
        for name in (DELIVERED, OPTICS, *names):
            called = f"{log.name}-{name.replace(' ', '-').replace(':', '-')}-{len(others)}-{digest}"
            tasks[called] = MethodOnLog(log, name, others, same, reader)
    return tasks


def leaderboard_rows(
    tasks: Mapping[str, MethodOnLog],
    folder: Path | None = None,
    engine: str = "local",
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[Row]:
    """Return one row per task. With a folder, write them to its `leaderboard.parquet` and continue an interrupted run.

    Raises:
        MagycError: as `run_many`.
    """
    parts = None if folder is None else folder / "parts"
    rows = run_many(worked, tasks, engine=engine, workers=workers, parts=parts, progress=progress)
    table = []
    for name, task in tasks.items():
        log = task.log
        about = {"collection": log.collection, "unit": log.unit, "recording": log.name, "method": task.method}
        table.append(about | dict.fromkeys(_COLUMNS) | rows[name])
    if folder is not None:
        write_rows(folder / "leaderboard.parquet", table)
    return table


_COLUMNS = (
    "status",
    "reason",
    "seconds",
    "judges",
    "heading",
    "direction",
    "hard_iron",
    "covered",
    "components",
    "nees",
    "error",
)


def worked(task: MethodOnLog) -> Row:
    """Calibrate one recording by one method, and judge the calibration."""
    recording, device = _read(task.log.file, task.reader)
    if task.method == DELIVERED:
        return _judged(
            task, Calibration(np.eye(3), device, method=DELIVERED), str(OutcomeStatus.UNTRUSTED), "", None
        )
    if task.method == OPTICS:
        return _judged(task, None, str(OutcomeStatus.TRUSTED), "each judged by its own optics", None)
    blind = replace(recording, attitude=None)  # the method must not see the reference
    outcome = run_methods(blind, [task.method])[0]
    if outcome.calibration is None:
        return {"status": str(outcome.status), "reason": outcome.reason, "seconds": outcome.seconds}
    row = _judged(task, outcome.calibration, str(outcome.status), outcome.reason, outcome.seconds)
    return row | _coverage(task, outcome.calibration)


def _judged(
    task: MethodOnLog, calibration: Calibration | None, status: str, reason: str, seconds: float | None
) -> Row:
    """Judge a calibration on the other recordings; None judges each of these by its own optical calibration."""
    scores = []
    for other in task.others:
        recording, _ = _read(other.file, task.reader)
        reference = _reference(other.file, task.reader)
        scores.append(score(recording, reference, calibration or reference.calibration))
    return {
        "status": status,
        "reason": reason,
        "seconds": seconds,
        "judges": [other.name for other in task.others],
        "heading": [each.heading for each in scores],
        "direction": [each.direction for each in scores],
        "hard_iron": None if calibration is None else (calibration.hard_iron * 1e6).tolist(),
    }


def score(recording: Recording, reference: Reference, calibration: Calibration) -> HeadingScore:
    """Return the deviation of the calibrated field from a constant in the optical world frame, equally delayed for all
    methods.
    """
    time, field = recording.magnetometer
    rows = np.searchsorted(time, reference.time)
    with warnings.catch_warnings():  # bad calibrations are expected here
        warnings.simplefilter("ignore", UserWarning)
        calibrated = calibration.apply(field[rows])
    world = np.einsum("nij,nj->ni", reference.rotation, calibrated)
    unit = world / np.linalg.norm(world, axis=1, keepdims=True)
    mean = unit.mean(axis=0)
    angle = np.arccos(np.clip(unit @ (mean / np.linalg.norm(mean)), -1.0, 1.0))
    turned = np.exp(1j * np.arctan2(world[:, 1], world[:, 0]))
    heading = np.angle(turned * np.conj(turned.mean()))
    return HeadingScore(*(float(np.degrees(np.sqrt(np.mean(each**2)))) for each in (heading, angle)))


def _coverage(task: MethodOnLog, calibration: Calibration) -> Row:
    """Return the number of hard iron components within 1.96 joint sigmas of the optical ones, and the squared error."""
    if calibration.covariance is None:
        return {}
    truth, covariance = _truth(task)
    away = calibration.hard_iron - truth
    both = calibration.covariance[6:9, 6:9] + covariance
    inside = away**2 <= chi2.ppf(0.95, 1) * np.diag(both)
    return {
        "covered": int(inside.sum()),
        "components": 3,
        "nees": float(away @ np.linalg.solve(both, away)) / 3,
    }


def _truth(task: MethodOnLog) -> tuple[Array, Array]:
    """Return the optical hard iron (3,) in T and its covariance.

    They are the recording's own if it may judge, otherwise the mean of those that may, including their scatter.
    """
    if task.log.judges:
        own = _reference(task.log.file, task.reader)
        return own.calibration.hard_iron, own.covariance
    found = [_reference(log.file, task.reader) for log in task.same]
    irons = np.array([each.calibration.hard_iron for each in found])
    covariance = np.mean([each.covariance for each in found], axis=0)
    if len(found) > 1:
        covariance = covariance + np.diag(irons.var(axis=0, ddof=1))
    return irons.mean(axis=0), covariance


@lru_cache(maxsize=6)
def _read(file: Path, reader: Reader) -> tuple[Recording, Array]:
    return read_public(file, reader)


@lru_cache(maxsize=64)
def _reference(file: Path, reader: Reader) -> Reference:
    return reference_of(_read(file, reader)[0])


def checked_names(names: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of methods to run; None gives all that do not need the attitude that judges.

    Raises:
        MagycError: a method is unknown.
    """
    known = methods()
    for name in names or ():
        if name not in known:
            raise MagycError(f"methods: {name!r} is not one of {', '.join(known)}")
    return tuple(names or (name for name, method in known.items() if "attitude" not in method.needs))
