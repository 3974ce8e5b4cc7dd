"""Collect what the page shows of a result: verdict, numbers and texts to copy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.option_names import as_options
from magyc_gtsam.report import words
from magyc_gtsam.report.verdict import judged
from magyc_gtsam.serve.live import CALIBRATION
from magyc_gtsam.storage.mapping import parse_yaml

_SHOWN = {  # files whose text can be copied, in this order, and their labels
    "px4.params": "PX4",
    "ardupilot.param": "ArduPilot",
    "vectornav.txt": "VectorNav",
    "ros.yaml": "ROS",
    "next.yaml": "calibration.yaml",
    "calibration.yaml": "calibration.yaml",
    CALIBRATION: "calibration.yaml",
}
_CALIBRATIONS = ("calibration.yaml", "next.yaml", CALIBRATION)
_MOST = 200_000  # most bytes of a text that is shown


def details(folder: Path, converged: bool | None) -> dict[str, Any]:
    """Return numbers and texts of a result as JSON types; `converged` is from the last line of a live run."""
    files = {
        path.name: path for path in sorted(folder.iterdir()) if path.is_file() and not path.name.startswith(".")
    }
    exports = [
        {"name": label, "file": name, "text": files[name].read_text(encoding="utf-8", errors="replace")}
        for name, label in _SHOWN.items()
        if name in files and files[name].stat().st_size <= _MOST
    ]
    shown: dict[str, Any] = {
        "files": list(files),
        "exports": exports,
        "rows": [],
        "notes": _notes(files.get("configuration.yaml")),
    }
    path = next((files[name] for name in _CALIBRATIONS if name in files), None)
    if path is not None:
        try:
            calibration = Calibration.load(path)
        except MagycError as problem:
            return shown | {"sentence": as_options(str(problem)), "trusted": False}
        verdict = judged(calibration)
        rows = [[name, *values] for name, values in words.parameter_rows(calibration)]
        if path.name == CALIBRATION and converged:  # a live run writes no export files
            texts = [(name, text) for name, text, usable in words.exports(calibration) if usable]
            exports[:0] = [{"name": name, "file": "", "text": text} for name, text in texts]
        shown |= {
            "rows": rows if verdict.trusted else [],
            "exports": exports if verdict.trusted else [],
            "sentence": as_options(verdict.sentence),
            "trusted": verdict.trusted,
            "details": list(map(as_options, verdict.details)),
        }
    return shown


def _notes(configuration: Path | None) -> list[str]:
    """Return the notes on the log, which configuration.yaml has."""
    if configuration is None:
        return []
    try:
        values = parse_yaml(configuration.read_text(encoding="utf-8"))
    except (OSError, ValueError, MagycError) as problem:
        return [f"{configuration.name} cannot be read: {problem}"]
    notes = values.get("notes") if isinstance(values, dict) else None
    return [as_options(str(note)) for note in notes] if isinstance(notes, list) else []
