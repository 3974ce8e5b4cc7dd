"""Options that several commands share: alone, in groups (a dataclass whose fields are options), and from --config."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

CONFIGURED = "configured"  # key of `Context.meta`: arguments of the method that are no defaults of options
CHECKSUM = "checksum"  # key of `Context.meta`: SHA-256 of the log of --config; None if unknown
_WITH_OPTION = ("robust", "window", "noise", "delay", "field_strength")


def from_file(context: typer.Context, path: Path | None) -> Path | None:
    """Use the options in the file as defaults of those that are not given; the callback of --config."""
    if path is None:
        return None
    context.default_map, context.meta[CONFIGURED], context.meta[CHECKSUM] = _defaults(path)
    return path


def _defaults(path: Path) -> tuple[dict[str, Any], dict[str, Any], str | None]:
    """Return the options of `calibrate` by their names, the other arguments and the log's SHA-256, if it is known."""
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.storage.mapping import load_mapping

    try:
        values = load_mapping(path, "configuration")
    except MagycError as problem:
        raise MagycError(f"--config: {problem}; name a configuration.yaml that calibrate wrote") from None
    if not isinstance(values.get("reading"), dict) or "method" not in values:
        raise MagycError(
            f"--config: {path}: 'reading' or 'method' is missing; name a configuration.yaml that calibrate wrote"
        )
    options = values.get("options") or {}
    if not isinstance(options, dict):
        raise MagycError(f"--config: {path}: options must be a mapping of names to values, got {options!r}")
    try:
        others = {name: value for name, value in options.items() if name not in _WITH_OPTION}
        log = values.get("log")
        checksum = log.get("sha256") if isinstance(log, dict) else None
        return {**values["reading"], "method": values["method"], **_as_options(options)}, others, checksum
    except (TypeError, ValueError) as problem:
        raise MagycError(f"--config: {path}: an option has the wrong type ({problem})") from None


def _as_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Convert arguments of `magyc_gtsam.calibrate`, in SI units, to options in the units of the command line."""
    result: dict[str, Any] = {name: options[name] for name in ("robust", "window") if name in options}
    if "noise" in options:
        magnetometer, gyroscope = options["noise"]
        result["noise"] = (magnetometer * 1e6, gyroscope * 1e3)
    if "delay" in options:
        result["delay"] = repr(options["delay"] * 1e3)
    if "field_strength" in options:
        result["field_strength"] = options["field_strength"] * 1e6
    return result


def with_groups(command: Callable[..., int]) -> Callable[..., int]:
    """Decorate a command for typer: a parameter that is a dataclass is replaced by options for its fields."""
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    types: dict[str, Any] = {}
    # Not get_type_hints, which before Python 3.11 hides options behind implicit Optional.
    annotations = inspect.get_annotations(command, eval_str=True)
    for name, parameter in inspect.signature(command).parameters.items():
        annotation = annotations[name]
        if isinstance(annotation, type) and is_dataclass(annotation):
            groups[name] = annotation
            types |= inspect.get_annotations(annotation, eval_str=True)
            parameters += inspect.signature(annotation).parameters.values()
        else:
            types[name] = annotation
            parameters.append(parameter)

    @wraps(command)
    def run(**arguments: Any) -> int:
        grouped = {
            name: group(**{field: arguments.pop(field) for field in group.__dataclass_fields__})
            for name, group in groups.items()
        }
        return command(**grouped, **arguments)

    signature = [p.replace(kind=p.KEYWORD_ONLY, annotation=types[p.name]) for p in parameters]
    run.__signature__ = inspect.Signature(signature)  # type: ignore[attr-defined]
    run.__annotations__ = types
    return run


def check_configured_log(context: typer.Context, log: Path, config: Path | None) -> str:
    """Return a remark if the log is not the one of --config but was given on the command line; "" otherwise.

    Raises:
        MagycError: it is not the one of --config, whose path it has, and was not given on the command line.
    """
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.storage.files import sha256

    known = context.meta.get(CHECKSUM)
    if known is None or not log.exists() or sha256(log) == known:
        return ""
    source = context.get_parameter_source("log")
    if source is not None and source.name == "COMMANDLINE":
        return f"{log} is not the log of {config}, only its options are used"
    raise MagycError(
        f"--config: {log} has changed since {config} was written (its sha256 is another), so that the run cannot be "
        f"repeated; restore the log, or name it if another one is meant (magyc-gtsam calibrate {log} --config {config})"
    )


Log = Annotated[
    Path,
    typer.Argument(
        metavar="LOG",
        help="MCAP, ROS bag (of ROS 2 its folder), PX4, ArduPilot, MAVLink, Blackbox, phone archive or text table.",
        show_default=False,
    ),
]


def named_path(text: str) -> Path:
    """Return the path of an option; the parser of options that name a result."""
    if not text:
        raise typer.BadParameter("must be a path, got ''")
    return Path(text)


More = Annotated[
    list[Path] | None,
    typer.Argument(metavar="[LOG|FOLDER]...", help="More logs, folders or patterns.", show_default=False),
]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        parser=named_path,
        metavar="DIR",
        help="Folder of the results; replaces those of earlier runs in it. Default: a new one in results/, named by "
        "log, command, date and time.",
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
    typer.Option(help="Use the time stamps of the messages, or those of the recorder (MCAP, bags, .tlog)."),
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


def on_command_line(context: typer.Context) -> list[str]:
    """Return the names of the parameters that were given on the command line."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    return [name for name, source in sources.items() if source is not None and source.name == "COMMANDLINE"]


def without_effect(option: str, needs: str) -> typer.BadParameter:
    """Return the error for an option that does nothing without another."""
    return typer.BadParameter(f"has no effect without {needs}; leave it out", param_hint=option)
