"""Execution of the study of faults through the engine, one file per row, so that an interrupted study continues."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.engine import DIED, Progress, Row, run_many, write_rows
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording
from magyc_gtsam.simulation.motion import MOTIONS
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.scoring import OUTCOMES, FaultScore, crashed, score
from magyc_gtsam.study.faults.signals import LoggedSamples, record

Method = Callable[[Recording], Calibration | None]
STRENGTHS = ("weak", "strong")
OTHER_STRENGTHS = ("slight", "between")


@dataclass(frozen=True)
class Case:
    """One recording of the study."""

    fault: str
    strength: str
    motion: str
    seed: int

    @property
    def name(self) -> str:
        """Name of its file."""
        return f"{self.fault}-{self.strength}-{self.motion}-{self.seed}"


@dataclass(frozen=True)
class OutcomeCounts:
    """The outcomes of all seeds of one fault at one strength, on one motion, by one method.

    Attributes:
        counts: {outcome: number of seeds}.
        hard_iron, heading: median errors of the wrong and trusted results, T and deg.
    """

    fault: str
    strength: str
    motion: str
    method: str
    counts: Mapping[str, int]
    hard_iron: float
    heading: float


@dataclass(frozen=True)
class SigmaCoverage:
    """Number of calibrations, and shares within one stated sigma.

    Attributes:
        count: number of calibrations.
        axes: share of the hard iron's axes, 0.68 of an honest covariance.
        hard_iron, heading: share of calibrations in which the largest error is, 0.32 of three independent axes.
    """

    count: int
    axes: float
    hard_iron: float
    heading: float


def cases(
    names: Sequence[str], motions: Sequence[str], seeds: Sequence[int], strengths: Sequence[str] = STRENGTHS
) -> list[Case]:
    """Return the cases of every fault at all strengths, and of "clean" once.

    Raises:
        MagycError: an unknown fault, motion or strength.
    """
    for strength in strengths:
        if strength not in STRENGTHS + OTHER_STRENGTHS:
            raise MagycError(f"strength: {strength!r} is not one of {', '.join(STRENGTHS + OTHER_STRENGTHS)}")
    for motion in motions:
        if motion not in MOTIONS:
            raise MagycError(f"motion: {motion!r} is not one of {', '.join(MOTIONS)}")
    unknown = [name for name in names if name not in FAULTS]
    if unknown:
        raise MagycError(f"fault: {unknown[0]!r} is not one of {', '.join(FAULTS)}")
    return [
        Case(name, strength, motion, seed)
        for name in names or FAULTS
        for strength in (strengths if FAULTS[name].weak != FAULTS[name].strong else strengths[:1])
        for motion in motions
        for seed in seeds
    ]


def drawn(every: Sequence[Case], count: int, seed: int) -> list[Case]:
    """Return some of the cases, drawn at random, in their order; all if there are no more than `count`."""
    chosen = np.random.default_rng(seed).permutation(len(every))[:count]
    return [every[k] for k in np.sort(chosen)]


def run(
    folder: Path,
    every: Sequence[Case],
    methods: Mapping[str, Method],
    workers: int = 2,
    progress: Progress | None = None,
) -> list[Row]:
    """Return one row per case and method and write them to `folder`; rows that exist are not computed again.

    Args:
        folder: folder of `faults.parquet`, and of a part for each row.
        every: the recordings of the study.
        methods: {name: recording → calibration}, functions that worker processes can import.
        workers: number of processes.
        progress: called with the share done.

    Raises:
        MagycError: the extra `parquet` is not installed.
    """
    jobs = {job.name: job for job in (CaseByMethod(case, *by) for case in every for by in methods.items())}
    rows = run_many(work, jobs, workers=workers, parts=folder / "parts", progress=progress)
    for name, row in rows.items():
        if row.get("error") == DIED:
            rows[name] = jobs[name].row(crashed(RuntimeError(DIED)))
    write_rows(folder / "faults.parquet", list(rows.values()))
    return list(rows.values())


@dataclass(frozen=True)
class CaseByMethod:
    """One case by one method."""

    case: Case
    method_name: str
    method: Method

    @property
    def name(self) -> str:
        """Name of its part."""
        return f"{self.case.name}-{self.method_name}"

    def row(self, result: FaultScore) -> Row:
        """Return the description of the case and the result as a row; None for values that are not finite."""
        fault = FAULTS[self.case.fault]
        made = {"size": getattr(fault, self.case.strength), "unit": fault.unit, "shows": fault.shows}
        row = {**vars(self.case), **made, "method": self.method_name, **result.row()}
        return {
            key: None if isinstance(value, float) and not np.isfinite(value) else value
            for key, value in row.items()
        }


def work(job: CaseByMethod) -> Row:
    """Return the row of a job."""
    case, fault = job.case, FAULTS[job.case.fault]
    log = record(case.motion, case.seed, fault, getattr(fault, case.strength), case.fault)
    largest = float(np.abs(log.field).max()) if fault.cuts else np.inf
    try:
        result = score(*_calibrated(job, log), log.body_R_sensor, float(log.field_time[-1]), largest)
    except Exception as error:  # noqa: BLE001 - counted, and the study ends with exit code 1
        result = crashed(error)
    return job.row(result)


def _calibrated(job: CaseByMethod, log: LoggedSamples) -> tuple[Calibration | None, str]:
    """Calibrate by the job's method; return None and the reason where it refuses the log."""
    try:
        return job.method(log.recording(job.case.name)), ""
    except MagycError as problem:
        return None, str(problem)


def cells(rows: Iterable[Mapping[str, Any]]) -> list[OutcomeCounts]:
    """Return the outcomes by fault, strength, motion and method, the worst first."""
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["fault"], row["strength"], row["motion"], row["method"]), []).append(row)
    result = []
    for (fault, strength, motion, method), group in groups.items():
        counts = {outcome: sum(row["outcome"] == outcome for row in group) for outcome in OUTCOMES}
        wrong = [row for row in group if row["outcome"] == OUTCOMES[0]]
        errors = [
            float(np.median([row[name] for row in wrong])) if wrong else np.nan
            for name in ("hard_iron", "heading")
        ]
        result.append(OutcomeCounts(fault, strength, motion, method, counts, *errors))
    return sorted(result, key=lambda cell: -cell.counts[OUTCOMES[0]] / sum(cell.counts.values()))


def covered(rows: Iterable[Mapping[str, Any]]) -> SigmaCoverage | None:
    """Return the coverage over faults that resemble misaligned chips; None without any.

    Untrusted results count as well, since the stated sigma must cover such faults.
    """
    names = ("axes_covered", "hard_iron_sigmas", "heading_sigmas")  # a row of an older run has no share of axes
    hidden = [row for row in rows if not row["shows"] and all(row.get(name) is not None for name in names)]
    if not hidden:
        return None
    axes = float(np.mean([row["axes_covered"] for row in hidden]))
    largest = (float(np.mean([row[name] <= 1.0 for row in hidden])) for name in names[1:])
    return SigmaCoverage(len(hidden), axes, *largest)
