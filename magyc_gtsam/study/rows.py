"""What a study of many runs is made of: units of work through the engine, and the rows that come out."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from magyc_gtsam.engine import DIED, Progress, Row, run_many, write_rows


class Running(NamedTuple):
    """Where a study runs and what it leaves: folder of its rows (None keeps none), engine, processes, progress."""

    folder: Path | None = None
    engine: str = "local"
    workers: int | None = 1
    progress: Progress | None = None


HERE = Running()  # in this process, nothing kept
_NOT_IN_NAMES = re.compile(r"[^\w.=@+-]+")  # of files


def study_rows(name: str, work: Callable[[Any], Row], units: Iterable[Any], running: Running = HERE) -> list[Row]:
    """All rows of a study; with a folder in `<name>.parquet` there, and a run that was stopped goes on.

    A unit on which a process died twice has no rows, and is warned of.

    Args:
        name: of the study.
        work: a function of a module; a unit in, {column: list} out, one entry a row.
        units: named tuples of all that makes a unit's rows; their fields become columns too.
        running: where it runs.

    Raises:
        MagycError: as `run_many`.
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
    if running.folder is not None:
        write_rows(running.folder / f"{name}.parquet", rows)
    return rows


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
