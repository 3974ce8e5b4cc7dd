"""`magyc-gtsam export`: a calibration in the words of a target."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.files import replacing
from magyc_gtsam.cli.terminal import concluded, refused


def run(
    calibration_file: given.CalibrationFile,
    target: Annotated[
        Literal["px4", "ardupilot", "vectornav", "ros"],
        typer.Argument(help="Format of the parameters.", show_default=False),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Default: standard output.")
    ] = None,
    per_motor: Annotated[
        bool,
        typer.Option(
            "--per-motor", help="The current channels are the outputs, 0 to 1, of motors 1 to 4 (ArduPilot)."
        ),
    ] = False,
    force: given.Force = False,
) -> int:
    """Write a calibration as parameters to paste.

    An untrusted calibration is refused with exit code 1 and the reason.
    """
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.report.verdict import judged

    calibration = Calibration.load(calibration_file)
    if not calibration.trusted and not force:
        return refused(calibration)
    text = calibration.export(target, force=force, per_motor=per_motor)
    if output is None:
        typer.echo(text, nl=False)
    else:
        with replacing(output) as part:
            part.write_text(text, encoding="utf-8")
    return concluded(judged(calibration))
