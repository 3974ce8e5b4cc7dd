"""`magyc-gtsam gap`: find and name the effects that the model of a log lacks, and show whether adding them helps."""

from __future__ import annotations

import json as json_text
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.files import replacing_folder
from magyc_gtsam.cli.many import many
from magyc_gtsam.cli.options import with_groups
from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.cli.results import dated_folder, run_description, write_yaml
from magyc_gtsam.cli.terminal import (
    Progress,
    concluded,
    noted,
    show,
    show_details,
    show_json,
    show_page,
    show_results,
    show_table,
    stages,
)

if TYPE_CHECKING:
    from magyc_gtsam.gap.result import Gap
    from magyc_gtsam.recording import Recording
    from magyc_gtsam.report.gap_verdict import Validation
    from magyc_gtsam.report.verdict import Verdict

_PLANNED = frozenset({"plan", "quiet", "json"})  # what has an effect on a plan


@with_groups
def run(
    context: typer.Context,
    reading: Reading,
    simulated: Annotated[
        Path | None,
        typer.Option(
            metavar="SIM",
            help="Recording from your own simulator on a similar motion: its assumptions are compared with LOG. "
            "Read with the options of LOG if it has the same format.",
        ),
    ] = None,
    validate: Annotated[
        Path | None,
        typer.Option(
            metavar="OTHER_LOG",
            help="Another log of the same instrument, on which the result is tested. Read with the options of LOG if "
            "it has the same format.",
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="CALIBRATION",
            help="calibration.yaml to start from; parameters that the data contradict are reported. Default: none.",
        ),
    ] = None,
    candidates: Annotated[
        str | None, typer.Option(metavar="A,B,C", help="Effects to look for. Default: the whole catalogue.")
    ] = None,
    plan: Annotated[
        str | None,
        typer.Option(
            metavar="MOTION",
            is_eager=True,
            callback=given.needs_no_log,
            help="Only list which effects a motion can reveal, and from which strength: wide, moderate, low, "
            "tiny, level, ship, multi, dive or survey. Needs no LOG and writes no files.",
        ),
    ] = None,
    more: given.More = None,
    output: given.Output = None,
    open_page: given.Open = False,
    verbose: given.Verbose = False,
    quiet: given.Quiet = False,
    json: given.Json = False,
) -> int:
    """Name the effect that the model lacks, and add it.

    Finds where model and measurement disagree, and shows the gap before and after. Writes gap.json,
    calibration.yaml (with the effects found), configuration.yaml and report.html. The reading options, except
    --start and --end, also apply to SIM and OTHER_LOG if they have the format of LOG. Several logs of one
    instrument are compared with each other: an effect with the same value in all logs belongs to the instrument,
    one with a different value in each log belongs to the place or the day. Exit code 0: nothing was missing, or
    what was missing is now in the model. 1: the gap remains open, the log was not sufficient to look for one, the
    logs are of several instruments, the calibration must not be used, or the result does not hold, or cannot be
    tested, on OTHER_LOG.
    """
    if plan is not None:
        if not _PLANNED.issuperset(given.on_command_line(context)):
            raise typer.BadParameter(
                "needs no LOG and writes no files; leave out all options but --quiet and --json",
                param_hint="--plan",
            )
        return _plan(plan, quiet, json)
    names = None if candidates is None else [name.strip() for name in candidates.split(",")]
    if many(reading.log, more):
        from magyc_gtsam.cli.gap_many import gap_of_logs
        from magyc_gtsam.io.many import find_logs

        if any(value is not None for value in (simulated, validate, calibration)):
            raise typer.BadParameter(
                "--simulated, --validate and --calibration are for one LOG", param_hint="LOGS"
            )
        logs = find_logs([reading.log, *(more or [])])
        return gap_of_logs(reading, logs, names, output, open_page, verbose, quiet, json)
    from magyc_gtsam import Calibration, MagycError, find_gap
    from magyc_gtsam.calibration.elsewhere import on_recording
    from magyc_gtsam.recording.fingerprint import fingerprint, first_shared
    from magyc_gtsam.report.gap_verdict import as_judged, judged_gap

    start = None if calibration is None else Calibration.load(calibration)
    folder = output or dated_folder(reading.log, "-gap")
    with replacing_folder(folder) as part, stages(shown=not (quiet or json)) as stage:
        recording = reading.recording(stage("reading"))
        # Read before the search, which takes long, so that errors appear at once.
        other = None if simulated is None else _beside("--simulated", simulated, reading, stage)
        held_out = None if validate is None else _beside("--validate", validate, reading, stage)
        if held_out is not None and first_shared(fingerprint(held_out), [fingerprint(recording)]) is not None:
            raise MagycError(f"--validate: {validate} holds samples of LOG, which prove nothing; give another log")
        gap = find_gap(
            recording, calibration=start, simulated=other, candidates=names, progress=stage("searching")
        )
        validation, unjudged = None, ""
        if validate is not None and held_out is not None:
            try:
                validation = _validation(validate, held_out, gap, stage("validating"))
            except MagycError as problem:  # the result on LOG remains valid
                unjudged = f"{validate.name}: {problem}"
        verdict = judged_gap(gap, validation, unjudged)
        gap = as_judged(gap, verdict)
        page = stage("drawing the page")
        files = {"simulated": simulated, "validate": validate, "calibration": calibration}
        chosen = {"candidates": names} | {k: None if v is None else str(v) for k, v in files.items()}
        write_yaml(part / "configuration.yaml", run_description(reading, recording, context.obj) | chosen)
        _write_result(part, replace(recording, name=reading.log.name), gap, validation, verdict)
        page(1.0)
    if open_page:
        show_page(folder / "report.html")
    if json:
        show_json(_values(gap, validation, verdict) | {"folder": str(folder)})
    elif not quiet:
        show(verdict.sentence, f"{reading.log.name}: {recording.duration:.1f} s", "")
        show_details(verdict, verbose)
        if verdict.details:
            show("")
        _show(gap, validation, verbose)
        show(*(f"left out: {fault}" for fault in gap.diagnostics["left_out"]))
        show_results(folder, (*recording.notes, *on_recording(start, recording)[1]))
    return concluded(verdict, shown=not (quiet or json))


