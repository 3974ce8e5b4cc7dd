"""`magyc-gtsam online`: calibrate while the vehicle moves, from a growing log, a pipe, a socket or a port."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.known import Scale
from magyc_gtsam.cli.options import with_groups
from magyc_gtsam.cli.reading import parse_pairs, parse_unit

if TYPE_CHECKING:
    from magyc_gtsam.online import OnlineCalibrator

_METHOD = "smoother"
_FILE_IDLE = 60.0  # s without growth after which a file counts as complete


@with_groups
def run(
    log: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="MCAP file, which may still be written; the folder of a ROS 2 bag, a .bag, .db3, text table or phone "
            "archive, which is complete; - for JSON lines on standard input: "
            '{"time": s, "magnetic_field": [x, y, z], "angular_rate": [x, y, z]}; or udp://[HOST]:PORT, '
            "serial://PORT?baud=N, mavlink://udpin:HOST:PORT (or tcp:…, or a port), ros2://.",
            show_default=False,
        ),
    ],
    scale: Scale,
    method: Annotated[str | None, typer.Option(help="smoother (the default) or magyc-ifg.")] = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            parser=given.named_path,
            metavar="FILE",
            help="Where to write the calibration, .yaml or .json.",
        ),
    ] = Path("online-calibration.yaml"),
    state: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="State file: loaded if it exists, and saved for the next run."),
    ] = None,
    every: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            min=0.1,
            help="Interval between reports; calibration and state are written with each.",
        ),
    ] = 10.0,
    idle: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=0.0,
            help="Stop after this time without new data. Default: 60 for a file; never for other sources.",
        ),
    ] = None,
    magnetic_field: given.MagneticField = None,
    angular_rate: given.AngularRate = None,
    magnetic_unit: given.MagneticUnit = None,
    angular_unit: given.AngularUnit = None,
    stamps: given.Stamps = "header",
    read: given.Read = None,
    angular_rate_is: given.AngularRateIs = None,
    gyroscope_axes: given.GyroscopeAxes = None,
    misalignment: given.Misalignment = None,
    prior: given.Prior = None,
    hard_iron_walk: given.HardIronWalk = None,
    option: given.MethodOptions = None,
    quiet: given.Quiet = False,
    json: Annotated[
        bool, typer.Option("--json", help="Print each report as one line of JSON on standard output.")
    ] = False,
    picture: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=0.1,
            help="With --json: also print a line at this interval with directions visited, next move and residual.",
        ),
    ] = None,
) -> int:
    """Calibrate while the vehicle moves.

    Stops at the end of the file or input, after --idle seconds without new data, or with Ctrl-C. The calibration is
    written at the end and with every report. Exit code 0: converged; 1: the result must not be trusted yet, or no
    sample of this run was used, and the reason is printed; 2: the input cannot be used, as where the axes or units of
    the sensors disagree; 130: interrupted before a first result.
    """
    from magyc_gtsam.cli.known import beforehand
    from magyc_gtsam.cli.online_feed import Feed
    from magyc_gtsam.cli.online_session import Session
    from magyc_gtsam.cli.online_view import view
    from magyc_gtsam.io.request import Request
    from magyc_gtsam.io.units import is_counts
    from magyc_gtsam.live.address import is_file, open_source

    if output.suffix not in (".yaml", ".yml", ".json"):
        raise typer.BadParameter(f"must end in .yaml or .json, got {output}", param_hint="--output")
    if state is not None and state.resolve() == output.resolve():
        raise typer.BadParameter(f"{state} is the --output too; give two files", param_hint="--state")
    if magnetic_unit is not None and is_counts("magnetic_field", magnetic_unit):
        raise typer.BadParameter(
            "a calibration needs the field in tesla; give the tesla per count", param_hint="--magnetic-unit"
        )
    if picture is not None and not json:
        raise given.without_effect("--picture", "--json")
    from magyc_gtsam.recording.axes import axes_text, parse_axes

    request = Request(
        sensors={"magnetic_field": magnetic_field, "angular_rate": angular_rate},
        units={"magnetic_field": parse_unit(magnetic_unit), "angular_rate": parse_unit(angular_unit)},
        stamps=stamps,
        options=parse_pairs("--read", read),
    )
    place = scale.place() if method in (None, _METHOD) else None
    options: dict[str, Any] = {"field_strength": scale.tesla()} if place is None else {"field": list(place)}
    options["angular_rate_is"] = angular_rate_is
    options["gyroscope_axes"] = None if gyroscope_axes is None else axes_text(parse_axes(gyroscope_axes))
    options = {k: v for k, v in options.items() if v is not None} | parse_pairs("--option", option)
    options |= beforehand(misalignment, prior, hard_iron_walk)
    feed = Feed(_calibrator(state, method, options))
    if idle is None and is_file(log):
        idle = _FILE_IDLE
    with (
        closing(open_source(log, request)) as source,
        view(source, feed, quiet=quiet, json=json, picture=picture) as shown,
    ):
        session = Session(source, feed, output=output, state=state, every=every, idle=idle, view=shown)
        session.run()
    return shown.conclude(session)


def _calibrator(state: Path | None, method: str | None, options: dict[str, Any]) -> OnlineCalibrator:
    """Return a new calibrator, or the one that was saved in `state`."""
    from magyc_gtsam import MagycError, OnlineCalibrator

    if state is None or not state.exists():
        try:
            return OnlineCalibrator(_METHOD if method is None else method, **options)
        except TypeError as error:
            raise MagycError(f"--option: the method cannot use it ({error})") from None
    online = OnlineCalibrator.load(state)
    if method not in (None, online.method) or any(online.options.get(k) != v for k, v in options.items()):
        saved = {k: "…" if k == "prior" else v for k, v in online.options.items()}
        listed = " ".join(f"--option {k}={v}" for k, v in saved.items())
        raise MagycError(
            f"--state {state}: continues a run with --method {online.method} {listed}".rstrip()
            + "; leave method and options out, or name another file"
        )
    return online
