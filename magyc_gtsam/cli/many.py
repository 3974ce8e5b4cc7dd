"""`magyc-gtsam calibrate FOLDER|LOGS…`: each log by itself, one row each, one page over all."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from magyc_gtsam import __version__
from magyc_gtsam.cli.files import replacing, replacing_folder
from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.cli.results import dated_folder
from magyc_gtsam.cli.terminal import show, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.engine import Row

_NUMBERED = re.compile(r"\[(\d+)\]$")
_PATTERN = re.compile(r"[*?\[]")
_AXES = ("x", "y", "z")
_PARTS = ".parts"


@dataclass(frozen=True)
class Task:
    """One log to calibrate, or one compass of a log: a unit of work.

    Attributes:
        reading: how to read it.
        method, options, pairs: as `calibrate` has them.
        folder: for its results.
        arguments: the command line.
        force: write parameters to paste of a result that must not be trusted as well.
        compass: its number among those of the vehicle, from 1.
    """

    reading: Reading
    method: str
    options: dict[str, Any]
    pairs: list[str] | None
    folder: Path
    arguments: tuple[str, ...]
    force: bool
    compass: int = 1


def many(log: Path, more: Sequence[Path] | None) -> bool:
    """Whether these are many logs: several, a folder or a pattern."""
    return bool(more) or log.is_dir() or (not log.exists() and _PATTERN.search(str(log)) is not None)


def unique_names(logs: Sequence[Path]) -> list[str]:
    """A name for each log's folder: its stem, with its parents' where that is not enough."""
    depth = 1
    while True:
        names = ["-".join([*log.parts[-depth:-1], log.stem]).strip("/") for log in logs]
        if len(set(names)) == len(names) or depth > max(len(log.parts) for log in logs):
            break
        depth += 1
    seen: dict[str, int] = {}
    for i, name in enumerate(names):
        seen[name] = seen.get(name, 0) + 1
        names[i] = name if seen[name] == 1 else f"{name}-{seen[name]}"  # dive.mcap beside dive.csv
    return names


def each_log(task: Task, logs: Sequence[Path]) -> dict[str, Task]:
    """A task for each log, under the name of its folder; `task` is what is the same for all."""
    return {
        name: replace(task, reading=replace(task.reading, log=log))
        for name, log in zip(unique_names(logs), logs, strict=True)
    }


def each_compass(tasks: Mapping[str, Task]) -> dict[str, Task]:
    """A task for each magnetometer of each log.

    Raises:
        MagycError: a magnetometer was named, or a log is none, or has none.
    """
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.io import info

    found = {}
    for name, task in tasks.items():
        if task.reading.magnetic_field is not None:
            raise MagycError(
                f"--all: is for every magnetometer; leave out --magnetic-field {task.reading.magnetic_field}"
            )
        sources = [source for source in info(task.reading.log).sources if "magnetic_field" in source.serves_as]
        alone = [source for source in sources if not {"angular_rate", "acceleration"} & set(source.serves_as)]
        if not sources:
            raise MagycError(f"{task.reading.log}: no magnetometer in the log (magyc-gtsam info says what is)")
        for place, source in enumerate(alone or sources, start=1):
            numbered = _NUMBERED.search(source.name)
            folder = f"{name}-{re.sub(r'[^A-Za-z0-9]+', '-', source.name).strip('-')}"
            found[folder] = replace(
                task,
                reading=replace(task.reading, magnetic_field=source.name),
                compass=int(numbered[1]) + 1 if numbered else place,
            )
    return found


def calibrate_logs(named: Mapping[str, Task], output: Path | None, engine: str, quiet: bool, as_json: bool) -> int:
    """Calibrate all logs.

    Args:
        named: a task for each, under the name of its folder.
        output: folder for all results; None makes one in results/.
        engine: see `magyc_gtsam.engine`.

    Returns:
        The worst of the logs' exit codes.
    """
    from magyc_gtsam.engine import run_many

    folder = output or dated_folder(Path("logs"))
    each = [replace(task, folder=folder / name) for name, task in named.items()]
    tasks = {_fingerprint(one): one for one in each}
    folder.mkdir(parents=True, exist_ok=True)
    # A run into a folder of the user's own goes on where it was stopped; a new folder has nothing to go on from.
    parts = folder / _PARTS if output is not None and find_spec("pyarrow") else None
    for key, one in tasks.items() if parts is not None else ():
        if not (one.folder / "report.html").exists():  # refused, or removed since
            (folder / _PARTS / f"{key}.parquet").unlink(missing_ok=True)
    with stages(shown=not (quiet or as_json)) as stage:
        progress = stage(f"calibrating {len(each)} logs")
        rows = run_many(calibrate_one, tasks, engine=engine, parts=parts, progress=progress)
    table = [_as_row(tasks[key], row) for key, row in rows.items()]
    _write(folder, table)
    if as_json:
        typer.echo(json.dumps({"folder": str(folder), "logs": table}, indent=2))
    elif not quiet:
        show(_headline(table)[1], "")
        show_table(*_shown(table, short=True), words=(5,))
        show("", f"results: {folder}", f"page: {folder / 'index.html'}")
    code = max(row["exit_code"] for row in table)
    if code:
        bad = [row for row in table if row["exit_code"]]
        typer.echo(f"magyc-gtsam: {len(bad)} of {len(table)} logs have no trusted calibration", err=True)
        for row in bad:
            typer.echo(f"magyc-gtsam: {row['log']}: {row['sentence']}", err=True)
    return int(code)


def _fingerprint(task: Task) -> str:
    """Of a log and all that decides its result: the same where a run is repeated on an unchanged file."""
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
    said = repr((decisive, state.st_size, state.st_mtime_ns, __version__))
    return f"{task.folder.name}-{hashlib.sha256(said.encode()).hexdigest()[:16]}"


def calibrate_one(task: Task) -> Row:
    """A unit of work: one log calibrated, its files written; what is wrong with it is in the row."""
    from magyc_gtsam.cli.calibrate import calibrate_log
    from magyc_gtsam.factors.errors import MagycError

    try:
        with replacing_folder(task.folder) as part:
            recording, calibration, verdict = calibrate_log(
                task.reading, task.method, task.options, task.pairs, part, task.arguments, task.force, task.compass
            )
    except MagycError as error:
        return {"exit_code": 2, "sentence": str(error).removeprefix(f"{task.reading.log}: ")}
    except OSError as error:
        return {"exit_code": 2, "sentence": f"{error.filename}: {error.strerror}"}
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
    for k, axis in enumerate(_AXES):
        row[f"hard_iron_{axis}_uT"] = float(calibration.hard_iron[k] * 1e6)
        row[f"hard_iron_{axis}_sigma_uT"] = None if sigma is None else float(sigma[k] * 1e6)
        bias = calibration.gyro_bias
        row[f"gyro_bias_{axis}_mrad_s"] = None if bias is None else float(bias[k] * 1e3)
    return row


_COLUMNS = (
    (
        "log",
        "magnetometer",
        "exit_code",
        "sentence",
        "page",
        "seconds",
        "method",
        "field_strength_uT",
        "delay_ms",
        "heading_deg",
    )
    + tuple(f"hard_iron_{axis}_{what}" for axis in _AXES for what in ("uT", "sigma_uT"))
    + tuple(f"gyro_bias_{axis}_mrad_s" for axis in _AXES)
)


def _as_row(task: Task, row: Row) -> Row:
    """All columns in their order, with where the page is."""
    if "error" in row:
        row = {"exit_code": 2, "sentence": row["error"]}
    page = None if row["exit_code"] == 2 else f"{task.folder.name}/report.html"
    whole = {"log": str(task.reading.log), "magnetometer": task.reading.magnetic_field, "page": page} | row
    return {column: whole.get(column) for column in _COLUMNS}


def _headline(table: Sequence[Row]) -> tuple[str, str]:
    """How many logs were calibrated: as a title, and as the first line of the terminal."""
    good = sum(row["exit_code"] == 0 for row in table)
    title = f"{good} of {len(table)} logs calibrated"
    return title, f"{'✔' if good == len(table) else '✘'} {title}"


def _shown(table: Sequence[Row], short: bool = False) -> tuple[list[str], list[list[str]]]:
    """Header and rows for the page, and `short` for the terminal; no numbers of what must not be trusted."""
    header = ["log", "s", "hard iron x, y, z (µT)", "± (1σ)", "heading (°, 1σ)", "verdict"]
    if short:
        header = ["log", "s", "hard iron (µT)", "±", "heading (°)", "verdict"]
    rows = []
    for row in table:
        iron = [row[f"hard_iron_{axis}_uT"] for axis in _AXES]
        sigma = [row[f"hard_iron_{axis}_sigma_uT"] for axis in _AXES]
        verdict = {0: "✔ calibrated", 1: f"✘ {row['sentence']}", 2: f"refused: {row['sentence']}"}[
            row["exit_code"]
        ]
        if short:
            verdict = {0: "✔", 1: "✘ not trusted", 2: "✘ refused"}[row["exit_code"]]
        good = row["exit_code"] == 0
        rows.append(
            [
                _label(row),
                "" if row["seconds"] is None else f"{row['seconds']:.0f}",
                "" if None in iron or not good else ", ".join(f"{value:.2f}" for value in iron),
                "" if None in sigma or not good else f"{max(sigma):.2f}",
                "" if row["heading_deg"] is None else f"{row['heading_deg']:.2g}",
                verdict,
            ]
        )
    return header, rows


def _lead(table: Sequence[Row]) -> list[str]:
    """What to do about the logs without a calibration."""
    if all(row["exit_code"] == 0 for row in table):
        return []
    return ["Use the calibrations marked ✔; the table gives the reason and the remedy for each of the others."]


def _label(row: Row) -> str:
    """The log, and the magnetometer where that was named."""
    return f"{Path(row['log']).name} {row['magnetometer'] or ''}".strip()


def _write(folder: Path, table: Sequence[Row]) -> None:
    """calibrations.csv, calibrations.parquet where pyarrow is installed, and index.html."""
    import numpy as np

    from magyc_gtsam.engine import write_rows
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.report.summary_page import Link, Section, by_log, summary_page

    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS)
    writer.writeheader()
    writer.writerows(table)
    with replacing(folder / "calibrations.csv") as part:
        part.write_text(text.getvalue(), encoding="utf-8", errors="backslashreplace", newline="")
    try:
        write_rows(folder / "calibrations.parquet", table)
    except MagycError:  # the extra `parquet` is not installed; the same rows are in the CSV
        (folder / "calibrations.parquet").unlink(missing_ok=True)
    header, shown = _shown(table)
    header = [header[0], header[-1], *header[1:-1]]  # the verdict where a phone shows it
    linked = [
        [Link(_label(each), each["page"]) if each["page"] else row[0], row[-1], *row[1:-1]]
        for row, each in zip(shown, table, strict=True)
    ]
    sections = [Section("Logs", header, linked)]
    known = [row for row in table if row["exit_code"] == 0]
    if known:
        iron, sigma = (
            np.array([[row[f"hard_iron_{axis}_{what}"] for axis in _AXES] for row in known], dtype=np.float64)
            for what in ("uT", "sigma_uT")
        )
        figures = by_log([_label(row) for row in known], iron, sigma)
        sections.append(Section("Hard iron, each log by itself", figures=figures))
    page = summary_page("Calibrations of many logs", _headline(table)[0], not _lead(table), _lead(table), sections)
    with replacing(folder / "index.html") as part:
        part.write_text(page, encoding="utf-8", errors="backslashreplace")
