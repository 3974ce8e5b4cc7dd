"""The table over many calibrated logs: one row each, on the terminal, on a page, and as CSV and Parquet."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from magyc_gtsam.cli.files import replacing
from magyc_gtsam.foreign_text import counted

if TYPE_CHECKING:
    from magyc_gtsam.engine import Row

AXES = ("x", "y", "z")
COLUMNS = (
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
    + tuple(f"hard_iron_{axis}_{what}" for axis in AXES for what in ("uT", "sigma_uT"))
    + tuple(f"gyro_bias_{axis}_mrad_s" for axis in AXES)
)


def distinct_names(logs: Iterable[Path]) -> dict[Path, str]:
    """Return the file name of each log, with as many of its folders as tell it from the others."""
    depth = dict.fromkeys(logs, 1)
    while True:
        names = {log: "/".join(log.parts[-depth[log] :]) for log in depth}
        count = Counter(names.values())
        longer = [log for log, name in names.items() if count[name] > 1 and depth[log] < len(log.parts)]
        if not longer:
            return names
        for log in longer:
            depth[log] += 1


def headline(table: Sequence[Row]) -> tuple[str, str]:
    """Return the number of calibrated logs as a title, and as the first line on the terminal."""
    good = sum(row["exit_code"] == 0 for row in table)
    title = f"{good} of {counted(len(table), 'log')} calibrated"
    return title, f"{'✔' if good == len(table) else '✘'} {title}"


def shown(table: Sequence[Row], short: bool = False) -> tuple[list[str], list[list[str]]]:
    """Return header and rows for the page, or `short` ones for the terminal; untrusted results have no numbers."""
    header = ["log", "s", "hard iron x, y, z (µT)", "± (1σ)", "heading (°, 1σ)", "verdict"]
    if short:
        header = ["log", "s", "hard iron (µT)", "±", "heading (°)", "verdict"]
    rows = []
    for row, label in zip(table, labels(table), strict=True):
        iron = [row[f"hard_iron_{axis}_uT"] for axis in AXES]
        sigma = [row[f"hard_iron_{axis}_sigma_uT"] for axis in AXES]
        verdict = {0: "✔ calibrated", 1: f"✘ {row['sentence']}", 2: f"refused: {row['sentence']}"}[
            row["exit_code"]
        ]
        if short:
            verdict = {0: "✔", 1: "✘ not trusted", 2: "✘ refused"}[row["exit_code"]]
        good = row["exit_code"] == 0
        rows.append(
            [
                label,
                "" if row["seconds"] is None else f"{row['seconds']:.0f}",
                "" if None in iron or not good else ", ".join(f"{value:.2f}" for value in iron),
                "" if None in sigma or not good else f"{max(sigma):.2f}",
                "" if row["heading_deg"] is None else f"{row['heading_deg']:.2g}",
                verdict,
            ]
        )
    return header, rows


def _lead(table: Sequence[Row]) -> list[str]:
    """Return what to do about the logs without a calibration; [] if there are none."""
    if all(row["exit_code"] == 0 for row in table):
        return []
    return ["Use the calibrations marked ✔; the table gives the reason and the remedy for each of the others."]


def labels(table: Sequence[Row]) -> list[str]:
    """Return the name of each row's log, followed by the magnetometer if that was named."""
    names = distinct_names(Path(row["log"]) for row in table)
    return [f"{names[Path(row['log'])]} {row['magnetometer'] or ''}".strip() for row in table]


def write_tables(folder: Path, table: Sequence[Row]) -> None:
    """Write calibrations.csv, calibrations.parquet if pyarrow is installed, and index.html."""
    import numpy as np

    from magyc_gtsam.engine import write_rows
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.report.summary_page import PageLink, Section, by_log, summary_page

    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS)
    writer.writeheader()
    writer.writerows(table)
    with replacing(folder / "calibrations.csv") as part:
        part.write_text(text.getvalue(), encoding="utf-8", errors="backslashreplace", newline="")
    try:
        write_rows(folder / "calibrations.parquet", table)
    except MagycError:  # the extra `parquet` is not installed; the same rows are in the CSV
        (folder / "calibrations.parquet").unlink(missing_ok=True)
    header, rows = shown(table)
    header = [header[0], header[-1], *header[1:-1]]  # a phone shows the first columns
    linked = [
        [PageLink(row[0], each["page"]) if each["page"] else row[0], row[-1], *row[1:-1]]
        for row, each in zip(rows, table, strict=True)
    ]
    sections = [Section("Logs", header, linked)]
    known = [row for row in table if row["exit_code"] == 0]
    labels = [row[0] for row, each in zip(rows, table, strict=True) if each["exit_code"] == 0]
    if known:
        iron, sigma = (
            np.array([[row[f"hard_iron_{axis}_{what}"] for axis in AXES] for row in known], dtype=np.float64)
            for what in ("uT", "sigma_uT")
        )
        figures = by_log(labels, iron, sigma)
        sections.append(Section("Hard iron, each log by itself", figures=figures))
    page = summary_page("Calibrations of many logs", headline(table)[0], not _lead(table), _lead(table), sections)
    with replacing(folder / "index.html") as part:
        part.write_text(page, encoding="utf-8", errors="backslashreplace")
