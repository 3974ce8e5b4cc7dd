"""`magyc-gtsam export`: write a calibration as parameters of an autopilot, instrument or driver."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.files import replacing
from magyc_gtsam.cli.results import exported
from magyc_gtsam.cli.terminal import complain, concluded, refused, show, show_table


def run(
    calibration_file: given.CalibrationFile,
    target: Annotated[
        Literal["px4", "ardupilot", "vectornav", "ros"],
        typer.Argument(metavar="TARGET", help="px4, ardupilot, vectornav or ros.", show_default=False),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", parser=given.named_path, metavar="FILE", help="Default: standard output."),
    ] = None,
    per_motor: Annotated[
        bool,
        typer.Option(
            "--per-motor", help="The current channels are the outputs, 0 to 1, of motors 1 to 4 (ArduPilot)."
        ),
    ] = False,
    battery_voltage: Annotated[
        float | None,
        typer.Option(
            min=0.0, metavar="V", help="Of the battery in the log, by which ArduPilot multiplies the outputs."
        ),
    ] = None,
    write: Annotated[
        str | None,
        typer.Option(
            metavar="mavlink://ADDRESS",
            help="Write the parameters to the vehicle there (ArduPilot, PX4): they are listed beside the present ones, "
            "written after you confirm, and read back.",
        ),
    ] = None,
    force: given.Force = False,
) -> int:
    """Write a calibration as parameters to paste, or to a vehicle.

    An untrusted calibration is refused with exit code 1 and the reason, and is never written to a vehicle.
    """
    if per_motor and target != "ardupilot":
        raise given.without_effect("--per-motor", "the target ardupilot")
    if battery_voltage is not None and not per_motor:
        raise given.without_effect("--battery-voltage", "--per-motor")
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.report.verdict import judged

    calibration = Calibration.load(calibration_file)
    if not calibration.trusted and (write is not None or not force):
        return refused(judged(calibration).reason)
    text = exported(calibration, target, force=force, per_motor=per_motor, battery_voltage=battery_voltage)
    if write is not None:
        return _write(text, target, write)
    if output is None:
        typer.echo(text, nl=False)
    else:
        with replacing(output) as part:
            part.write_text(text, encoding="utf-8")
    return concluded(judged(calibration))


def _write(text: str, target: str, address: str) -> int:
    """List the parameters, ask for confirmation, write them, compare the values read back; return the exit code."""
    from magyc_gtsam.live.mavlink_parameters import VehicleParameters, is_that, settings_of

    vehicle = VehicleParameters(address, target)
    try:
        settings = settings_of(text, target)
        before = [vehicle.read(setting.name) for setting in settings]
        values = [("no such parameter" if old is None else f"{old:.8g}") for old in before]
        rows = [[s.name, old, f"{s.value:.8g}"] for s, old in zip(settings, values, strict=True)]
        show(*(line.removeprefix("# ") for line in text.splitlines() if line.startswith("#")), "")
        show_table(("parameter", "on the vehicle", "to be written"), rows)
        try:
            agreed = typer.confirm(f"Write these {len(settings)} parameters to the vehicle?")
        except typer.Abort:  # Ctrl-C, or no input
            agreed = False
        if not agreed:
            show("nothing was written")
            return 1
        wrong = [s.name for s in settings if not is_that(vehicle.write(s), s.value)]
    finally:
        vehicle.close()
    if wrong:
        complain(
            f"the vehicle did not accept {len(wrong)} of {len(settings)} parameters ({', '.join(wrong)}); restart it, "
            "so that it shows parameters that were enabled, and write them again"
        )
        return 1
    show(f"{len(settings)} parameters written and confirmed; restart the vehicle")
    return 0
