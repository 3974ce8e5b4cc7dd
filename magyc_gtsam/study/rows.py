"""Execution of a study's units of work through the engine, and collection of the rows."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.engine import DIED, Progress, Row, run_many, write_rows


class Running(NamedTuple):
    """The execution of a study: folder for its rows (None to keep none), engine, number of processes, progress."""

    folder: Path | None = None
    engine: str = "local"
    workers: int | None = 1
    progress: Progress | None = None


HERE = Running()  # runs in this process and keeps nothing
_NOT_IN_NAMES = re.compile(r"[^\w.=@+-]+")  # characters not used in file names


def study_rows(name: str, work: Callable[[Any], Row], units: Iterable[Any], running: Running = HERE) -> list[Row]:
    """Return all rows of a study. With a folder, write them to `<name>.parquet` and continue an interrupted run.

    A unit whose process died twice gives a warning instead of rows.

    Args:
        name: name of the study.
        work: a module-level function that takes a unit and returns {column: list}, one entry per row; a column that
            it leaves out is None.
        units: named tuples that determine a unit's rows; their fields become columns, too.
        running: execution of the study.

    Raises:
        MagycError: as in `run_many`.
    """
    named: Mapping[str, Any] = {_NOT_IN_NAMES.sub("_", "-".join(map(_text, unit))): unit for unit in units}
    parts = None if running.folder is None else running.folder / f"{name}-parts"
    found = run_many(
        work, named, engine=running.engine, workers=running.workers, parts=parts, progress=running.progress
    )
    rows = []
    for key, unit in named.items():
        columns = found[key]
        if columns.get("error") == DIED:
            warnings.warn(f"study {name}: {key} is left out: {DIED}", stacklevel=2)
            continue
        count = max(len(values) for values in columns.values())
        rows += [unit._asdict() | {column: values[i] for column, values in columns.items()} for i in range(count)]
    names = dict.fromkeys(column for row in rows for column in row)
    rows = [{column: row.get(column) for column in names} for row in rows]
    if running.folder is not None:
        write_rows(running.folder / f"{name}.parquet", rows)
    return rows


class Cell:
    """The rows of a study under one condition, such as `motion="wide"`, and their averages."""

    def __init__(self, rows: Iterable[Row], **condition: Any) -> None:
        self._rows = [row for row in rows if all(row[name] == value for name, value in condition.items())]

    def column(self, name: str) -> list[Any]:
        """Return the values of a column."""
        return [row[name] for row in self._rows]

    def mean(self, name: str) -> float:
        """Return the mean of a column."""
        return float(np.mean(self.column(name)))

    def root(self, name: str) -> float:
        """Return the root of the mean of a column of squares."""
        return float(self.mean(name) ** 0.5)


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
