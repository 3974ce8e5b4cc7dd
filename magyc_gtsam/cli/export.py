"""`magyc-gtsam export`: a calibration in the words of a target."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.calibrate import verdict
from magyc_gtsam.cli.files import replacing


def run(
    calibration_file: given.CalibrationFile,
    target: Annotated[
        Literal["px4", "ardupilot", "vectornav", "ros"],
        typer.Argument(help="Whose parameters.", show_default=False),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Default: standard output.")
    ] = None,
) -> int:
    """Write a calibration as parameters to paste."""
    from magyc_gtsam.calibration import Calibration

    calibration = Calibration.load(calibration_file)
    text = calibration.export(target)
    if output is None:
        typer.echo(text, nl=False)
    else:
        with replacing(output) as part:
            part.write_text(text, encoding="utf-8")
    return verdict(calibration)
