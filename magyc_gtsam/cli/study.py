"""`magyc-gtsam study`: Monte-Carlo studies, printed as tables."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.study_options import refuse_unused
from magyc_gtsam.cli.terminal import show, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.study.rows import Cell


class Study(str, Enum):
    """The names of the studies."""

    EFFICIENCY = "efficiency"
    TABLE_ONE = "table-one"
    SETTLING = "settling"
    DIVE_SURVEY = "dive-survey"
    AUTOCAL = "autocal"
    REVIEW = "review"
    REAL_TRACKS = "real-tracks"
    GAP = "gap"
    FAULTS = "faults"
    KNOWN = "known"
    DURATION = "duration"
    LEADERBOARD = "leaderboard"

    __str__ = str.__str__


def run(
    context: typer.Context,
    study: Annotated[
        Study,
        typer.Argument(
            metavar="STUDY",
            help="efficiency (error over the Cramér–Rao bound, NEES), table-one (Table I of the MAGYC paper), settling "
            "(share of the data after which magyc-ifg stands still), dive-survey (its Fig. 3b), "
            "review (Table 2 and Figs 2 to 5 of the review of magnetometer-only methods; it takes 250 runs), "
            "real-tracks (its Fig. 6, and Tables IV and V of the Autocal paper, on logs of one unit), gap (blind test "
            "of the gap workflow), "
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
    gyroscope_noise: Annotated[
        float,
        typer.Option(
            metavar="MRAD/S",
            help="efficiency, settling, table-one: 1σ per sample.",
        ),
    ] = 5.0,
    motion: Annotated[
        list[str] | None,
        typer.Option(
            help="gap, faults: motion to simulate; may be repeated. Default: wide, moderate, multi; for faults wide, "
            "moderate, low and tiny."
        ),
    ] = None,
    sets: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="gap: none, single, pair, withheld or foreign; may be repeated. Default: all.",
        ),
    ] = None,
    log: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LOG[@START:END]",
            help="gap: real recording into which effects are put, from second START to END; may be repeated. "
            "real-tracks: logs of one unit; the others are compared with the first.",
        ),
    ] = None,
    sensor: Annotated[
        str, typer.Option(metavar="magnetometer|accelerometer", help="real-tracks: sensor to calibrate.")
    ] = "magnetometer",
    edition: Annotated[int, typer.Option(min=0, help="gap: number of the set of seeds.")] = 1,
    foreign: Annotated[
        Path | None,
        typer.Option(
            metavar="MODULE.py",
            help="gap: test only the effects that the functions of this Python file add; they are in no catalogue.",
        ),
    ] = None,
    fault: Annotated[
        list[str] | None, typer.Option(help="faults: one to study; may be repeated. Default: all.")
    ] = None,
    strength: Annotated[
        list[str] | None,
        typer.Option(help="faults: slight, weak, between or strong; may be repeated. Default: weak and strong."),
    ] = None,
    by: Annotated[
        list[str] | None,
        typer.Option(help="faults: batch, online or gap; may be repeated. Default: all."),
    ] = None,
    draw: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="faults: only N of the recordings, drawn at random (by --first-seed). Default: all.",
        ),
    ] = None,
    first_seed: Annotated[
        int, typer.Option(min=0, help="efficiency, faults, known: seed of the first recording.")
    ] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Number of processes; efficiency uses one.")] = 2,
    engine: Annotated[
        str,
        typer.Option(
            metavar="local|tcp://…",
            help="This machine, or a Dask cluster; for the papers' studies, known, duration and leaderboard.",
        ),
    ] = "local",
    folder: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="leaderboard: folder that holds the recordings, or with --base-url the one to fetch them into. "
            "Default: the user's cache.",
        ),
    ] = None,
    base_url: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="leaderboard: mirror, a folder with registry.txt. Default: the authors' own.",
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(help="leaderboard: may be repeated. Default: all, including those of other packages."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            parser=given.named_path,
            metavar="DIR",
            help="Folder of results, in which an interrupted study continues. Default: results/STUDY (gap: "
            "results/blindtest). Not used by efficiency.",
        ),
    ] = None,
) -> int:
    """Run a study and print its table."""
    refuse_unused(context, study)
    noise = gyroscope_noise * 1e-3
    if study is Study.EFFICIENCY:
        _efficiency(runs, disturbed, noise, first_seed)
    elif study is Study.KNOWN:
        _known(output or Path("results/known"), range(first_seed, first_seed + runs), engine, workers)
    elif study is Study.LEADERBOARD:
        from magyc_gtsam.cli.study_leaderboard import leaderboard

        return leaderboard(output or Path("results/leaderboard"), folder, base_url, method, engine, workers)
    elif study is Study.GAP:
        from magyc_gtsam.cli.study_gap import blind_test

        where = output or Path("results/blindtest")
        return blind_test(where, runs, motion, sets, log or (), edition, foreign, workers)
    elif study is Study.FAULTS:
        from magyc_gtsam.cli.study_faults import faults

        seeds = range(first_seed, first_seed + runs)
        where = output or Path("results/faults")
        return faults(where, seeds, motion, fault or (), by or (), workers, draw, strength or ())
    else:
        from magyc_gtsam.cli import study_papers as papers

        place = papers.StudyOutput(output or Path(f"results/{study}"), engine, workers)
        if study is Study.SETTLING:
            papers.settling(place, runs, noise)
        elif study is Study.DIVE_SURVEY:
            papers.dive_survey(place, runs)
        elif study is Study.REVIEW:
            papers.review(place, runs)
        elif study is Study.REAL_TRACKS:
            papers.real_tracks(place, log or (), sensor)
        elif study is Study.AUTOCAL:
            papers.autocal(place, runs)
        elif study is Study.DURATION:
            papers.duration(place, runs)
        else:
            papers.table_one(place, runs, noise)
    return 0


def _efficiency(runs: int, disturbed: float, gyroscope_noise: float, first_seed: int) -> None:
    """Show the errors relative to the Cramér–Rao bound, and the NEES."""
    from functools import partial

    from magyc_gtsam.estimators import calibrate
    from magyc_gtsam.simulation import AMPLITUDES
    from magyc_gtsam.study.efficiency import BLOCKS, efficiency

    rows = []
    with stages() as stage:
        for motion in AMPLITUDES:
            for known, method in (("", calibrate), (", aligned", partial(calibrate, misalignment=0))):
                result = efficiency(
                    motion,
                    runs,
                    disturbed=disturbed,
                    gyroscope_noise=gyroscope_noise,
                    method=method,
                    first_seed=first_seed,
                    progress=stage(f"{motion}{known}, {runs} runs"),
                )
                low, high = result.band
                rows.append(
                    [
                        motion + known,
                        *(f"{result.ratio[block]:.3f}" for block in BLOCKS),
                        f"{result.rmse['hard iron'] * 1e9:.0f}",
                        f"{result.nees:.2f}",
                        f"{low:.2f} to {high:.2f}",
                        f"{result.refused}",
                    ]
                )
    show_table(["RMSE / bound", *BLOCKS, "hard iron nT", "NEES", "95 % band", "refused"], rows)
    show("aligned: the chips are known to be aligned (misalignment=0)", "")


def _known(folder: Path, seeds: range, engine: str, workers: int) -> None:
    """Show errors and NEES by skew of the chips, and by prior knowledge."""
    from magyc_gtsam.study import known
    from magyc_gtsam.study.known_facts import FACTS
    from magyc_gtsam.study.rows import Cell, Running, study_rows

    with stages() as stage:
        running = Running(folder, engine, workers, stage(f"{len(seeds)} runs a cell"))
        rows = study_rows("known", known.worked, known.units(seeds), running)
    table = []
    for motion in known.MOTIONS:
        for skew in (*known.SKEWS, None):
            kind = {"kind": "board"} if skew is None else {"kind": "skew", "size": skew}
            cell = Cell(rows, motion=motion, **kind)
            heading = {way: cell.root(f"{way} heading") for way in known.WAYS}
            row = [motion, "as believed" if skew is None else f"{skew:g}"]
            row += [f"{each:.3f}" for each in heading.values()]
            row.append(f"{heading['asked'] / min(heading['never'], heading['always']):.2f}")
            row += [f"{cell.mean(f'{way} nees'):.2f}" for way in known.WAYS]
            table.append([*row, f"{cell.mean('asked of_sensors'):.2f}", f"{cell.mean('asked decided'):.0%}"])
    headings = [f"heading °, {way}" for way in known.WAYS] + ["× better"]
    headings += [*(f"NEES, {way}" for way in known.WAYS), "sensors and skew alone", "decided"]
    show_table(["motion", "skew °", *headings], table)
    low, high = known.band(len(seeds))
    show(f"NEES of {known.FREEDOMS}, 95 % band {low:.2f} to {high:.2f}", "")
    show(
        "as believed: boards drawn as calibrate believes them to be, over which an honest NEES is in the band; "
        "sensors and skew alone: without what else an instrument may do, which these do not",
        "",
    )
    table = []
    for motion, duration in known.LIMITED:
        cell = Cell(rows, kind="fact", motion=motion, size=duration)
        table += [[f"{motion} {duration:g} s", way, *_fact(cell, way)] for way in FACTS]
    for motion in ("wide", "tiny", "level"):
        for percent in known.PERCENTS:
            cell = Cell(rows, kind="matrix", motion=motion, size=percent)
            table.append([motion, f"matrix off by {percent:g} %", *_fact(cell, "wrong")])
    numbers = ["hard iron error µT", "× bound", "stated µT", "error²/σ²", "sensors alone", "refused"]
    show_table(["motion", "known", *numbers], table)
    low, high = known.band(len(seeds), 3)
    show(f"error²/σ², 95 % band {low / 3:.2f} to {high / 3:.2f}; rows in {folder / 'known.parquet'}", "")


def _fact(cell: Cell, way: str) -> list[str]:
    """Return error (µT) and its ratio to the bound, stated deviation (µT), error²/σ² with and without what else an
    instrument may do, and the share refused."""
    error, bound, stated = (cell.root(f"{way} {name}") for name in ("error", "bound", "stated"))
    squares = (f"{cell.mean(f'{way} {name}'):.2f}" for name in ("ratio", "of_sensors"))
    refused = f"{cell.mean(f'{way} refused'):.0%}"
    return [f"{error * 1e6:.3f}", f"{error / bound:.2f}", f"{stated * 1e6:.3f}", *squares, refused]