def _write_result(
    folder: Path, recording: Recording, gap: Gap, validation: Validation | None, verdict: Verdict
) -> None:
    """Write gap.json, calibration.yaml and report.html."""
    from magyc_gtsam.report.gap_page import render_gap
    from magyc_gtsam.storage.files import write_text

    values = json_text.dumps(_values(gap, validation, verdict), indent=2, ensure_ascii=False)
    write_text(folder / "gap.json", values + "\n")
    gap.calibration.save(folder / "calibration.yaml")
    write_text(folder / "report.html", render_gap(recording, gap, validation, verdict))


def _beside(option: str, log: Path, reading: Reading, stage: Callable[[str], Progress]) -> Recording:
    """Read another log, with the options of LOG if it has the same format; --start and --end apply only to LOG."""
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.gap.model.base import needs_gyroscope
    from magyc_gtsam.io import same_format

    hint = ""
    try:
        if same_format(log, reading.log):
            beside, hint = replace(reading, log=log, start=None, end=None), " ({} is read by LOG's options)"
        else:
            # Only the options that describe the instrument apply to another format.
            beside = Reading(log, gyroscope_axes=reading.gyroscope_axes, angular_rate_is=reading.angular_rate_is)
            hint = " ({} has another format than LOG, whose columns, units and --read do not apply to it)"
        recording = beside.recording(stage(f"reading {log.name}"))
        needs_gyroscope(recording)
        return recording
    except MagycError as problem:
        raise MagycError(f"{option}: {problem}{hint.format(option)}") from None


def _plan(motion: str, quiet: bool, json: bool) -> int:
    """Show the isolability table of a motion."""
    from magyc_gtsam.simulation import simulate
    from magyc_gtsam.simulation.environment import CHANNELS

    recording = simulate(motion, channels=CHANNELS).recording
    from magyc_gtsam.gap.isolability import isolability
    from magyc_gtsam.report.gap_words import PLAN, plan_rows
    from magyc_gtsam.storage.json_types import json_types

    table = isolability(recording)
    if json:
        show_json({"motion": motion, "effects": json_types(table)})
    elif not quiet:
        show(
            f"{motion}: what 600 s at 10 Hz of this motion could name (magnetometer 1 µT, gyroscope 5 mrad/s per "
            "sample)",
            "",
        )
        show_table(PLAN, plan_rows(table))
        show(
            "",
            "named as: at the larger of the two strengths; “or”: the effect that it is most often confused with, and "
            "in which share of the cases",
        )
    return 0


def _validation(log: Path, recording: Recording, gap: Gap, progress: Any) -> Validation:
    """Test the model before and after on another log."""
    from magyc_gtsam.calibration.elsewhere import elsewhere
    from magyc_gtsam.gap.validation import SWEPT, agreement, differences, swept
    from magyc_gtsam.report.gap_verdict import Validation

    found = agreement(recording, gap.base, *([] if gap.after is gap.before else [gap.calibration]))
    progress(0.6)
    sweep, strength = swept(recording), gap.calibration.field_strength
    assert strength is not None  # a calibration without it agrees with nothing
    differing = differences(recording, gap.calibration) if sweep >= SWEPT * strength else ()
    progress(1.0)
    return Validation(log.name, sweep, found[0], found[-1], differing, tuple(elsewhere(gap.calibration)[1]))


def _values(gap: Gap, validation: Validation | None, judged: Verdict) -> dict[str, Any]:
    from magyc_gtsam.storage.json_types import json_types

    values: dict[str, Any] = json_types(gap)
    return values | {"judgement": judged.to_dict(), "validation": json_types(validation)}


def _show(gap: Gap, validation: Validation | None, every: bool) -> None:
    """Show probabilities, metrics and the next manoeuvre; with `every` also the evidence of each hypothesis."""
    from magyc_gtsam.report import gap_words as words

    if gap.verdict == "not enough information":
        return
    show(words.probability_sentence(gap), "")
    if every:
        show("Evidence of each hypothesis, added alone to the twelve-parameter model:")
        show_table(words.HYPOTHESES, words.hypothesis_rows(gap.hypotheses), words=(1,))
        show("")
    if gap.effects:
        show(*words.confusion_sentences(gap), "")
    if gap.untested and every:
        show(*(f"not tested: {c.label}: {c.reason}" for c in gap.untested), "")
    elif gap.untested:
        show(f"not tested, no channel in the log: {', '.join(c.label for c in gap.untested)}", "")
    show_table(words.METRICS, words.metric_rows(gap.before, gap.after))
    if validation is not None:
        show("", f"on {validation.name}:")
        show_table(words.METRICS, words.metric_rows(validation.before, validation.after))
        if validation.differences:
            show_table(words.DIFFERS, words.moved_rows(validation.differences))
        show(*noted([words.by_label(note) for note in validation.notes]))
    rejected = [a.sentence for a in gap.assumptions if a.rejected]
    if gap.assumptions:
        compared = sum(a.compared for a in gap.assumptions)
        show("", f"your simulator: {len(rejected)} of {compared} assumptions rejected")
        show(*(f"  {sentence}" for sentence in rejected))
        show(*(f"  {a.sentence}" for a in gap.assumptions if not a.compared))
    if gap.next_manoeuvre is not None:
        show("", f"next: {gap.next_manoeuvre.sentence}")
