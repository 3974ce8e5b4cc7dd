"""`magyc-gtsam study`: Monte-Carlo studies, printed as tables."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from magyc_gtsam.cli.terminal import show, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.study.known import FactCell


class Study(str, Enum):
    """The studies there are."""

    EFFICIENCY = "efficiency"
    TABLE_ONE = "table-one"
    SETTLING = "settling"
    AUTOCAL = "autocal"
    REVIEW = "review"
    GAP = "gap"
    GAP_STRENGTHS = "gap-strengths"
    FAULTS = "faults"
    KNOWN = "known"
    DURATION = "duration"
    LEADERBOARD = "leaderboard"

    __str__ = str.__str__


def run(
    study: Annotated[
        Study,
        typer.Argument(
            metavar="STUDY",
            help="efficiency (error over the Cramér–Rao bound, NEES), table-one (Table I of the MAGYC paper), settling "
            "(share of the data after which magyc-ifg stands still) or "
            "review (Table 2 of the review of magnetometer-only methods; it takes 250 runs), gap (blind test of "
            "the gap workflow), gap-strengths (the strengths of its effects, and how far they stand out), "
            "faults (wrong and trusted, right, or refused under faults of sensors, clocks, surroundings and "
            "motion), known (skews of the chips; an earlier calibration and the field's strength as facts), "
            "duration (heading error against minutes and amplitude), autocal (Fig. 5 and 6 of the Autocal paper, and "
            "one-sided data) or leaderboard (all methods on public recordings, judged on others of the same unit by "
            "optics).",
            show_default=False,
        ),
    ],
    runs: Annotated[int, typer.Option(min=1, help="Random recordings per motion.")] = 100,
    disturbed: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="efficiency: share of seconds with up to 50 µT added.")
    ] = 0.0,
    gyroscope_noise: Annotated[float, typer.Option(metavar="MRAD/S", help="Deviation per sample.")] = 5.0,
    motion: Annotated[
        list[str] | None,
        typer.Option(
            help="gap, faults: may be repeated; default wide, moderate and multi; of faults wide, moderate, low, tiny."
        ),
    ] = None,
    sets: Annotated[
        list[str] | None,
        typer.Option("--set", help="gap: none, single, pair, withheld, foreign; may be repeated; default all."),
    ] = None,
    log: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LOG[@START:END]",
            help="gap: real recording to put effects into, of which seconds START to END; may be repeated.",
        ),
    ] = None,
    edition: Annotated[int, typer.Option(min=0, help="gap: of the seeds.")] = 1,
    foreign: Annotated[
        Path | None,
        typer.Option(
            metavar="MODULE.py",
            help="gap: instead of all else, effects that are in no catalogue: the functions of this Python file.",
        ),
    ] = None,
    fault: Annotated[list[str] | None, typer.Option(help="faults: may be repeated; default all.")] = None,
    by: Annotated[
        list[str] | None, typer.Option(help="faults: batch, online, gap; may be repeated; default all.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="faults, known, duration, leaderboard: processes.")] = 2,
    engine: Annotated[
        str,
        typer.Option(
            metavar="local|tcp://…", help="duration, leaderboard: this machine, or a dask.distributed cluster."
        ),
    ] = "local",
    folder: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="leaderboard: of recordings that are there, or with --base-url where to keep them; default the "
            "user's cache.",
        ),
    ] = None,
    base_url: Annotated[
        str | None,
        typer.Option(
            metavar="URL", help="leaderboard: of a mirror, a folder with registry.txt; default the authors' own."
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(help="leaderboard: may be repeated; default all, those of other packages too."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="gap, faults, known, duration, leaderboard: an interrupted study goes on there; default "
            "results/blindtest, results/faults, results/known, results/duration or results/leaderboard.",
        ),
    ] = None,
) -> int:
    """Run a study and print its table."""
    noise = gyroscope_noise * 1e-3
    if study is Study.EFFICIENCY:
        _efficiency(runs, disturbed, noise)
    elif study is Study.KNOWN:
        _known(output or Path("results/known"), runs, workers)
    elif study is Study.DURATION:
        _duration(output or Path("results/duration"), runs, engine, workers)
    elif study is Study.LEADERBOARD:
        from magyc_gtsam.cli.study_leaderboard import leaderboard

        return leaderboard(output or Path("results/leaderboard"), folder, base_url, method, engine, workers)
    elif study is Study.SETTLING:
        _settling(runs, noise)
    elif study is Study.REVIEW:
        _review(runs)
    elif study is Study.GAP:
        from magyc_gtsam.cli.study_gap import blind_test

        return blind_test(output or Path("results/blindtest"), runs, motion, sets, log or (), edition, foreign)
    elif study is Study.FAULTS:
        from magyc_gtsam.cli.study_faults import faults

        return faults(output or Path("results/faults"), runs, motion, fault or (), by or (), workers)
    elif study is Study.GAP_STRENGTHS:
        from magyc_gtsam.cli.study_gap import strengths

        strengths(runs)
    elif study is Study.AUTOCAL:
        _autocal(runs)
    else:
        _table_one(runs, noise)
    return 0


def _efficiency(runs: int, disturbed: float, gyroscope_noise: float) -> None:
    from magyc_gtsam.simulation import AMPLITUDES
    from magyc_gtsam.study.efficiency import BLOCKS, efficiency

    rows = []
    with stages() as stage:
        for motion in AMPLITUDES:
            result = efficiency(
                motion,
                runs,
                disturbed=disturbed,
                gyroscope_noise=gyroscope_noise,
                progress=stage(f"{motion}, {runs} runs"),
            )
            low, high = result.band
            rows.append(
                [
                    motion,
                    *(f"{result.ratio[block]:.3f}" for block in BLOCKS),
                    f"{result.rmse['hard iron'] * 1e9:.0f}",
                    f"{result.nees:.2f}",
                    f"{low:.2f} to {high:.2f}",
                    f"{result.refused}",
                ]
            )
    show_table(["RMSE / bound", *BLOCKS, "hard iron nT", "NEES", "95 % band", "refused"], rows)


def _known(folder: Path, runs: int, workers: int) -> None:
    from magyc_gtsam.study import known

    with stages() as stage:
        rows = known.known_rows(known.units(runs), folder, workers, stage(f"{runs} runs a cell"))
    table = []
    for motion in known.MOTIONS:
        for skew in known.SKEWS:
            cells = known.skew_cells(motion, skew, rows)
            better = min(cells["never"].heading, cells["always"].heading)
            row = [motion, f"{skew:g}"]
            row += [f"{cells[way].heading:.3f}" for way in known.WAYS] + [f"{cells['asked'].heading / better:.2f}"]
            row += [f"{cells[way].nees:.1f}" for way in known.WAYS]
            table.append([*row, f"{cells['asked'].decided:.0%}"])
    headings = [f"heading °, {way}" for way in known.WAYS] + ["× better"]
    show_table(["motion", "skew °", *headings, *(f"NEES, {way}" for way in known.WAYS), "decided"], table)
    low, high = known.band(runs)
    show(f"NEES of {known.FREEDOMS}, 95 % band {low:.1f} to {high:.1f}", "")
    table = []
    for motion, duration in known.LIMITED:
        for way, cell in known.fact_cells(motion, duration, rows).items():
            table.append([f"{motion} {duration:g} s", way, *_fact(cell)])
    for motion in ("wide", "tiny", "level"):
        for percent in known.PERCENTS:
            table.append(
                [motion, f"matrix off by {percent:g} %", *_fact(known.matrix_cell(motion, percent, rows))]
            )
    show_table(["motion", "known", "hard iron error µT", "stated µT", "error²/σ²", "refused"], table)
    low, high = known.band(runs, 3)
    show(f"error²/σ², 95 % band {low / 3:.2f} to {high / 3:.2f}; rows in {folder / 'known.parquet'}", "")


def _duration(folder: Path, runs: int, engine: str, workers: int) -> None:
    from magyc_gtsam.study import duration

    with stages() as stage:
        rows = duration.duration_rows(duration.units(runs), folder, engine, workers, stage(f"{runs} runs a cell"))
    for heading in duration.HEADINGS:
        found = duration.cells(rows, heading)
        show("", f"heading ±{heading:g}°: root-mean-square heading error ° (stated), in brackets not trusted", "")
        table = []
        for pitch in duration.PITCHES:
            own = [found[pitch, minutes] for minutes in duration.MINUTES]
            texts = [f"{c.error:.2f} ({c.stated:.2f})" + (f" [{c.refused:.0%}]" if c.refused else "") for c in own]
            table.append([f"pitch ±{pitch:g}°", *texts])
        show_table(["", *(f"{minutes:g} min" for minutes in duration.MINUTES)], table)
    duration.draw(folder / "duration.svg", rows)
    show("", f"{folder / 'duration.parquet'}, {folder / 'duration.svg'}")


def _fact(cell: FactCell) -> list[str]:
    return [f"{cell.error * 1e6:.3f}", f"{cell.stated * 1e6:.3f}", f"{cell.ratio:.2f}", f"{cell.refused:.0%}"]


def _table_one(runs: int, gyroscope_noise: float) -> None:
    from magyc_gtsam.study.table_one import PUBLISHED, table_one

    def spread(values: tuple[float, float, float]) -> str:
        return "–" if values[0] != values[0] else f"{values[0]:.2f} ({values[1]:.2f} to {values[2]:.2f})"

    def printed(method: str, value: float | None) -> str:
        return ("N/A" if method in PUBLISHED else "") if value is None else f"{value:.3f}"

    with stages() as stage:
        result = table_one(runs, gyroscope_noise=gyroscope_noise, progress=stage(f"{runs} runs"))
    rows = []
    for row in result:
        heading, field = PUBLISHED.get(row.method, {}).get(row.motion, (None, None))
        rows.append(
            [
                f"{row.method}, {row.motion}",
                spread(row.heading),
                printed(row.method, heading),
                spread(row.spread),
                printed(row.method, field),
                spread(row.systematic),
                f"{row.failed}" if row.failed else "",
            ]
        )
    show_table(["median (5 to 95 %)", "heading °", "paper", "field mG", "paper", "systematic °", "failed"], rows)


def _settling(runs: int, gyroscope_noise: float) -> None:
    from magyc_gtsam.study.settling import settling

    with stages() as stage:
        result = settling(runs, gyroscope_noise=gyroscope_noise, progress=stage(f"{runs} runs"))
    rows = [[row.motion, f"{row.share[0]:.0%}", "{1:.0%} to {2:.0%}".format(*row.share)] for row in result]
    show_table(["magyc-ifg settles after", "median", "5 to 95 %"], rows)


def _review(runs: int) -> None:
    from magyc_gtsam.study.review import PUBLISHED, STRICT, review

    with stages() as stage:
        result, bound = review(runs, progress=stage(f"{runs} runs"))
    reference = result[0].scores.time
    rows = []
    for row in result:
        accuracy, robustness, speed = PUBLISHED[row.method]
        rows.append(
            [
                row.method,
                f"{row.scores.accuracy:.3g}",
                f"{accuracy:.3g}",
                f"{row.scores.robustness:.1%}",
                f"{robustness:.1f}%",
                f"{row.strict.robustness:.1%}",
                f"{row.refused}",
                f"{row.scores.time / reference:.2g}",
                f"{PUBLISHED[result[0].method][2] / speed:.2g}",
            ]
        )
    rows.append(["bound", f"{bound:.3g}", *[""] * 7])
    show_table(
        [
            "",
            "1/ρ",
            "paper",
            "robust",
            "paper",
            f"δ = {STRICT:g}",
            "refused",
            f"time / {result[0].method}",
            "paper",
        ],
        rows,
    )


def _autocal(runs: int) -> None:
    from magyc_gtsam.study.autocal import STUDIES, Score

    def cell(score: Score) -> str:
        error = "–" if score.failed == 1 and not score.median < 10 else f"{100 * score.median:.2f}"
        return error if not score.failed else f"{error} ({score.failed:.0%})"

    with stages() as stage:
        tables = {title: study(runs, stage(title)) for title, study in STUDIES.items()}
    for title, table in tables.items():
        show("", f"{title}: median error in %, in brackets the share of runs that are off by more than 10 %", "")
        names = next(iter(table.values()))
        rows = [[name, *(cell(scores[name]) for scores in table.values())] for name in names]
        show_table(["", *(f"{condition:g}" for condition in table)], rows)
