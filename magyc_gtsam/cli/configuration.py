"""`--config`: the options of an earlier run, from the configuration.yaml that it wrote."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

_OWN = ("robust", "window", "noise", "delay", "field_strength")


def from_file(context: typer.Context, path: Path | None) -> Path | None:
    """Callback of the option: what the file says becomes the defaults of all options that are not given."""
    if path is None:
        return None
    context.default_map = {**(context.default_map or {}), **defaults(path)}
    return path


def defaults(path: Path) -> dict[str, Any]:
    """Options of `calibrate` by their names, from a configuration.yaml.

    Raises:
        MagycError: no such file, or none that `calibrate` wrote.
    """
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.storage.mapping import load_mapping

    try:
        values = load_mapping(path, "configuration")
    except MagycError as problem:
        raise MagycError(f"--config: {problem}; it is no configuration.yaml of calibrate") from None
    if not isinstance(values.get("reading"), dict) or "method" not in values:
        raise MagycError(
            f"--config: {path} is no configuration.yaml of calibrate; it has no 'reading' and 'method'"
        )
    options = values.get("options") or {}
    if not isinstance(options, dict):
        raise MagycError(f"--config: {path}: options must be names with values, got {options!r}")
    try:
        return {**values["reading"], "method": values["method"], **_as_options(options)}
    except (TypeError, ValueError) as problem:
        raise MagycError(
            f"--config: {path}: an option is of another kind than its name says ({problem})"
        ) from None


def _as_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """From arguments of `magyc_gtsam.calibrate`, in SI units, to options, in those of the command line."""
    import yaml

    found: dict[str, Any] = {name: options[name] for name in ("robust", "window") if name in options}
    if "noise" in options:
        magnetometer, gyroscope = options["noise"]
        found["noise"] = (magnetometer * 1e6, gyroscope * 1e3)
    if "delay" in options:
        found["delay"] = repr(options["delay"] * 1e3)
    if "field_strength" in options:
        found["field_strength"] = options["field_strength"] * 1e6
    others = {name: value for name, value in options.items() if name not in _OWN}
    if others:
        found["option"] = [
            f"{k}={yaml.safe_dump(v, default_flow_style=True).split(chr(10))[0]}" for k, v in others.items()
        ]
    return found
