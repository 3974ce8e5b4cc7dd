"""`magyc-gtsam calibrate --sensor accelerometer`: calibrate the accelerometer of a log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from magyc_gtsam.cli.files import replacing_folder
from magyc_gtsam.cli.results import Task, write_configuration
from magyc_gtsam.cli.terminal import concluded, show, show_json, show_parameters, show_results, stages

if TYPE_CHECKING:
    from magyc_gtsam.estimators.autocal.accelerometer import AccelerometerCalibration
    from magyc_gtsam.recording import Recording


def calibrate_accelerometer(task: Task, quiet: bool, json: bool) -> int:
    """Calibrate, write calibration.yaml, configuration.yaml and report.html, and return the exit code.

    Args:
        task: its method is "autocal", or the default of the command; its options are those of
            `estimators.autocal.accelerometer.calibrate_accelerometer`.
        quiet, json: of the command line.
    """
    reading, method, folder = task.reading, task.method, task.folder
    with replacing_folder(folder) as part, stages(shown=not (quiet or json)) as stage:
        recording = reading.recording(stage("reading"))
        work = stage("calibrating")
        from magyc_gtsam.factors.errors import MagycError
        from magyc_gtsam.report.accelerometer import write_accelerometer_report

        if method not in ("autocal", "smoother"):
            raise MagycError(f"--method: {method!r} cannot calibrate an accelerometer; leave it out for 'autocal'")
        calibration = _calibrate(recording, task.options)
        work(1.0)
        page = stage("drawing the page")
        calibration.save(part / "calibration.yaml")
        write_configuration(part, reading, recording, cast(Any, calibration), task.options, task.arguments)
        write_accelerometer_report(part / "report.html", replace(recording, name=reading.log.name), calibration)
        page(1.0)
    from magyc_gtsam.report.verdict import Verdict

    worth = f"bias known to {calibration.sigma['bias'].max():.2g} m/s² (1σ)" if calibration.converged else ""
    verdict = Verdict(calibration.converged, cause="" if worth else calibration.message, worth=worth)
    if json:
        _show_json(folder, calibration)
    elif not quiet:
        show(verdict.sentence)
        _show(folder, reading.log, recording, calibration)
    return concluded(verdict, shown=not (quiet or json))


def _calibrate(recording: Recording, options: dict[str, Any]) -> AccelerometerCalibration:
    """Calibrate; raise a MagycError for an option that the method does not accept."""
    from magyc_gtsam.estimators.autocal import accelerometer
    from magyc_gtsam.factors.errors import MagycError

    function = accelerometer.calibrate_accelerometer
    unknown = sorted(options.keys() - (function.__kwdefaults__ or {}).keys())
    if unknown:
        raise MagycError(
            f"--sensor accelerometer has no option {', '.join(map(repr, unknown))}; --option takes gravity=m/s², "
            "noise=m/s² and kernel=cauchy, huber, l1 or geman-mcclure"
        )
    try:
        return function(recording, **options)
    except TypeError as error:
        raise MagycError(f"--option: the accelerometer's calibration cannot use it ({error})") from None


def _show(folder: Path, log: Path, recording: Recording, calibration: AccelerometerCalibration) -> None:
    from magyc_gtsam.report.accelerometer import parameter_rows

    show(f"{log.name}: {recording.duration:.1f} s, accelerometer, {calibration.method}", "")
    if calibration.converged:
        show_parameters(parameter_rows(calibration))
    show(
        f"samples in motion, with reduced weight: {calibration.diagnostics['outliers']} of "
        f"{calibration.diagnostics['samples']}",
    )
    show_results(folder, recording.notes)


def _show_json(folder: Path, calibration: AccelerometerCalibration) -> None:
    result = {
        "trusted": calibration.converged,
        "folder": str(folder),
        "files": {file.name: str(file) for file in sorted(folder.iterdir())},
        "calibration": calibration.to_dict(),
    }
    show_json(result)
