"""Conversion of values to JSON types."""

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
