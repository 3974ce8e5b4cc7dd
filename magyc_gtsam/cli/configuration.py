"""`--config`: the options of an earlier run, from the configuration.yaml that it wrote."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

CONFIGURED = "configured"  # key of `Context.meta`: arguments of the method that are no defaults of options
_WITH_OPTION = ("robust", "window", "noise", "delay", "field_strength")


def from_file(context: typer.Context, path: Path | None) -> Path | None:
    """Use the options in the file as defaults of those that are not given; the callback of --config."""
    if path is None:
        return None
    context.default_map, context.meta[CONFIGURED] = _defaults(path)
    return path


def _defaults(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the options of `calibrate` by their names, and the other arguments, from a configuration.yaml.

    Raises:
        MagycError: the file does not exist or was not written by `calibrate`.
    """
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
        return {**values["reading"], "method": values["method"], **_as_options(options)}, others
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
