"""`magyc-gtsam study leaderboard`: judge all methods on public recordings by others of the same unit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from magyc_gtsam.cli.files import replacing
from magyc_gtsam.cli.terminal import show, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.engine import Row
    from magyc_gtsam.study.leaderboard.standings import MethodStanding

HEADER = (
    "method", "trusted", "heading °", "direction °", "worst °", "best", "better", "worse", "in 1.96 σ", "NEES", "s"
)  # fmt: skip
_JUDGED = (
    "Each method calibrates one recording and is judged on the others of its unit, by their optical attitude."
)
_COLUMNS = (
    "heading, direction: medians over these pairs of what a user gets: the calibrated reading where the method trusts "
    "it, else the reading as delivered",
    "worst: the largest heading error among the trusted pairs",
    "best: pairs in which no other method is better by 2 %",
    "better, worse: trusted pairs against the reading as delivered",
    "in 1.96 σ: share of the axes whose stated interval of 95 % holds the optical hard iron; NEES: median per freedom",
    "own optics: each recording's own optical fit, which nothing can beat by much",
)
_SHOWN = 12  # losses of the default method that are shown


def leaderboard(
    output: Path, folder: Path | None, address: str | None, names: Sequence[str] | None, engine: str, workers: int
) -> int:
    """Run the calibrations that are not done yet, print the tables, write page and rows, and return the exit code.

    Args:
        output: folder for the rows and the page.
        folder, address: of the recordings; see `study.leaderboard.fetching`.
        names: names of methods; None for all.
        engine, workers: see `magyc_gtsam.engine`.
    """
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.io import read
    from magyc_gtsam.study.leaderboard import fetching, running
    from magyc_gtsam.study.leaderboard.collections import COLLECTIONS

    chosen = running.checked_names(names)
    with stages() as stage:
        if folder is not None and address is None:
            files = fetching.local(folder)
        else:
            files = fetching.fetch(folder, address, stage("recordings"))
        logs, unknown = running.logs_of(files)
        tasks = running.tasks_of(logs, chosen, read)
        if not tasks:
            raise MagycError(
                f"none of {len(files)} recordings has another of the same unit to judge it; give two of a unit"
            )
        title = f"{len(tasks)} calibrations by {len(chosen)} methods"
        rows = running.leaderboard_rows(tasks, output, engine, workers, stage(title))
    left_out = sorted({log.name for log in logs} - {row["recording"] for row in rows})
    notes = [f"no other recording of its unit can judge: {name}" for name in left_out]
    notes += [f"unit not known: {file.name}" for file in unknown]
    notes += [f"{c.name}: {c.citation}, {c.source}, {c.licence}" for c in COLLECTIONS]
    tables = _tables(rows)
    for name, table in tables.items():
        show("", name, "")
        show_table(HEADER, [cells(each) for each in table])
    show("", _JUDGED, *_COLUMNS, "", *notes)
    sentences = lost(rows, chosen)
    show("", *sentences[:_SHOWN])
    page = output / "index.html"
    with replacing(page) as part:
        part.write_text(_page(tables, sentences, notes, len(rows)), encoding="utf-8")
    show("", f"{page}, {output / 'leaderboard.parquet'}")
    return 0


def _tables(rows: Sequence[Row]) -> dict[str, list[MethodStanding]]:
    """Return {title: standings} of each collection."""
    from magyc_gtsam.study.leaderboard.standings import standings

    tables = {}
    for name in sorted({row["collection"] for row in rows}):
        part = [row for row in rows if row["collection"] == name]
        units, recordings = (len({row[column] for row in part}) for column in ("unit", "recording"))
        tables[f"{name}: {recordings} recordings of {units} unit{'s' if units > 1 else ''}"] = standings(part)
    return tables


def cells(each: MethodStanding) -> list[str]:
    """Return the texts of one row of the table."""

    def text(value: float | None, form: str) -> str:
        return "–" if value is None else format(value, form)

    return [
        each.method,
        f"{each.trusted}/{each.calibrations}",
        f"{each.heading:.2f}",
        f"{each.direction:.2f}",
        text(each.worst, ".1f"),
        f"{each.best}/{each.pairs}",
        f"{each.better}",
        f"{each.worse}",
        text(each.covered, ".0%"),
        text(each.nees, ".3g"),
        text(each.seconds, ".2f"),
    ]


def lost(rows: Sequence[Row], names: Sequence[str]) -> list[str]:
    """Return sentences on the pairs in which the first method loses, worst first, and on methods that failed."""
    from magyc_gtsam.study.leaderboard.standings import losses

    first = names[0]
    lost_pairs = losses(rows, first)
    sentences = [f"{first} is behind the best in {len(lost_pairs)} pairs:"] if lost_pairs else []
    sentences += [
        f"  {pair.calibrated_on} judged on {pair.judged_on}: {pair.heading:.2f}°, {ratio:.2f} times the best"
        + ("" if pair.trusted else "; its result is not trusted, so that this is the reading as delivered")
        for pair, ratio in lost_pairs
    ]
    return sentences + [
        f"{row['method']} failed on {row['recording']}: {row['reason']}"
        for row in rows
        if row["status"] in ("failed", "not possible")
    ]


def _page(
    tables: dict[str, list[MethodStanding]], sentences: Sequence[str], notes: Sequence[str], calibrations: int
) -> str:
    from magyc_gtsam.report.summary_page import Section, summary_page

    sections = [Section(name, HEADER, [cells(each) for each in table]) for name, table in tables.items()]
    sections.append(Section("Columns", sentences=_COLUMNS))
    sections.append(Section("Losses", sentences=[each.strip() for each in sentences] or ["None."]))
    sections.append(Section("Recordings", sentences=notes))
    return summary_page("Leaderboard", f"{calibrations} calibrations judged by optics", True, [_JUDGED], sections)
