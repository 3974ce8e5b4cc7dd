"""Calibrate one log of the command line, and write its files with the description of the run."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magyc_gtsam.cli.files import replacing_folder
from magyc_gtsam.cli.own_files import EXPORTS
from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.option_names import as_options

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.cli.terminal import Progress
    from magyc_gtsam.recording import Recording
    from magyc_gtsam.report.verdict import Verdict

_SHORT = 60.0  # s; shorter logs are often too short


@dataclass(frozen=True)
class Task:
    """A unit of work: one log to calibrate, or one compass of a log.

    Attributes:
        reading: the log and how to read it.
        method: name of the method.
        options: arguments of `magyc_gtsam.calibrate`.
        pairs: texts of --option and names from --config, for messages; None without any.
        folder: folder of its results.
        arguments: the command line, for configuration.yaml.
        force: also write the parameters of a result that must not be trusted, as comments.
        compass: number of the compass on the vehicle, from 1, where the log does not say it.
    """

    reading: Reading
    method: str
    options: dict[str, Any]
    pairs: list[str] | None
    folder: Path
    arguments: tuple[str, ...]
    force: bool
    compass: int = 1


def dated_folder(log: Path, what: str = "") -> Path:
    """Return the path `results/<log><what>-<date>-<time>`, followed by a number if it exists."""
    name = f"{log.stem}{what}-{datetime.now():%Y%m%d-%H%M%S}"
    folder = Path("results") / name
    count = 1
    while folder.exists():
        count += 1
        folder = folder.with_name(f"{name}-{count}")
    return folder


def write_page(folder: Path, recording: Recording, calibration: Calibration, verdict: Verdict) -> None:
    """Write report.html, with residuals if the method has a gyroscope bias."""
    from magyc_gtsam.report.page import residuals_of, write_report

    residuals = residuals_of(recording, calibration)
    write_report(folder / "report.html", recording, calibration, residuals, verdict)


def exported(calibration: Calibration, target: str, **options: Any) -> str:
    """Return parameters as `Calibration.export`, with options of the command line under DO NOT USE.

    Raises:
        MagycError: see `Calibration.export`.
    """
    text: str = calibration.export(target, **options)
    return text if calibration.trusted else as_options(text)


def write_exports(folder: Path, calibration: Calibration, force: bool = False) -> None:
    """Write the parameters for each target, or the reason if the target cannot represent the calibration.

    Nothing is written for a calibration that must not be trusted; with `force`, comments under DO NOT USE are.
    """
    from magyc_gtsam.factors.errors import MagycError

    if not calibration.trusted and not force:
        return
    for target, name in EXPORTS.items():
        try:
            text = exported(calibration, target, force=force)
        except MagycError as error:
            text = f"# {error}\n"
        (folder / name).write_text(text, encoding="utf-8")


def write_configuration(
    folder: Path,
    reading: Reading,
    recording: Recording,
    calibration: Calibration,
    options: dict[str, Any],
    arguments: Sequence[str],
) -> None:
    """Write configuration.yaml: the versions, the log and how it was read, and the options of the method."""
    chosen = {
        "method": calibration.method,
        "options": options,
        "configuration": dict(calibration.configuration),
    }
    write_yaml(folder / "configuration.yaml", run_description(reading, recording, arguments) | chosen)


def _versions(*names: str) -> dict[str, str]:
    """Return {package: version} of those packages that are installed."""
    versions = {}
    for name in names:
        with suppress(PackageNotFoundError):  # gtsam is optional
            versions[name] = version(name)
    return versions


def run_description(reading: Reading, recording: Recording, arguments: Sequence[str]) -> dict[str, Any]:
    """Return the command, versions, the log with its checksum, and how it was read, as JSON types."""
    from magyc_gtsam import __version__
    from magyc_gtsam.storage.files import sha256, size_of

    return {
        "magyc_gtsam": __version__,
        "command": shlex.join(["magyc-gtsam", *arguments]),
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "log": {"name": reading.log.name, "sha256": sha256(reading.log), "bytes": size_of(reading.log)},
        "interval": [float(recording.time[0]), float(recording.time[-1])],
        "reading": reading.to_dict(),
        "notes": list(recording.notes),
        "versions": {
            "python": platform.python_version(),
            **_versions("gtsam", "numpy", "scipy"),
        },
    }


def write_yaml(path: Path, values: dict[str, Any]) -> None:
    """Write values of JSON types as YAML, in their order."""
    from magyc_gtsam.storage.mapping import dump_yaml

    path.write_text(dump_yaml(values), encoding="utf-8")


def calibrate_log(
    task: Task, stage: Callable[[str], Progress] = lambda _: lambda _: None
) -> tuple[Recording, Calibration, Verdict]:
    """Read a log, calibrate it and write all files into its folder; `stage` opens a named stage of the progress."""
    from magyc_gtsam.report.verdict import judged

    reading = task.reading
    with replacing_folder(task.folder) as folder:
        recording = reading.recording(stage("reading"))
        earlier = task.options.get("prior")
        if isinstance(earlier, dict) and earlier.get("converged") is False:
            cause = str(earlier.get("message", "")).split(";")[0]
            remark = f"the earlier calibration must not be trusted by itself: {cause}"
            recording = replace(recording, notes=(*recording.notes, remark))
        calibration = _calibrate(recording, task, stage("calibrating"))
        if task.compass > 1 and recording.autopilot is None:
            calibration = replace(
                calibration, configuration={**calibration.configuration, "compass": task.compass}
            )
        page = stage("drawing the page")
        calibration.save(folder / "calibration.yaml")
        write_configuration(folder, reading, recording, calibration, task.options, task.arguments)
        verdict = judged(calibration, recording)
        write_exports(folder, calibration, task.force)
        write_page(folder, replace(recording, name=reading.log.name), calibration, verdict)
        page(1.0)
    return recording, calibration, verdict


def _on_log(message: str, recording: Recording, task: Task) -> str:
    """Return why a log was not calibrated with its name, and what about the log may be the cause."""
    from magyc_gtsam.recording.time_base import CLOCKS_APART

    if message.split(maxsplit=1)[0].rstrip(":") in {*task.options, "method"}:  # about an option
        return message
    remarks = [note for note in recording.notes if note.startswith(CLOCKS_APART)]
    if recording.duration < _SHORT:
        remarks.insert(0, f"{recording.duration:.1f} s of the log are used")
    return "; ".join([f"{task.reading.log}: {message}", *remarks])


def check_task(task: Task) -> None:
    """Check the options of a task without its log.

    Raises:
        MagycError: one of them would be refused with any log.
    """
    from magyc_gtsam.estimators import check_options

    task.reading.check()
    with _usable(task):
        check_options(task.method, **task.options)


def _calibrate(recording: Recording, task: Task, progress: Progress) -> Calibration:
    """Calibrate; an argument that the method does not accept raises a MagycError."""
    from magyc_gtsam import MagycError, calibrate

    with _usable(task):
        try:
            calibration: Calibration = calibrate(recording, task.method, progress=progress, **task.options)
        except MagycError as error:
            raise MagycError(_on_log(str(error), recording, task)) from None
    return calibration


@contextmanager
def _usable(task: Task) -> Iterator[None]:
    """Raise a MagycError for an option of another type than the method needs."""
    from magyc_gtsam.factors.errors import MagycError

    try:
        yield
    except TypeError as error:
        if task.pairs is None:
            raise
        raise MagycError(f"{', '.join(task.pairs)}: {task.method} cannot use it ({error})") from None
