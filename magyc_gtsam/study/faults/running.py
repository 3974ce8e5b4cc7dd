"""Runs the study on the engine for many, one file per recording, so that an interrupted study goes on where it was."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.engine import Row, run_many
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording
from magyc_gtsam.storage.whole_file import whole_file
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.scoring import OUTCOMES, FaultScore, crashed, refused, score
from magyc_gtsam.study.faults.signals import record

Method = Callable[[Recording], Calibration | None]
STRENGTHS = ("weak", "strong")


@dataclass(frozen=True)
class Case:
    """One recording of the study."""

    fault: str
    strength: str
    motion: str
    seed: int

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.fault}-{self.strength}-{self.motion}-{self.seed}"


@dataclass(frozen=True)
class OutcomeCounts:
    """All seeds of one fault at one strength, on one motion, by one method: how many came to each outcome, and the
    median errors of those that were trusted and wrong (T and deg)."""

    fault: str
    strength: str
    motion: str
    method: str
    counts: Mapping[str, int]
    hard_iron: float
    heading: float


def cases(names: Sequence[str], motions: Sequence[str], seeds: int) -> list[Case]:
    """Every fault at both strengths; "clean" once.

    Raises:
        MagycError: an unknown fault.
    """
    unknown = [name for name in names if name not in FAULTS]
    if unknown:
        raise MagycError(f"fault: {unknown[0]!r} is none of {', '.join(FAULTS)}")
    return [
        Case(name, strength, motion, seed)
        for name in names or FAULTS
        for strength in (STRENGTHS if FAULTS[name].weak != FAULTS[name].strong else STRENGTHS[:1])
        for motion in motions
        for seed in range(seeds)
    ]


def run(
    folder: Path,
    every: Sequence[Case],
    methods: Mapping[str, Method],
    workers: int = 2,
    progress: Callable[[float], None] = lambda _: None,
) -> list[dict[str, Any]]:
    """One row for every case and method; what `folder` holds already is not done again.

    Args:
        folder: of the parts, `parts/CASE-METHOD.json`.
        every: what to record.
        methods: {name: recording → calibration}, functions that worker processes can import.
        workers: processes.
        progress: called with the share done.
    """
    parts = folder / "parts"
    parts.mkdir(parents=True, exist_ok=True)
    jobs = [CaseByMethod(parts, case, name, method) for case in every for name, method in methods.items()]
    pending = {job.name: job for job in jobs if not job.part.exists()}
    done = len(jobs) - len(pending)
    fresh = run_many(
        work, pending, workers=workers, progress=lambda share: progress((done + share * len(pending)) / len(jobs))
    )
    for name, row in fresh.items():
        if "error" in row:  # its process died, and died again
            _write(pending[name], crashed(RuntimeError(row["error"])))
    return [json.loads(job.part.read_text("utf-8")) for job in jobs]


@dataclass(frozen=True)
class CaseByMethod:
    """One case by one method, and the folder of its part."""

    parts: Path
    case: Case
    method_name: str
    method: Method

    @property
    def name(self) -> str:
        """Of its unit."""
        return f"{self.case.name}-{self.method_name}"

    @property
    def part(self) -> Path:
        """Its file."""
        return self.parts / f"{self.name}.json"


def work(job: CaseByMethod) -> Row:
    """The row of a job, which is also written to its part."""
    case, fault = job.case, FAULTS[job.case.fault]
    log = record(case.motion, case.seed, fault, getattr(fault, case.strength), case.fault)
    try:
        result = score(job.method(log.recording(case.name)), body_R_sensor=log.body_R_sensor)
    except MagycError as problem:
        result = refused(str(problem))
    except Exception as error:  # noqa: BLE001 - counted, and the study ends with exit code 1
        result = crashed(error)
    return _write(job, result)


def _write(job: CaseByMethod, result: FaultScore) -> Row:
    fault = FAULTS[job.case.fault]
    made = {"size": getattr(fault, job.case.strength), "unit": fault.unit, "shows": fault.shows}
    row = {**vars(job.case), **made, "method": job.method_name, **result.row()}
    row = {
        key: None if isinstance(value, float) and not np.isfinite(value) else value for key, value in row.items()
    }
    with whole_file(job.part) as file:
        file.write_text(json.dumps(row), "utf-8")
    return row


def cells(rows: Iterable[Mapping[str, Any]]) -> list[OutcomeCounts]:
    """The rows by fault, strength, motion and method; the worst first."""
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


def write(folder: Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """All rows as Parquet where pyarrow is installed, else as CSV."""
    with suppress(ImportError):
        import pyarrow
        from pyarrow import parquet

        path = folder / "faults.parquet"
        with whole_file(path) as part:
            parquet.write_table(pyarrow.Table.from_pylist([dict(row) for row in rows]), part)
        return path
    path = folder / "faults.csv"
    with whole_file(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path
