"""`magyc-gtsam calibrate`: calibrate the sensors of a log, and write parameters and a page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.accelerometer import calibrate_accelerometer
from magyc_gtsam.cli.known import GivenFacts, Scale
from magyc_gtsam.cli.many import calibrate_logs, each_compass, each_log, many
from magyc_gtsam.cli.options import CONFIGURED, with_groups
from magyc_gtsam.cli.ranges import MICRO, MILLI, in_si
from magyc_gtsam.cli.reading import Reading, parse_pairs
from magyc_gtsam.cli.results import Task, calibrate_log, check_task, dated_folder
from magyc_gtsam.cli.terminal import (
    complain,
    concluded,
    show,
    show_calibration,
    show_details,
    show_json,
    show_page,
    show_results,
    stages,
)

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.report.verdict import Verdict

_LEAST_NOISE = 1e-5  # µT and mrad/s per sample, a tenth of what the best sensors have; less was given in SI units
_NOT_PLANNED = (
    *("field_strength", "location", "altitude", "date", "heading", "heading_sigma", "gyroscope_scale"),
    *("method", "delay", "robust", "window"),
)


@with_groups
def run(
    context: typer.Context,
    reading: Reading,
    scale: Scale,
    known: GivenFacts,
    method: Annotated[str, typer.Option(help="Calibration method, one of magyc_gtsam.methods().")] = "smoother",
    sensor: Annotated[
        Literal["magnetometer", "accelerometer"],
        typer.Option(help="Sensor to calibrate; the accelerometer by gravity, with --option gravity=9.81."),
    ] = "magnetometer",
    output: given.Output = None,
    noise: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="µT MRAD/S",
            help="Standard deviation per sample of magnetometer and gyroscope. Default: estimated.",
        ),
    ] = None,
    delay: Annotated[
        str | None,
        typer.Option(metavar="MS", help="Delay of the magnetometer after the gyroscope, or 'auto' (the default)."),
    ] = None,
    robust: Annotated[
        bool | None,
        typer.Option(
            "--robust/--no-robust", help="Give disturbed windows less weight. Default: depends on the method."
        ),
    ] = None,
    window: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Longest averaging window. Default: depends on the method."),
    ] = None,
    option: given.MethodOptions = None,
    plan: Annotated[
        float | None,
        typer.Option(
            metavar="DEGREES",
            is_eager=True,
            callback=given.needs_no_log,
            help="Only list which motion, for how long, gives this heading accuracy, with and without an earlier "
            "calibration and the location. Uses --noise, --prior and the --...-walk options. Needs no LOG and writes "
            "no files.",
        ),
    ] = None,
    more: given.More = None,
    every: Annotated[
        bool,
        typer.Option(
            "--all", help="Calibrate every magnetometer in the log, each with its own page and parameters."
        ),
    ] = False,
    engine: given.Engine = "local",
    config: given.Config = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Also write report.pdf.")] = False,
    force: given.Force = False,
    open_page: given.Open = False,
    verbose: given.Verbose = False,
    quiet: given.Quiet = False,
    json: given.Json = False,
) -> int:
    """Calibrate the sensors of a log, or of each of many logs.

    Writes calibration.yaml, configuration.yaml, report.html and the parameters to paste.
    Exit code 1: done, but the result must not be trusted; the reason is printed and no parameters are written.
    """
    configured = context.meta.get(CONFIGURED, {})
    options = _method_options(configured, known.options(scale, method), noise, delay, robust, window, option)
    unchecked = [*(option or []), *configured] or None
    if plan is not None:
        from magyc_gtsam.cli.plan import show_plan

        if reading.log is not None or output is not None:
            raise typer.BadParameter("needs no LOG and writes no files; leave out LOG and -o", param_hint="--plan")
        for name in given.on_command_line(context):
            if name in _NOT_PLANNED:
                option = f"--{name.replace('_', '-')}"
                raise typer.BadParameter("has no effect on a plan (--plan); leave it out", param_hint=option)
        return show_plan(plan, options, quiet, json)
    folder = output or dated_folder(reading.log)
    task = Task(reading, method, options, unchecked, folder, tuple(context.obj), force)
    if remark := given.check_configured_log(context, reading.log, config):
        complain(f"note: {remark}")
    if sensor == "accelerometer":
        for name, wanted in (
            ("--all", every),
            ("LOGS", many(reading.log, more)),
            ("--pdf", pdf),
            ("--force", force),
        ):
            if wanted:
                raise typer.BadParameter("not with --sensor accelerometer, which takes one LOG", param_hint=name)
        return calibrate_accelerometer(task, quiet, json)
    check_task(task)
    if engine != "local" and not (every or many(reading.log, more)):
        raise given.without_effect("--engine", "several logs or --all")
    if every or many(reading.log, more):
        from magyc_gtsam.io.many import find_logs

        if pdf:
            raise typer.BadParameter("is for one LOG", param_hint="--pdf")
        logs = find_logs([reading.log, *(more or [])])
        tasks = each_log(task, logs)
        return calibrate_logs(each_compass(tasks) if every else tasks, output, engine, open_page, quiet, json)
    with stages(shown=not (quiet or json)) as stage:
        recording, calibration, verdict = calibrate_log(task, stage)
    if pdf:
        calibration.report(folder / "report.pdf", replace(recording, name=reading.log.name))
    if open_page:
        show_page(folder / "report.html")
    if json:
        _show_json(folder, calibration, verdict)
    elif not quiet:
        show(verdict.sentence, f"{reading.log.name}: {recording.duration:.1f} s, {calibration.method}", "")
        if verdict.trusted:
            show_calibration(calibration)
        show_details(verdict, verbose)
        if verbose:
            from magyc_gtsam.report.words import configuration

            show(configuration(calibration))
        show_results(folder, recording.notes)
    return concluded(verdict, shown=not (quiet or json))


def _method_options(
    configured: dict[str, Any],
    known: dict[str, Any],
    noise: tuple[float, float] | None,
    delay: str | None,
    robust: bool | None,
    window: float | None,
    pairs: list[str] | None,
) -> dict[str, Any]:
    """Return the arguments of `magyc_gtsam.calibrate`, in SI units: those of --config, then what was given."""
    from magyc_gtsam.estimators.gauge import LARGEST_NOISE
    from magyc_gtsam.estimators.smoother.options import MOST_DELAY
    from magyc_gtsam.factors.errors import MagycError

    options: dict[str, Any] = known | {"robust": robust, "window": window}
    if noise is not None:
        options["noise"] = []
        for sensor, value, unit, scale, most in (
            ("magnetometer", noise[0], "µT", MICRO, LARGEST_NOISE[0]),
            ("gyroscope", noise[1], "mrad/s", MILLI, LARGEST_NOISE[1]),
        ):
            options["noise"].append(in_si(f"--noise: the {sensor}'s", value, unit, scale, most, zero=False))
            if value < _LEAST_NOISE:
                raise MagycError(
                    f"--noise: the {sensor}'s must be at least {_LEAST_NOISE:g} {unit}, got {value:g}; if it is in SI "
                    f"units, give {value / scale:g} {unit}"
                )
    if delay not in (None, "auto"):
        try:
            options["delay"] = float(str(delay)) * 1e-3
        except ValueError:
            raise MagycError(f"--delay: must be a number of milliseconds or 'auto', got {delay!r}") from None
        most = MOST_DELAY * 1e3
        if not abs(options["delay"]) < MOST_DELAY:
            raise MagycError(f"--delay: must be between -{most:g} and {most:g} ms, got {float(str(delay)):g}")
    if window is not None and not window > 0:
        raise MagycError(f"--window: must be more than 0 s, got {window:g}")
    given = {k: v for k, v in options.items() if v is not None} | parse_pairs("--option", pairs)
    if "field_strength" in given:  # instead of the place of --config
        configured = {k: v for k, v in configured.items() if k != "field"}
    return configured | given


def _show_json(folder: Path, calibration: Calibration, verdict: Verdict) -> None:
    files = {file.name: str(file) for file in sorted(folder.iterdir())}
    result = {
        "trusted": verdict.trusted,
        "verdict": verdict.to_dict(),
        "folder": str(folder),
        "files": files,
        "calibration": calibration.to_dict(),
    }
    show_json(result)
