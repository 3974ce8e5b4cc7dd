"""`magyc-gtsam info`: what is in a log, and whether a recording can be made of it."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.groups import with_groups
from magyc_gtsam.cli.options import spelled
from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.cli.terminal import show, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.io import LogInfo
    from magyc_gtsam.recording import Recording


@with_groups
def run(
    reading: Reading,
    strip: Annotated[
        bool, typer.Option("--strip", help="With --json: strength of the field and turn rate over time as well.")
    ] = False,
    json: given.Json = False,
) -> int:
    """Say what a log holds, how much it turned, and whether it can be read; nothing is calibrated.

    Exit code 0 wherever the file is a log, whatever the answer is.
    """
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
    for source in described.sources:
        span = "" if source.span is None else f"{source.span[0]:.1f}–{source.span[1]:.1f}"
        rate = "" if source.rate is None else f"{source.rate:.1f}"
        rows.append((source.name, source.type, str(source.count), rate, span, ", ".join(source.serves_as)))
    show_table(("source", "type", "samples", "Hz", "s", "serves as"), rows)
    show("", *(f"note: {warning}" for warning in described.warnings))
    if described.problem is not None:
        show(f"can be read: no, {spelled(described.problem)}")
    elif described.turned is None:
        show("can be read: yes, without a gyroscope; see which methods can use it: magyc-gtsam compare")
    else:
        show(f"motion: turned by about {described.turned * 57.29578:.0f}° in all")
        show("can be read: yes; whether the motion suffices is what magyc-gtsam calibrate says")


def _show_json(described: LogInfo, recording: Recording | None) -> None:
    import json

    from magyc_gtsam.report.strip import strip_of

    sources = [asdict(source) | {"rate": source.rate} for source in described.sources]
    result = asdict(described) | {"sources": sources, "readable": described.readable}
    if recording is not None:
        result["strip"] = strip_of(recording)
    typer.echo(json.dumps(result, indent=2))
