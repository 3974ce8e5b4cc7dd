"""Conversion of values to JSON types."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def json_types(value: Any) -> Any:
    """Convert dataclasses, arrays, mappings and sequences to dicts, lists and numbers.

    A number that is not finite becomes None. An object with a method `to_dict` is converted by it.
    """
    if hasattr(value, "to_dict"):
        return json_types(value.to_dict())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: json_types(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, np.ndarray | np.generic):
        return json_types(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): json_types(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [json_types(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
