"""Vectorised reading of the numbers in ROS messages.

The definition of a type and the lengths in a message (of strings and sequences) fix the place of every field. Messages
with the same length and the same inner lengths, usually all of a topic, are therefore rows of one table: one message is
parsed to find the places, and the numbers of the others are read at once.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.ros_types import PRIMITIVES, Types

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Bytes = NDArray[np.uint8]

NANOSECONDS = 1_000_000_000
_LONGEST_ARRAY = 16  # numbers; longer arrays are images, scans and buffers
_DEEPEST = 16  # levels of nested types
_MOST_LAYOUTS = 1000  # of one topic's messages; each is tried on all messages
_MOST_STEPS = 100_000  # fields of one message, including nested ones


@dataclass
class FieldLayout:
    """The places of all fields in messages of one layout.

    Attributes:
        length: bytes of a message.
        order: byte order, "<" or ">".
        places: {path: (offset, numpy type, number of elements, None for a single number)}.
        inner: (offset, value) of all lengths in the message.
    """

    length: int
    order: str
    places: dict[str, tuple[int, str, int | None]] = field(default_factory=dict)
    inner: list[tuple[int, int]] = field(default_factory=list)


class _Walk:
    """The parsing of one message field by field, which finds its layout."""

    def __init__(self, types: Types, data: bytes, encoding: str) -> None:
        self.types, self.data = types, data
        self.ros1 = encoding == "ros1"
        if self.ros1:
            order, self.at = "<", 0
        elif len(data) >= 4 and data[0] == 0 and data[1] in (0, 1):
            order, self.at = "><"[data[1]], 4
        elif len(data) < 4:
            raise IndexError
        else:
            raise MagycError(f"encapsulation 0x{data[:2].hex()} is not supported, only plain CDR (0x0000, 0x0001)")
        self.table = FieldLayout(len(data), order)
        self.steps = 0

    def message(self, kind: str, prefix: str, depth: int = 0, kept: bool = True) -> None:
        """Parse a (nested) message of type `kind`, whose paths begin with `prefix`, and store the places if `kept`."""
        if depth > _DEEPEST:
            raise MagycError(f"its definition nests types more than {_DEEPEST} deep")
        fields = self.types[kind]
        if not fields and not self.ros1:
            self._take(1)  # ROS 2 writes one byte for an empty type
        for one in fields:
            path = f"{prefix}{one.name}"
            count = 1
            self._step()
            if one.array:
                count = one.size if one.size is not None else self._length()
                if count > len(self.data) - self.at:
                    raise IndexError
            if one.type in PRIMITIVES:
                code = PRIMITIVES[one.type]
                if count:
                    self._align(int(code[1]))
                if kept:
                    code = (
                        "?" if one.type == "bool" else "V" if one.array and one.type in ("uint8", "byte") else code
                    )
                    self.table.places[path] = (self.at, code, count if one.array else None)
                self._take(count * int(PRIMITIVES[one.type][1]))
            elif one.type == "string":
                for _ in range(count):
                    self._step()
                    self._take(self._length())
            else:
                for _ in range(count):
                    self._step()
                    self.message(one.type, f"{path}.", depth + 1, kept and not one.array)

    def _step(self) -> None:
        """Count a field: types without fields use no bytes, so that only this limit ends an array of them."""
        self.steps += 1
        if self.steps > _MOST_STEPS:
            raise MagycError(f"a message has more than {_MOST_STEPS} fields")

    def _length(self) -> int:
        """Read the length of a string or sequence."""
        self._align(4)
        (value,) = struct.unpack_from(f"{self.table.order}I", self.data, self.at)
        self.table.inner.append((self.at, value))
        self.at += 4
        return int(value)

    def _align(self, size: int) -> None:
        if not self.ros1:
            self.at += -(self.at - 4) % size  # CDR aligns relative to the end of the encapsulation

    def _take(self, count: int) -> None:
        self.at += count
        if self.at > len(self.data):
            raise IndexError


class FieldReader:
    """Reader of the numbers in the messages of one topic, block by block.

    Args:
        topic: for messages.
        kind: short name of the type.
        types: its definition.
        encoding: "cdr" (ROS 2) or "ros1".
        wanted: paths to read; None for all numbers and short arrays of the first message, without covariances,
            stamps and layouts.
    """

    def __init__(
        self, topic: str, kind: str, types: Types, encoding: str, wanted: Sequence[str] | None = None
    ) -> None:
        self.topic, self.kind, self._types, self._encoding = topic, kind, types, encoding
        self._wanted = wanted
        self.columns: list[tuple[str, int | None]] | None = None
        self.stamped = False
        self._seen = 0
        self._tables: list[FieldLayout] = []

    @property
    def width(self) -> int:
        """Number of numbers per message."""
        return sum(1 if n is None else n for _, n in self.columns or ())

    def read(self, data: Bytes, start: Stamps, length: Stamps) -> tuple[Stamps, Array]:
        """Read header stamps (n,) ns, zero without a header, and numbers (n, width).

        Args:
            data: bytes that contain the messages.
            start, length: (n,) first byte and length of each message.

        Raises:
            MagycError: a message is shorter than its type, has other fields than the first, or has an unknown
                serialization.
        """
        stamp = np.zeros(len(start), dtype=np.int64)
        remaining = np.arange(len(start))
        parts: list[tuple[NDArray[np.intp], Array]] = []
        for table in self._tables:
            if len(remaining):
                remaining = self._rows(table, data, start, length, remaining, stamp, parts)
        while len(remaining):
            if len(self._tables) == _MOST_LAYOUTS:
                raise MagycError(
                    f"{self.topic} ({self.kind}): its texts and lists have more than {_MOST_LAYOUTS} different "
                    "lengths; read only other topics (channels=)"
                )
            first = remaining[0]
            table = self._layout(
                data[start[first] : start[first] + length[first]].tobytes(), self._seen + int(first)
            )
            self._tables.append(table)
            remaining = self._rows(table, data, start, length, remaining, stamp, parts)
        self._seen += len(start)
        if len(parts) == 1:
            return stamp, parts[0][1]
        value = np.empty((len(start), self.width))
        for rows, numbers in parts:
            value[rows] = numbers
        return stamp, value

    def _layout(self, message: bytes, index: int) -> FieldLayout:
        """Find the layout of message number `index`; the first message defines the columns."""
        try:
            walk = _Walk(self._types, message, self._encoding)
            walk.message(self.kind, "")
        except MagycError as error:
            raise MagycError(f"{self.topic} ({self.kind}): {error}") from None
        except (struct.error, IndexError):
            raise MagycError(
                f"{self.topic}: message {index + 1} of {len(message)} bytes is too short for its type; "
                "the log is damaged there, or its schema names the wrong type"
            ) from None
        places = walk.table.places
        if self.columns is None:
            self.stamped = {"header.stamp.sec", "header.stamp.nanosec"} <= places.keys()
            if self._wanted is None:
                self.columns = [
                    (path, count) for path, (_, code, count) in places.items() if _number(path, code, count)
                ]
            else:
                self._elements(places)
                self.columns = [(path, places[path][2]) for path in self._wanted]
        elif self._wanted is not None:
            self._elements(places)
        for path, count in self.columns:
            if places[path][2] != count:
                raise MagycError(f"{self.topic} ({self.kind}): the length of {path} changes")
        return walk.table

    def _elements(self, places: dict[str, tuple[int, str, int | None]]) -> None:
        """Add the places of the wanted single elements of arrays, such as "orientation_covariance[0]"."""
        for path in self._wanted or ():
            base, _, index = path.partition("[")
            offset, code, count = places.get(base, (0, "V", None))
            if index and count is not None and int(index[:-1]) < count:
                places[path] = (offset + int(index[:-1]) * np.dtype(code).itemsize, code, None)
            if path not in places or places[path][1] == "V":
                raise MagycError(f"{self.topic} ({self.kind}): has no number {path}")

    def _rows(
        self,
        table: FieldLayout,
        data: Bytes,
        start: Stamps,
        length: Stamps,
        candidates: NDArray[np.intp],
        stamp: Stamps,
        parts: list[tuple[NDArray[np.intp], Array]],
    ) -> NDArray[np.intp]:
        """Read the candidate rows that have the layout `table` into `stamp` and `parts`, and return the others."""
        matches = length[candidates] == table.length
        if self._encoding != "ros1" and matches.any():
            head = start[candidates[matches]]
            matches[matches] = (data[head + 1] == (table.order == "<")) & (data[head] == 0)
        for offset, value in table.inner:
            if not matches.any():
                return candidates
            matches[matches] = _at(data, start[candidates[matches]], offset, f"{table.order}u4") == value
        rows = candidates[matches]
        if not len(rows):
            return candidates
        place = start[rows]
        if self.stamped:
            seconds = _at(data, place, table.places["header.stamp.sec"][0], f"{table.order}i4").astype(np.int64)
            nanoseconds = _at(data, place, table.places["header.stamp.nanosec"][0], f"{table.order}u4")
            stamp[rows] = seconds * NANOSECONDS + nanoseconds
        parts.append((rows, self._numbers(table, data, place)))
        return candidates[~matches]

    def _numbers(self, table: FieldLayout, data: Bytes, place: Stamps) -> Array:
        """Return the numbers (n, width) of messages that have one layout and begin at `place` (n,)."""
        value = np.empty((len(place), self.width))
        column = 0
        runs: list[tuple[str, list[int], int]] = []  # columns of one type, read in one operation
        for path, count in self.columns or ():
            offset, code, _ = table.places[path]
            offsets = [offset + k * np.dtype(code).itemsize for k in range(1 if count is None else count)]
            if runs and runs[-1][0] == code:
                runs[-1][1].extend(offsets)
            else:
                runs.append((code, offsets, column))
            column += len(offsets)
        for code, offsets, first in runs:
            kind = "u1" if code == "?" else f"{table.order}{code}"
            numbers = _at(data, place[:, None], np.array(offsets), kind)
            value[:, first : first + len(offsets)] = numbers != 0 if code == "?" else numbers
        return value


def _at(data: Bytes, place: Any, offset: Any, kind: str) -> NDArray[Any]:
    """Return the numbers of type `kind` at any bytes of `data`."""
    size = np.dtype(kind).itemsize
    everywhere: NDArray[Any] = np.ndarray((len(data) - size + 1,), dtype=kind, buffer=data, strides=(1,))
    return everywhere[place + offset]


def _number(path: str, code: str, count: int | None) -> bool:
    """Return whether a field can be a channel."""
    parents = path.split(".")[:-1]
    if code == "V" or any(p in ("header", "stamp", "layout") for p in parents):
        return False
    return count is None or (0 < count <= _LONGEST_ARRAY and "covariance" not in path.split(".")[-1])
