"""Calibrate one log of the command line, and write its files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.cli.results import write_configuration, write_exports, write_page

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.cli.terminal import Progress
    from magyc_gtsam.recording import Recording
    from magyc_gtsam.report.verdict import Verdict


def calibrate_log(
    reading: Reading,
    method: str,
    options: dict[str, Any],
    pairs: list[str] | None,
    folder: Path,
    arguments: Sequence[str],
    force: bool,
    compass: int = 1,
    stage: Callable[[str], Progress] = lambda _: lambda _: None,
) -> tuple[Recording, Calibration, Verdict]:
    """Read a log, calibrate it and write all files into a folder.

    Args:
        reading: the log and how to read it.
        method: name of the method.
        options: arguments of `magyc_gtsam.calibrate`.
        pairs: texts of --option and names from --config, for messages; None without any.
        folder: folder for the files; it must exist.
        arguments: the command line, for configuration.yaml.
        force: also write the parameters of a result that must not be trusted, as comments.
        compass: number of the compass on the vehicle, from 1.
        stage: opens a named stage and returns its progress callback.
    """
    from magyc_gtsam.report.verdict import judged

    recording = reading.recording(stage("reading"))
    earlier = options.get("prior")
    if isinstance(earlier, dict) and earlier.get("converged") is False:
        cause = str(earlier.get("message", "")).split(";")[0]
        remark = f"the earlier calibration must not be trusted by itself: {cause}"
        recording = replace(recording, notes=(*recording.notes, remark))
    calibration = _calibrate(recording, method, stage("calibrating"), options, pairs)
    if compass > 1:
        calibration = replace(calibration, configuration={**calibration.configuration, "compass": compass})
    page = stage("drawing the page")
    calibration.save(folder / "calibration.yaml")
    write_configuration(folder, reading, recording, calibration, options, arguments)
    verdict = judged(calibration, recording)
    write_exports(folder, calibration, force)
    write_page(folder, replace(recording, name=reading.log.name), calibration, verdict)
    page(1.0)
    return recording, calibration, verdict


def _calibrate(
    recording: Recording, method: str, progress: Progress, options: dict[str, Any], pairs: list[str] | None
) -> Calibration:
    """Calibrate; an argument that the method does not accept raises a MagycError."""
    from magyc_gtsam import MagycError, calibrate

    try:
        calibration: Calibration = calibrate(recording, method, progress=progress, **options)
    except TypeError as error:
        if pairs is None:
            raise
        raise MagycError(f"{', '.join(pairs)}: {method} cannot use it ({error})") from None
    return calibration
