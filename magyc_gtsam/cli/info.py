"""`magyc-gtsam info`: describe a log, and show whether it can be read."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.options import with_groups, without_effect
from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.cli.terminal import noted, show, show_json, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.io import LogInfo
    from magyc_gtsam.recording import Recording


@with_groups
def run(
    reading: Reading,
    strip: Annotated[
        bool, typer.Option("--strip", help="With --json: also the field strength and the turn rate over time.")
    ] = False,
    json: given.Json = False,
) -> int:
    """Show what a log holds, and whether it can be read.

    Also shows how far the sensor turned. Nothing is calibrated. Exit code 0 for every file that is a log, also for
    one that cannot be calibrated.
    """
    if strip and not json:
        raise without_effect("--strip", "--json")
    from magyc_gtsam.io import info_and_recording

    with stages(shown=not json) as stage:
        described, recording = info_and_recording(reading.log, **reading.arguments(), progress=stage("reading"))
    if json:
        _show_json(described, recording if strip else None)
    else:
        _show(described)
    return 0


def _show(described: LogInfo) -> None:
    show(f"{described.path}: {described.format}, {described.duration:.1f} s", "")
    rows = []
    unused = [source.name for source in described.sources if not source.serves_as]
    for source in described.sources:
        if not source.serves_as:
            continue
        span = " to ".join(f"{round(t, 1) + 0.0:.1f}" for t in source.span or ())  # never -0.0
        rate = "" if source.rate is None else f"{source.rate:.1f}"
        rows.append((source.name, str(source.count), rate, span, ", ".join(source.serves_as)))
    if rows:
        seconds = "recorded, s" if described.recorded else "s"  # the stamps of the sensors may be of other clocks
        show_table(("source", "samples", "Hz", seconds, "serves as"), rows, words=(4,))
    if unused:
        show("", f"not used: {', '.join(unused)}")
    show("", *noted(described.warnings))
    if described.problem is not None:
        show(f"can be read: no, {described.problem}")
    elif described.turned is None:
        show("can be read: yes, without a gyroscope; `magyc-gtsam compare` runs the methods that need none")
    else:
        show(f"motion: the sensor turned by about {described.turned * 57.29578:.0f}° in total")
        show("can be read: yes; run `magyc-gtsam calibrate` to see whether the motion is sufficient")


def _show_json(described: LogInfo, recording: Recording | None) -> None:
    from magyc_gtsam.report.analysis import strip_of

    sources = [asdict(source) | {"rate": source.rate} for source in described.sources]
    result = asdict(described) | {"sources": sources, "readable": described.readable}
    if recording is not None:
        result["strip"] = strip_of(recording)
    show_json(result)
