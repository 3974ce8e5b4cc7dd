"""Options that several commands share: how a log is read, and how things are written and shown."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from magyc_gtsam.cli.configuration import from_file

# What `magyc_gtsam.read` calls its arguments; its messages name them.
_ARGUMENT = re.compile(r"\b(magnetic_field|angular_rate|acceleration|attitude|stamps|start|end)=(?=(\)?))")
_TABLE_ARGUMENT = re.compile(r"\b(time|time_unit|rate|columns)=")

Log = Annotated[
    Path,
    typer.Argument(metavar="LOG", help="MCAP, text table, PX4 .ulg or ArduPilot .BIN.", show_default=False),
]
CalibrationFile = Annotated[
    Path,
    typer.Argument(metavar="CALIBRATION", help="calibration.yaml of an earlier result.", show_default=False),
]

MagneticField = Annotated[
    str | None,
    typer.Option(metavar="TOPIC", help="Topic, message or columns of the magnetometer; where it is not clear."),
]
AngularRate = Annotated[str | None, typer.Option(metavar="TOPIC", help="Likewise, of the gyroscope.")]
Acceleration = Annotated[str | None, typer.Option(metavar="TOPIC", help="Likewise, of the accelerometer.")]
Attitude = Annotated[
    str | None,
    typer.Option(metavar="TOPIC", help="Likewise, of a reference attitude."),
]
MagneticUnit = Annotated[
    str | None,
    typer.Option(
        metavar="UNIT",
        help="What the log's field is in: T, mT, uT, nT, gauss, mgauss, tesla per count, or (to compare) counts.",
    ),
]
AngularUnit = Annotated[
    str | None, typer.Option(metavar="UNIT", help="Likewise, of the angular rate: rad/s, deg/s, mrad/s.")
]
AccelerationUnit = Annotated[
    str | None, typer.Option(metavar="UNIT", help="Likewise, of the acceleration: m/s^2, g.")
]
Start = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Leave out what is before, counted from the log's first row."),
]
End = Annotated[float | None, typer.Option(metavar="SECONDS", help="Leave out what is after.")]
Stamps = Annotated[
    Literal["header", "log"], typer.Option(help="Time stamps of the sensors, or of the recorder (MCAP).")
]
AngularRateIs = Annotated[
    Literal["instant", "interval-mean"] | None,
    typer.Option(
        help="Rate at its stamp, or mean since the stamp before (delta angles); default: as the log says."
    ),
]
GyroscopeAxes = Annotated[
    str | None,
    typer.Option(
        metavar="AXES",
        help="The gyroscope's axes that lie along the magnetometer's x, y, z, as 'y,-x,z'; the accelerometer "
        "is turned along.",
    ),
]
Read = Annotated[
    list[str] | None,
    typer.Option(metavar="KEY=VALUE", help="Of text tables: time, time_unit, rate, columns. May be repeated."),
]

Misalignment = Annotated[
    str | None,
    typer.Option(
        metavar="DEGREES",
        help="Of the two chips: 'auto' (default) asks the data; a number is the prior's deviation; 0 is none.",
    ),
]
Prior = Annotated[
    Path | None,
    typer.Option(metavar="CALIBRATION", help="calibration.yaml of the same instrument from earlier, as a prior."),
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Write also what must not be trusted: parameters as comments under DO NOT USE."),
]
Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        is_eager=True,
        callback=from_file,
        help="configuration.yaml of an earlier run, for all options (and the LOG) that are not given.",
    ),
]
Open = Annotated[bool, typer.Option("--open", help="Show the page in the browser.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="All details, and the method's own numbers.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no table.")]
Json = Annotated[bool, typer.Option("--json", help="The result as JSON on standard output.")]


def needs_no_log(context: typer.Context, planned: Any) -> Any:
    """What is planned is planned before there is a LOG."""
    log = next(parameter for parameter in context.command.params if parameter.name == "log")
    log.required = planned is None  # for this call: the command may be called again
    return planned


def spelled(message: str) -> str:
    """A message of the library with its arguments spelled as options."""
    text = _ARGUMENT.sub(lambda m: f"--{m[1].replace('_', '-')}{'' if m[2] else ' '}", message)
    return _TABLE_ARGUMENT.sub(r"--read \1=", text)
