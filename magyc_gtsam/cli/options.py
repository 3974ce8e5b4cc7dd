"""Options that several commands share, for reading logs and for output."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from magyc_gtsam.cli.configuration import from_file

Log = Annotated[
    Path,
    typer.Argument(
        metavar="LOG",
        help="MCAP, ROS bag, PX4, ArduPilot, MAVLink, Blackbox, phone archive or text table.",
        show_default=False,
    ),
]
More = Annotated[
    list[Path] | None,
    typer.Argument(metavar="[LOG|FOLDER]...", help="More logs, folders or patterns.", show_default=False),
]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="DIR",
        help="Folder of the results. Default: a new one in results/, named by log, command, date and time.",
    ),
]
MethodOptions = Annotated[
    list[str] | None,
    typer.Option(metavar="KEY=VALUE", help="Another option of the method. May be repeated."),
]
Engine = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS", help="'local' processes, or the address of a Dask scheduler (tcp://host:8786)."
    ),
]
CalibrationFile = Annotated[
    Path,
    typer.Argument(metavar="CALIBRATION", help="calibration.yaml of an earlier result.", show_default=False),
]

MagneticField = Annotated[
    str | None,
    typer.Option(
        metavar="TOPIC", help="Topic, message or columns of the magnetometer, where the log has several."
    ),
]
AngularRate = Annotated[str | None, typer.Option(metavar="TOPIC", help="The same for the gyroscope.")]
Acceleration = Annotated[str | None, typer.Option(metavar="TOPIC", help="The same for the accelerometer.")]
Attitude = Annotated[
    str | None,
    typer.Option(metavar="TOPIC", help="The same for a reference attitude."),
]
MagneticUnit = Annotated[
    str | None,
    typer.Option(
        metavar="UNIT",
        help="Unit of the field in the log: T, mT, uT, nT, gauss, mgauss, tesla per count, or (to compare) counts.",
    ),
]
AngularUnit = Annotated[
    str | None, typer.Option(metavar="UNIT", help="Unit of the angular rate: rad/s, deg/s, mrad/s.")
]
AccelerationUnit = Annotated[str | None, typer.Option(metavar="UNIT", help="Unit of the acceleration: m/s^2, g.")]
Start = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Use the log from this time on, in seconds after its first row."),
]
End = Annotated[float | None, typer.Option(metavar="SECONDS", help="Use the log up to this time.")]
Stamps = Annotated[
    Literal["header", "log"],
    typer.Option(help="Use the time stamps of the messages, or those of the recorder (MCAP)."),
]
AngularRateIs = Annotated[
    Literal["instant", "interval-mean"] | None,
    typer.Option(
        help="Rate at the time stamp, or mean since the previous stamp (delta angles). Default: as given in the log."
    ),
]
GyroscopeAxes = Annotated[
    str | None,
    typer.Option(
        metavar="AXES",
        help="Gyroscope axes along the magnetometer's x, y, z, for example 'y,-x,z'; the accelerometer is rotated "
        "likewise.",
    ),
]
Read = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY=VALUE", help="How to read a text table: time, time_unit, rate, columns. May be repeated."
    ),
]

Misalignment = Annotated[
    str | None,
    typer.Option(
        metavar="DEGREES",
        help="Between the two chips: 'auto' (default) estimates it; a number is its prior standard deviation; 0: none.",
    ),
]
GyroscopeScale = Annotated[
    float | None,
    typer.Option(
        metavar="PERCENT",
        help="Estimate the scale of each of the gyroscope's axes with this prior standard deviation. Default: no.",
    ),
]
HardIronWalk = Annotated[
    float | None,
    typer.Option(metavar="µT", help="Possible change (1σ) of the hard iron since --prior. Default: 0."),
]
Prior = Annotated[
    Path | None,
    typer.Option(
        metavar="CALIBRATION",
        help="calibration.yaml of an earlier result for the same instrument, used as a prior.",
    ),
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Also write an untrusted result: parameters as comments below DO NOT USE."),
]
Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        is_eager=True,
        callback=from_file,
        help="configuration.yaml of an earlier run: supplies the options and the LOG that are not given.",
    ),
]
Open = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Show all details and the diagnostics of the method.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print neither progress nor result.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output.")]


def needs_no_log(context: typer.Context, planned: Any) -> Any:
    """Make LOG optional if a plan is requested; the callback of --plan."""
    log = next(parameter for parameter in context.command.params if parameter.name == "log")
    log.required = planned is None  # set in either case, as a process can run the command again
    return planned


def without_effect(option: str, needs: str) -> typer.BadParameter:
    """Return the error for an option that does nothing without another."""
    return typer.BadParameter(f"has no effect without {needs}; leave it out", param_hint=option)
