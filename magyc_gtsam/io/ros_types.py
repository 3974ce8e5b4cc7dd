"""Parser of the definitions of ROS message types."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from magyc_gtsam.factors.errors import MagycError

PRIMITIVES = {
    **{"bool": "u1", "byte": "u1", "char": "i1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8"},
}
_TIME = ((("sec", "int32"), ("nanosec", "uint32")), ("builtin_interfaces/Time", "builtin_interfaces/Duration"))
_LINE = re.compile(r"^([\w/]+)(?:<=\d+)?(\[(?:<=)?(\d*)\])?\s+(\w+)\s*(=?)")
_LONGEST_DEFINITION = 1 << 20  # characters


@dataclass(frozen=True)
class Field:
    """A field of a type: its name, its base type, whether it is an array, and the fixed length of an array or None."""

    name: str
    type: str
    array: bool = False
    size: int | None = None


Types = Mapping[str, Sequence[Field]]


def short_type(schema_name: str) -> str:
    """Return 'sensor_msgs/Imu' for both 'sensor_msgs/msg/Imu' (ROS 2) and 'sensor_msgs/Imu' (ROS 1)."""
    return schema_name.replace("/msg/", "/")


def parse_types(name: str, text: str) -> Types:
    """Parse a definition in the format ros1msg or ros2msg of MCAP.

    Returns:
        {type: its fields in order}, of the message type and all types that it contains.

    Raises:
        MagycError: a line is not a field, a type has no definition, or the text is too long.
    """
    if len(text) > _LONGEST_DEFINITION:
        raise MagycError(f"its definition has {len(text)} characters, at most {_LONGEST_DEFINITION} are read")
    types: dict[str, list[Field]] = {}
    for full in _TIME[1]:
        types[full] = [Field(n, t) for n, t in _TIME[0]]
    current = short_type(name)
    types[current] = []
    for line in text.splitlines():
        line = line.split("#")[0].strip()
        if line.startswith("MSG:"):
            current = short_type(line[4:].strip())
            types[current] = []
        elif line and not line.startswith("==="):
            match = _LINE.match(line)
            if match is None:
                raise MagycError(f"its definition has the line {line[:80]!r}, which is not a field")
            kind, array, size, field_name, constant = match.groups()
            if not constant:
                package = current.split("/")[0]
                types[current].append(
                    Field(
                        field_name,
                        _full(kind, package),
                        bool(array),
                        int(size) if size and "<" not in array else None,
                    )
                )
    for fields in list(types.values()):
        for one in fields:
            if one.type not in PRIMITIVES and one.type != "string" and one.type not in types:
                raise MagycError(f"its field {one.name!r} is of type {one.type}, which is not defined")
    return types


def _full(kind: str, package: str) -> str:
    """Return the full name of a type that a definition in `package` uses."""
    if kind in PRIMITIVES or kind in ("string", "wstring"):
        return kind
    if kind in ("time", "duration"):
        return _TIME[1][0]
    kind = short_type(kind)
    return "std_msgs/Header" if kind == "Header" else kind if "/" in kind else f"{package}/{kind}"
