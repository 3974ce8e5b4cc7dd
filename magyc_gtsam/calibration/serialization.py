"""Conversion of a `Calibration` to JSON types, back, and to the text of a file."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.observability import Observability
from magyc_gtsam.storage.json_types import json_types
from magyc_gtsam.storage.mapping import dump_yaml

if TYPE_CHECKING:
    from _typeshed import DataclassInstance  # a `Calibration`, which imports this module

FORMAT = "magyc-gtsam calibration 1"
# Without one of these a file was cut off; the defaults of `Calibration` would make what is left of it trusted.
_DECISIVE = ("soft_iron", "hard_iron", "terms", "observability", "configuration", "converged")


def as_mapping(calibration: DataclassInstance) -> dict[str, Any]:
    """Return all fields of a calibration as JSON types, with the format's name.

    `converged` is the last, which a file that was cut off lacks or has as no truth value.
    """
    result: dict[str, Any] = {"format": FORMAT}
    for f in fields(calibration):
        result[f.name] = json_types(getattr(calibration, f.name), finite=False)
    result["converged"] = result.pop("converged")
    return result


def expect_whole(data: Mapping[str, Any], names: Collection[str] = _DECISIVE) -> None:
    """Check that a calibration that was read has all of `names`.

    Raises:
        MagycError: some are missing.
    """
    missing = [name for name in names if name not in data]
    if missing:
        raise MagycError(f"calibration without {', '.join(missing)}: is it cut off? copy the whole file again")


def constructor_arguments(calibration_class: type[DataclassInstance], data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of `Calibration` that the result of `as_mapping` holds; unknown keys are ignored.

    Raises:
        MagycError: no mapping, another format, or a key that decides is missing.
    """
    if not isinstance(data, Mapping):
        raise MagycError(f"not a calibration: a mapping of names to values is needed, got a {type(data).__name__}")
    if "accelerometer" in str(data.get("format")):
        raise MagycError(
            "the calibration of an accelerometer, which is not exported or applied by the command line; in Python, "
            "mg.AccelerometerCalibration.load reads it"
        )
    if data.get("format") != FORMAT:
        raise MagycError(f"not a calibration: format is {data.get('format')!r}, expected {FORMAT!r}")
    expect_whole(data)
    known = {f.name for f in fields(calibration_class)}
    arguments = {k: v for k, v in data.items() if k in known}
    if arguments["observability"] is not None:
        arguments["observability"] = Observability.from_dict(arguments["observability"])
    arguments["terms"] = tuple(Term.from_dict(term) for term in arguments["terms"])
    return arguments


def as_text(suffix: str, data: Mapping[str, Any]) -> str:
    """Return the mapping in the format of a file suffix.

    Raises:
        MagycError: the suffix is not .yaml, .yml or .json.
    """
    if suffix.lower() == ".json":
        return json.dumps(data, indent=2) + "\n"
    if suffix.lower() in (".yaml", ".yml"):
        return dump_yaml(data)
    raise MagycError(f"a calibration is saved as .yaml or .json, not as {suffix or 'a file without suffix'!r}")
