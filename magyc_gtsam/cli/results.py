"""The files of one calibration, including the description of its run."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.cli.reading import Reading
    from magyc_gtsam.recording import Recording
    from magyc_gtsam.report.verdict import Verdict

EXPORTS = {
    "px4": "px4.params",
    "ardupilot": "ardupilot.param",
    "vectornav": "vectornav.txt",
    "ros": "ros.yaml",
}


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
    from magyc_gtsam.estimators.smoother.residuals import window_residuals
    from magyc_gtsam.report import write_report

    has_residuals = recording.angular_rate is not None and calibration.gyro_bias is not None
    residuals = window_residuals(recording, calibration) if has_residuals else None
    write_report(folder / "report.html", recording, calibration, residuals, verdict)


def write_exports(folder: Path, calibration: Calibration, force: bool = False) -> None:
    """Write the parameters for each target, or the reason if the target cannot represent the calibration.

    Nothing is written for a calibration that must not be trusted; with `force`, comments under DO NOT USE are.
    """
    from magyc_gtsam.factors.errors import MagycError

    if not calibration.trusted and not force:
        return
    for target, name in EXPORTS.items():
        try:
            text = calibration.export(target, force=force)
        except MagycError as error:
            text = f"# {error}\n"
        (folder / name).write_text(text, encoding="utf-8")


def remove_exports(folder: Path) -> None:
    """Remove the parameters of an earlier run, which must not remain beside an untrusted calibration."""
    for name in EXPORTS.values():
        (folder / name).unlink(missing_ok=True)


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
    from magyc_gtsam.storage.checksum import sha256

    return {
        "magyc_gtsam": __version__,
        "command": shlex.join(["magyc-gtsam", *arguments]),
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "log": {"name": reading.log.name, "sha256": sha256(reading.log), "bytes": reading.log.stat().st_size},
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
    import yaml

    path.write_text(yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=110), encoding="utf-8")
