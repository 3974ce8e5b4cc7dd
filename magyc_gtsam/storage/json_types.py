"""Conversion of values to JSON types, with or without the way back."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def json_types(value: Any, *, finite: bool = True) -> Any:
    """Convert dataclasses, arrays, mappings and sequences to dicts, lists and numbers.

    With `finite`, as JSON asks, a number that is not finite becomes None. A method `to_dict` converts its object.
    """

    def convert(part: Any) -> Any:
        return json_types(part, finite=finite)

    if hasattr(value, "to_dict"):
        return convert(value.to_dict())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: convert(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, np.ndarray | np.generic):
        return convert(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): convert(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [convert(v) for v in value]
    if finite and isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def typed_json(value: Any, types: Mapping[str, Any]) -> Any:
    """Convert a value to JSON types from which `from_typed_json` restores it bit for bit.

    Arrays, tuples and instances of `types` (by name) become {name: content}.
    """
    name = type(value).__name__
    if isinstance(value, np.ndarray):
        return {"array": [value.shape, value.ravel().tolist()]}
    if hasattr(types.get(name), "from_dict"):
        return {name: value.to_dict()}
    if name in types:
        return {name: typed_json(value._asdict() if hasattr(value, "_asdict") else vars(value), types)}
    if isinstance(value, tuple):
        return {"tuple": [typed_json(each, types) for each in value]}
    if isinstance(value, list):
        return [typed_json(each, types) for each in value]
    if isinstance(value, dict):
        return {key: typed_json(each, types) for key, each in value.items()}
    return value.item() if isinstance(value, np.generic) else value


def from_typed_json(value: Any, types: Mapping[str, Any]) -> Any:
    """Return the value that `typed_json` converted."""
    if isinstance(value, list):
        return [from_typed_json(each, types) for each in value]
    if not isinstance(value, dict):
        return value
    name = next(iter(value), "")
    if name == "array":
        shape, numbers = value[name]
        return np.array(numbers, dtype=np.float64).reshape(shape)
    if hasattr(types.get(name), "from_dict"):
        return types[name].from_dict(value[name])
    if name == "tuple":
        return tuple(from_typed_json(value[name], types))
    if name in types:
        return types[name](**from_typed_json(value[name], types))
    return {key: from_typed_json(each, types) for key, each in value.items()}
