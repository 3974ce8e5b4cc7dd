"""`magyc-gtsam compare`: calibrate one log with every method."""

from __future__ import annotations

import json as json_text
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.files import replacing_folder
from magyc_gtsam.cli.interrupts import noted_interrupts
from magyc_gtsam.cli.known import Scale
from magyc_gtsam.cli.options import with_groups
from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.cli.results import dated_folder, run_description, write_yaml
from magyc_gtsam.cli.terminal import complain, show, show_json, show_page, show_results, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.study.outcome import Comparison


@with_groups
def run(
    context: typer.Context,
    reading: Reading,
    scale: Scale,
    methods: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,C", help="Methods to run, from magyc_gtsam.methods(). Default: all that the log allows."
        ),
    ] = None,
    output: given.Output = None,
    open_page: given.Open = False,
    quiet: given.Quiet = False,
    json: given.Json = False,
) -> int:
    """Compare the results of every method on a log.

    A method that needs a signal that the log lacks is left out. Writes comparison.csv, comparison.json,
    configuration.yaml and report.html. If a method fails, its reason is reported and the others still run; Ctrl-C
    keeps the methods that have finished. Exit code 1: done, but no method gave a trusted result; 130: interrupted.
    """
    from magyc_gtsam.report.compare_page import render_comparison
    from magyc_gtsam.report.compare_words import csv_text, judged_comparison, to_dict
    from magyc_gtsam.storage.files import write_text
    from magyc_gtsam.study.comparison import checked_methods, run_methods
    from magyc_gtsam.study.judging import judge

    field_strength = scale.tesla()
    names = checked_methods(None if methods is None else [name.strip() for name in methods.split(",")])
    folder = output or dated_folder(reading.log, "-compare")
    with replacing_folder(folder) as part, stages(shown=not (quiet or json)) as stage:
        recording = reading.recording(stage("reading"), counts=True)
        bars = {}

        def progress(method: str, share: float) -> None:
            if method not in bars:
                bars[method] = stage(method)
            bars[method](share)

        ran = run_methods(recording, names, field_strength, progress)
        with noted_interrupts() as interrupts:  # so that the finished methods are still written
            comparison = judge(recording, names, ran)
            page = stage("drawing the page")
            (part / "comparison.csv").write_text(csv_text(comparison), encoding="utf-8")
            write_text(part / "comparison.json", json_text.dumps(to_dict(comparison), indent=2) + "\n")
            chosen = {"methods": list(names), "field_strength": field_strength}
            write_yaml(part / "configuration.yaml", run_description(reading, recording, context.obj) | chosen)
            named = replace(comparison, recording=replace(recording, name=reading.log.name))
            write_text(part / "report.html", render_comparison(named))
        page(1.0)
    if open_page:
        show_page(folder / "report.html")
    if json:
        verdict = judged_comparison(comparison).to_dict()
        values = {"sentence": verdict["sentence"], "verdict": verdict, "folder": str(folder)}
        show_json(to_dict(comparison) | values)
    elif not quiet:
        _show(comparison, reading.log.name, folder)
    if comparison.interrupted or interrupts:
        complain(f"interrupted; the methods that had finished are in {folder}")
        return 130
    if comparison.trusted:
        return 0
    complain("no method gave a trusted result; the table has the reasons")
    return 1


def _show(comparison: Comparison, name: str, folder: Path) -> None:
    from magyc_gtsam.report import compare_words as words

    recording = comparison.recording
    show(words.judged_comparison(comparison).sentence)
    show(f"{name}: {recording.duration:.1f} s, {len(comparison.inlier):,} magnetometer samples", "")
    show_table(words.short_header(comparison), words.short_rows(comparison))
    show(
        "",
        *words.footnotes(comparison),
        "Uncertainties, soft iron, gyroscope bias and all reasons are on the page.",
        "",
    )
    show(*words.remarks(comparison))
    show_results(folder, recording.notes)
