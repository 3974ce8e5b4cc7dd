"""`magyc-gtsam calibrate`: a log in; parameters, a page and files to paste out."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.accelerometer import calibrate_accelerometer
from magyc_gtsam.cli.files import replacing_folder
from magyc_gtsam.cli.groups import with_groups
from magyc_gtsam.cli.reading import Reading, parse_pairs
from magyc_gtsam.cli.results import dated_folder, write_configuration, write_exports, write_page
from magyc_gtsam.cli.scale import Scale
from magyc_gtsam.cli.terminal import show, show_calibration, stages

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.cli.terminal import Progress
    from magyc_gtsam.recording import Recording


@with_groups
def run(
    context: typer.Context,
    reading: Reading,
    scale: Scale,
    method: Annotated[str, typer.Option(help="One of magyc_gtsam.methods().")] = "smoother",
    sensor: Annotated[
        Literal["magnetometer", "accelerometer"],
        typer.Option(help="What to calibrate; the accelerometer by gravity, with --option gravity=9.81."),
    ] = "magnetometer",
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Default: results/<log>-<date>-<time>."),
    ] = None,
    noise: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="µT MRAD/S",
            help="Deviation per sample of magnetometer and gyroscope. Default: estimated.",
        ),
    ] = None,
    delay: Annotated[
        str | None,
        typer.Option(metavar="MS", help="By which the magnetometer lags the gyroscope, or 'auto' (the default)."),
    ] = None,
    robust: Annotated[
        bool | None,
        typer.Option("--robust/--no-robust", help="Weigh disturbed windows down. Default: as the method does."),
    ] = None,
    window: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Longest window. Default: as the method has it.")
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Another option of the method. May be repeated."),
    ] = None,
    quiet: given.Quiet = False,
    json: given.Json = False,
) -> int:
    """Calibrate the sensors of a log.

    Writes calibration.yaml, configuration.yaml, report.html and the parameters to paste.
    Exit code 1: done, but the result must not be trusted; the reason is printed.
    """
    options = _method_options(scale.tesla(), noise, delay, robust, window, option)
    if sensor == "accelerometer":
        return calibrate_accelerometer(reading, method, options, output, context.obj, quiet, json)
    folder = output or dated_folder(reading.log)
    with replacing_folder(folder) as part, stages(shown=not (quiet or json)) as stage:
        recording = reading.recording(stage("reading"))
        calibration = _calibrate(recording, method, stage("calibrating"), options, option)
        page = stage("drawing the page")
        calibration.save(part / "calibration.yaml")
        write_configuration(part, reading, recording, calibration, options, context.obj)
        write_exports(part, calibration)
        write_page(part, recording, calibration)
        page(1.0)
    if json:
        _show_json(folder, calibration)
    elif not quiet:
        show(f"{reading.log.name}: {recording.duration:.1f} s, {calibration.method}", "")
        show_calibration(calibration)
        show(
            *(f"note: {note}" for note in recording.notes),
            "",
            f"results: {folder}",
            f"page: {folder / 'report.html'}",
        )
    return verdict(calibration)


def verdict(calibration: Calibration) -> int:
    """The exit code of a calibration; says on standard error why one must not be trusted."""
    if calibration.trusted:
        return 0
    reason = calibration.message or "the method did not converge"
    typer.echo(f"magyc-gtsam: the result must not be trusted: {reason}", err=True)
    return 1


def _calibrate(
    recording: Recording, method: str, progress: Progress, options: dict[str, Any], pairs: list[str] | None
) -> Calibration:
    from magyc_gtsam import MagycError, calibrate

    try:
        calibration: Calibration = calibrate(recording, method, progress=progress, **options)
    except TypeError as error:
        if pairs is None:
            raise
        raise MagycError(f"--option {' '.join(pairs)}: the method cannot use it ({error})") from None
    return calibration


def _method_options(
    field_strength: float | None,
    noise: tuple[float, float] | None,
    delay: str | None,
    robust: bool | None,
    window: float | None,
    pairs: list[str] | None,
) -> dict[str, Any]:
    """Arguments of `magyc_gtsam.calibrate`; what was not asked for is left to the method."""
    from magyc_gtsam.factors.errors import MagycError

    options: dict[str, Any] = {"field_strength": field_strength, "robust": robust, "window": window}
    if noise is not None:
        if not min(noise) > 0 or not max(noise) < math.inf:
            raise MagycError(f"--noise: {noise[0]:g} µT and {noise[1]:g} mrad/s, both must be more than 0")
        options["noise"] = [noise[0] * 1e-6, noise[1] * 1e-3]
    if delay not in (None, "auto"):
        try:
            options["delay"] = float(str(delay)) * 1e-3
        except ValueError:
            raise MagycError(f"--delay: {delay!r} is neither a number of milliseconds nor 'auto'") from None
    if window is not None and not window > 0:
        raise MagycError(f"--window: {window:g} s, it must be more than 0")
    return {k: v for k, v in options.items() if v is not None} | parse_pairs("--option", pairs)


def _show_json(folder: Path, calibration: Calibration) -> None:
    import json

    files = {file.name: str(file) for file in sorted(folder.iterdir())}
    result = {
        "trusted": calibration.trusted,
        "folder": str(folder),
        "files": files,
        "calibration": calibration.to_dict(),
    }
    typer.echo(json.dumps(result, indent=2))
