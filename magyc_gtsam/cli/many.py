"""`magyc-gtsam calibrate FOLDER|LOGS…`: calibrate each log by itself, with one page over all."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from magyc_gtsam import __version__
from magyc_gtsam.cli.files import made
from magyc_gtsam.cli.interrupts import explained
from magyc_gtsam.cli.many_table import AXES, COLUMNS, distinct_names, headline, labels, shown, write_tables
from magyc_gtsam.cli.own_files import remove_results
from magyc_gtsam.cli.results import Task, calibrate_log, dated_folder
from magyc_gtsam.cli.terminal import complain, show, show_json, show_page, show_results, show_table, stages
from magyc_gtsam.foreign_text import counted
from magyc_gtsam.storage.files import size_of

if TYPE_CHECKING:
    from magyc_gtsam.engine import Row

_NUMBERED = re.compile(r"\[(\d+)\]$")
_PATTERN = re.compile(r"[*?\[]")
_PARTS = ".parts"


def many(log: Path, more: Sequence[Path] | None) -> bool:
    """Return whether the arguments of a command name several logs, a folder that is no ROS 2 bag, or a pattern."""
    if log.is_dir() and not more:
        from magyc_gtsam.io.ros2_bag import is_bag

        return not is_bag(log)
    return bool(more) or (not log.exists() and _PATTERN.search(str(log)) is not None)


def unique_names(logs: Sequence[Path]) -> list[str]:
    """Return a unique name for the folder of each log: its stem, with the names of its parents if needed."""
    stems = [log.with_suffix("") for log in logs]
    distinct = distinct_names(stems)
    names = [distinct[stem].replace("/", "-").strip("-") for stem in stems]
    seen: dict[str, int] = {}
    for i, name in enumerate(names):
        seen[name] = seen.get(name, 0) + 1
        names[i] = name if seen[name] == 1 else f"{name}-{seen[name]}"  # dive.mcap beside dive.csv
    return names


def each_log(task: Task, logs: Sequence[Path]) -> dict[str, Task]:
    """Return a copy of `task` for each log, by the name of its folder."""
    return {
        name: replace(task, reading=replace(task.reading, log=log))
        for name, log in zip(unique_names(logs), logs, strict=True)
    }


def each_compass(tasks: Mapping[str, Task]) -> dict[str, Task]:
    """Return a task for each magnetometer of each log, by the name of its folder.

    Raises:
        MagycError: a magnetometer was named, or a file is not a log or has no magnetometer.
    """
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.io import info

    compasses = {}
    for name, task in tasks.items():
        if task.reading.magnetic_field is not None:
            raise MagycError(
                f"--all calibrates every magnetometer; leave out --magnetic-field {task.reading.magnetic_field}"
            )
        sources = [source for source in info(task.reading.log).sources if "magnetic_field" in source.serves_as]
        alone = [source for source in sources if not {"angular_rate", "acceleration"} & set(source.serves_as)]
        if not sources:
            raise MagycError(
                f"{task.reading.log}: no magnetometer in the log; magyc-gtsam info lists its contents"
            )
        for place, source in enumerate(alone or sources, start=1):
            numbered = _NUMBERED.search(source.name)
            folder = f"{name}-{re.sub(r'[^A-Za-z0-9]+', '-', source.name).strip('-')}"
            compasses[folder] = replace(
                task,
                reading=replace(task.reading, magnetic_field=source.name),
                compass=int(numbered[1]) + 1 if numbered else place,
            )
    return compasses


def calibrate_logs(
    named: Mapping[str, Task], output: Path | None, engine: str, open_page: bool, quiet: bool, as_json: bool
) -> int:
    """Calibrate all logs, and write and show a table of the results.

    Args:
        named: {name of the folder: task}.
        output: folder for all results; None for a new one in results/.
        engine: see `magyc_gtsam.engine`.
        open_page, quiet, as_json: of the command line.

    Returns:
        The largest exit code of a log.
    """
    from magyc_gtsam.engine import run_many

    folder = output or dated_folder(Path("logs"))
    each = [replace(task, folder=folder / name) for name, task in named.items()]
    tasks = {_fingerprint(one): one for one in each}
    # A run into a folder that the user named resumes where it was interrupted.
    parts = folder / _PARTS if output is not None and find_spec("pyarrow") else None
    for part in () if parts is None else parts.glob("*.parquet"):
        known = tasks.get(part.stem)
        if known is None or not (known.folder / "report.html").exists():  # of other options, failed or removed
            part.unlink(missing_ok=True)
    with made(folder):
        with stages(shown=not (quiet or as_json)) as stage:
            progress = stage(f"calibrating {len(each)} logs")
            rows = run_many(calibrate_one, tasks, engine=engine, parts=parts, progress=progress)
        table = [_table_row(tasks[key], row) for key, row in rows.items()]
        refused = [tasks[key].folder for row, key in zip(table, rows, strict=True) if row["exit_code"] == 2]
        if len(refused) == len(table):  # as of one such log: nothing is written, and earlier results stay
            shutil.rmtree(folder / _PARTS, ignore_errors=True)
            if as_json:
                show_json({"folder": None, "logs": table})
            return _complained(table)
        for earlier in refused:  # the page says that these logs are refused
            remove_results(earlier)
            with suppress(OSError):  # there is none, or it has other files
                earlier.rmdir()
        remove_results(folder)
        write_tables(folder, table)
    if open_page:
        show_page(folder / "index.html")
    if as_json:
        show_json({"folder": str(folder), "logs": table})
    elif not quiet:
        show(headline(table)[1], "")
        show_table(*shown(table, short=True), words=(5,))
        show_results(folder, page="index.html")
    return _complained(table)


def _complained(table: Sequence[Row]) -> int:
    """Say which logs have no trusted calibration, and why; return the largest exit code."""
    code = max(row["exit_code"] for row in table)
    if code:
        failed = sum(bool(row["exit_code"]) for row in table)
        complain(f"without a trusted calibration: {failed} of {counted(len(table), 'log')}")
        for row, label in zip(table, labels(table), strict=True):
            if row["exit_code"]:
                complain(f"{label}: {row['sentence']}")
    return int(code)


def _fingerprint(task: Task) -> str:
    """Return a name for a task that changes with the file and with every option that affects the result."""
    state = task.reading.log.stat()
    decisive = (
        task.reading.to_dict(),
        task.method,
        task.options,
        task.pairs,
        str(task.folder),
        task.force,
        task.compass,
    )
    text = repr((decisive, size_of(task.reading.log), state.st_mtime_ns, __version__))
    return f"{task.folder.name}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


def calibrate_one(task: Task) -> Row:
    """Calibrate one log, write its files, and return its row; errors are in the row."""
    try:
        recording, calibration, verdict = calibrate_log(task)
    except Exception as error:  # noqa: BLE001 - a bug must not cost the results of the other logs
        return {"exit_code": 2, "sentence": explained(error).removeprefix(f"{task.reading.log}: ")}
    row: Row = {
        "exit_code": 0 if verdict.trusted else 1,
        "sentence": verdict.reason,
        "seconds": recording.duration,
        "method": calibration.method,
        "field_strength_uT": None if calibration.field_strength is None else calibration.field_strength * 1e6,
        "delay_ms": calibration.delay * 1e3,
        "heading_deg": verdict.heading.systematic,
    }
    sigma = calibration.sigma.get("hard_iron")
    for k, axis in enumerate(AXES):
        row[f"hard_iron_{axis}_uT"] = float(calibration.hard_iron[k] * 1e6)
        row[f"hard_iron_{axis}_sigma_uT"] = None if sigma is None else float(sigma[k] * 1e6)
        bias = calibration.gyro_bias
        row[f"gyro_bias_{axis}_mrad_s"] = None if bias is None else float(bias[k] * 1e3)
    return row


def _table_row(task: Task, row: Row) -> Row:
    """Return all columns of a row in their order, with the path of the page."""
    if "error" in row:
        row = {"exit_code": 2, "sentence": row["error"]}
    page = None if row["exit_code"] == 2 else f"{task.folder.name}/report.html"
    values = {"log": str(task.reading.log), "magnetometer": task.reading.magnetic_field, "page": page} | row
    return {column: values.get(column) for column in COLUMNS}
