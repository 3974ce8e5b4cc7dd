"""Studies that reproduce the papers: their numbers beside ours in tables, a plot, and every run as Parquet."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from magyc_gtsam.cli.study_options import recordings_of
from magyc_gtsam.cli.terminal import show, show_table, stages
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.study.rows import Cell, Running, study_rows

if TYPE_CHECKING:
    from magyc_gtsam.engine import Row
    from magyc_gtsam.study.review import MethodScore
    from magyc_gtsam.study.table_one import MethodOnMotion


class StudyOutput(NamedTuple):
    """The folder of a study's files, and the engine on which it runs; see `magyc_gtsam.engine`."""

    folder: Path
    engine: str
    workers: int

    @contextmanager
    def running(self, title: str) -> Iterator[Running]:
        """Yield the engine's settings, and show a progress bar."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with stages() as stage:
            yield Running(self.folder, self.engine, self.workers, stage(title))

    def rows(self, title: str, name: str, work: Callable[[Any], Row], units: Iterable[Any]) -> list[Row]:
        """Run a study whose units are independent, and return its rows."""
        with self.running(title) as running:
            return study_rows(name, work, units, running)

    def drawn(self, name: str, draw: Callable[[Path], None]) -> None:
        """Draw `<name>.svg`, and print where the files are."""
        draw(self.folder / f"{name}.svg")
        show("", f"{self.folder}: {name}.svg, and every run as Parquet")


def review(place: StudyOutput, runs: int) -> None:
    """Reproduce Table 2 and Figs 2 to 5 of the review."""
    from magyc_gtsam.study import review as study

    conditions = [condition for each in study.FIGURES.values() for condition in each]
    rows = place.rows(f"{runs} runs a condition", "review", study.worked, study.units(runs, conditions))
    table = study.method_scores(rows)
    reference, first = table[0].scores.time, study.PUBLISHED[table[0].method][2]
    show("Table 2: the baseline (80)")
    header = ["", "1/ρ", "paper", "robust", "paper", f"δ = {study.STRICT:g}", "refused"]
    shown = []
    for score in table:
        accuracy, robustness, speed = study.PUBLISHED[score.method]
        cells = [
            f"{score.scores.accuracy:.3g}",
            f"{accuracy:.3g}",
            f"{score.scores.robustness:.1%}",
            f"{robustness:.1f}%",
        ]
        cells += [f"{score.strict.robustness:.1%}", f"{score.refused}"]
        shown.append([score.method, *cells, f"{score.scores.time / reference:.2g}", f"{first / speed:.2g}"])
    shown.append(["bound", f"{table[0].bound:.3g}", *[""] * 7])
    show_table([*header, f"time / {table[0].method}", "paper"], shown)

    def cell(score: MethodScore) -> str:
        share = score.scores.robustness
        return f"{score.scores.accuracy:.3g}" + (f" ({share:.0%})" if share < 1 else "") if share else "–"

    for number, (parameter, moved) in enumerate(study.FIGURES.items(), start=2):
        symbol = study.SYMBOLS[parameter]
        show("", f"Fig. {number}, by {symbol}: 1/ρ, in brackets the share that is robust where it is not all", "")
        shown = []
        each = [study.method_scores(rows, condition) for condition in moved]
        drawn = [study.method_scores(rows, condition, centred=False) for condition in moved]
        for i, name in enumerate(study.PUBLISHED):
            shown.append([name, *(cell(found[i]) for found in each)])
        for i, name in enumerate(study.PUBLISHED):
            shown.append([f"{name}, as drawn", *(cell(found[i]) for found in drawn)])
        shown.append(["bound", *(f"{found[0].bound:.3g}" for found in each)])
        show_table(["", *(f"{symbol} = {getattr(condition, parameter):g}" for condition in moved)], shown)
        show(f"the paper: {study.SAID[parameter]}")
    place.drawn("review", lambda target: study.draw_figures(target, rows))


def autocal(place: StudyOutput, runs: int) -> None:
    """Reproduce Figs 5 and 6 of the Autocal paper, and add one-sided data."""
    from magyc_gtsam.study import autocal as study

    def cell(score: study.ModelErrors) -> str:
        error = "–" if score.failed == 1 and not score.median < 10 else f"{100 * score.median:.2f}"
        return error if not score.failed else f"{error} ({score.failed:.0%})"

    rows = place.rows(f"{runs} runs a condition", "autocal", study.worked, study.units(runs))
    for name, part in study.PARTS.items():
        table = study.method_scores(rows, name)
        show(
            "",
            f"{part.title}, by {part.symbol}: median error in %, in brackets the share of runs off by more than 10 %",
            "",
        )
        methods = next(iter(table.values()))
        shown = [[method, *(cell(scores[method]) for scores in table.values())] for method in methods]
        show_table(["", *(f"{value:g}" for value in table)], shown)
        if published := study.SAID.get(part.title[:6]):
            show(f"the paper: {published}")
    place.drawn("autocal", lambda target: study.draw(target, rows))


def real_tracks(place: StudyOutput, logs: Sequence[str], sensor: str) -> None:
    """Reproduce Fig. 6 of the review, and Tables IV and V of the Autocal paper."""
    from magyc_gtsam.study import real_tracks as study

    if sensor not in ("magnetometer", "accelerometer"):
        raise MagycError(f"--sensor: must be 'magnetometer' or 'accelerometer', got {sensor!r}")
    if not logs:
        raise MagycError("study real-tracks: no logs; give --log LOG for each, first the one to compare with")
    recordings = recordings_of(logs)
    with place.running(f"{len(recordings)} tracks") as running:
        rows = study.real_rows(
            recordings, "magnetometer" if sensor == "magnetometer" else "accelerometer", running
        )
    methods = list(dict.fromkeys(row["method"] for row in rows))
    tracks = [f"{i}" for i in range(1, len(recordings) + 1)]
    show(*(f"track {i}: {name}" for i, name in zip(tracks, recordings, strict=True)))

    def table(column: str, shown: Callable[[float], str]) -> list[list[str]]:
        return [
            [
                method,
                *(shown(row[column]) + ("" if row["trusted"] else "*") for row in rows if row["method"] == method),
            ]
            for method in methods
        ]

    show(
        "",
        "Fig. 6 of the review: 1/J_r (81) on the track, over all and robustness (77), (78); * not trusted",
        "",
    )
    shown = table("cost", lambda value: f"{1 / value:.3g}" if value > 0 else "∞")
    for row in shown:
        score = study.over_tracks(rows, row[0])
        row += [f"{score.accuracy:.3g}", f"{score.robustness:.0%}"]
    show_table(["", *tracks, "all", "robust"], shown)
    published = study.PUBLISHED["magnetometer" if sensor == "magnetometer" else "accelerometer"]
    for column, title, place_in_paper in (
        ("deviation", "Table IV of Autocal: deviation (40) in % from the method's own model of track 1", 0),
        ("error", "Table V of Autocal: error (41) on track 1, in % of the field", 1),
    ):
        show("", f"{title}; beside, the paper's: its clean track and the worst with outliers", "")
        shown = table(column, lambda value: f"{100 * value:.2f}" if value < 10 else "–")
        for row in shown:
            paper = published.get(row[0])
            row += [f"{part[place_in_paper]:g}" for part in paper] if paper else ["", ""]
        show_table(["", *tracks, "paper, clean", "paper, worst"], shown)
    place.drawn(f"real-{sensor}", lambda target: study.draw(target, rows))


def table_one(place: StudyOutput, runs: int, gyroscope_noise: float) -> None:
    """Reproduce Table I of the MAGYC paper, by this project's conventions and by the authors'."""
    from magyc_gtsam.study import table_one as study

    def spread(values: tuple[float, float, float]) -> str:
        return "–" if values[0] != values[0] else f"{values[0]:.2f} ({values[1]:.2f} to {values[2]:.2f})"

    def printed(cell: MethodOnMotion, column: int) -> str:
        if cell.method not in study.PUBLISHED:
            return ""
        value = study.PUBLISHED[cell.method][cell.motion][column]
        return "N/A" if value is None else f"{value:.3f}"

    ours: list[MethodOnMotion] = []
    for convention in study.CONVENTIONS:
        with place.running(f"{convention}, {runs} runs") as running:
            found = study.table_one(runs, convention=convention, gyroscope_noise=gyroscope_noise, running=running)
        ours = ours or found
        shown = [
            [
                f"{cell.method}, {cell.motion}",
                spread(cell.heading),
                f"{cell.averaged[0]:.2f}",
                printed(cell, 0),
                spread(cell.spread),
                f"{cell.averaged[1]:.1f}",
                printed(cell, 1),
                spread(cell.systematic),
                f"{cell.failed}" if cell.failed else "",
            ]
            for cell in found
        ]
        header = ["median (5 to 95 %)", "heading °", "averaged", "paper", "field mG", "averaged", "paper"]
        show("", f"Conventions: {convention}; averaged: the mean of all runs' parameters", "")
        show_table([*header, "systematic °", "failed"], shown)
    place.drawn("table-one", lambda target: study.draw(target, ours))


def settling(place: StudyOutput, runs: int, gyroscope_noise: float) -> None:
    """Show the share of the data after which MAGYC-IFG no longer changes."""
    from magyc_gtsam.study import settling as study

    rows = place.rows(f"{runs} runs", "settling", study.worked, study.units(runs, gyroscope_noise))
    shown = []
    for motion in study.PUBLISHED["raw"]:
        middle, low, high = np.percentile(Cell(rows, motion=motion).column("share"), [50, 5, 95])
        shown.append([motion, f"{middle:.0%}", f"{low:.0%} to {high:.0%}", "lost"])
    show_table(["magyc-ifg settles after", "median", "5 to 95 %", "paper"], shown)
    place.drawn("settling", lambda target: study.draw(target, rows))


def dive_survey(place: StudyOutput, runs: int) -> None:
    """Reproduce Fig. 3b of the MAGYC paper."""
    from magyc_gtsam.study import dive_survey as study

    rows = place.rows(f"{runs} pairs at each noise", "dive-survey", study.worked, study.units(runs))

    def text(cell: Cell) -> str:
        heading, cost, trusted = (
            np.median(cell.column("heading")),
            np.median(cell.column("cost")),
            cell.mean("trusted"),
        )
        shown = "none" if heading == np.inf else f"{heading:.2f}"
        shown += "" if np.isnan(cost) else f" [{cost:.4f}]"
        return shown + (f" ({trusted:.0%})" if trusted < 1 else "")

    for way in study.WAYS:
        show(
            "",
            f"{way}: heading deviation in °, in [] the cost (7) over that of the truth, in () the share trusted",
            "",
        )
        shown = [
            [method, *(text(Cell(rows, noise=noise, method=method, way=way)) for noise in study.NOISES)]
            for method in dict.fromkeys(row["method"] for row in rows)
        ]
        show_table(["", *(f"{noise:g} × noise" for noise in study.NOISES)], shown)
    show(f"the paper: {study.SAID}")
    place.drawn("dive-survey", lambda target: study.draw(target, rows))


def duration(place: StudyOutput, runs: int) -> None:
    """Show the heading error by minutes of data and amplitude of motion, which no paper has."""
    from magyc_gtsam.study import duration as study

    rows = place.rows(f"{runs} runs a cell", "duration", study.worked, study.units(runs))
    for heading in study.HEADINGS:
        show("", f"heading ±{heading:g}°: root-mean-square heading error ° (stated), in brackets not trusted", "")
        table = []
        for pitch in study.PITCHES:
            row = [f"pitch ±{pitch:g}°"]
            for minutes in study.MINUTES:
                cell = Cell(rows, heading=heading, pitch=pitch, minutes=minutes)
                refused = cell.mean("refused")
                row.append(
                    f"{cell.root('error'):.2f} ({cell.root('stated'):.2f})"
                    + (f" [{refused:.0%}]" if refused else "")
                )
            table.append(row)
        show_table(["", *(f"{minutes:g} min" for minutes in study.MINUTES)], table)
    place.drawn("duration", lambda target: study.draw(target, rows))
