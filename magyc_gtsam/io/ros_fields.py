"""Numbers in ROS messages, read in bulk: one message shows where the numbers stand, all alike follow at once.

A type's definition and the lengths in a message (of strings and sequences) fix the place of every field. Messages
of one length and the same inner lengths, as a rule all of a topic, are therefore rows of one table.
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
_LONGEST_ARRAY = 16  # numbers; longer ones are images, scans and buffers
_DEEPEST = 16  # types within types
_MOST_LAYOUTS = 1000  # of one topic's messages; each is tried on all of them
_MOST_STEPS = 100_000  # fields of one message, those within others counted


@dataclass
class FieldLayout:
    """Where everything stands in the messages that are alike.

    Args:
        length: bytes of each.
        order: of the bytes, "<" or ">".
        places: {path: (offset, numpy type, number of elements, None for a single number)}.
        inner: (offset, value) of all lengths in the message.
    """

    length: int
    order: str
    places: dict[str, tuple[int, str, int | None]] = field(default_factory=dict)
    inner: list[tuple[int, int]] = field(default_factory=list)


class _Walk:
    """One message, field by field."""

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
            raise MagycError(
                f"encapsulation 0x{data[:2].hex()} of CDR is not supported, only plain CDR (0x0000, 0x0001)"
            )
        self.table = FieldLayout(len(data), order)
        self.steps = 0

    def message(self, kind: str, prefix: str, depth: int = 0, kept: bool = True) -> None:
        if depth > _DEEPEST:
            raise MagycError(f"its definition nests types more than {_DEEPEST} deep")
        fields = self.types[kind]
        if not fields and not self.ros1:
            self._take(1)  # ROS 2 puts a byte where a type is empty
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
        self.steps += 1  # types without fields take no bytes that would end them
        if self.steps > _MOST_STEPS:
            raise MagycError(f"a message has more than {_MOST_STEPS} fields")

    def _length(self) -> int:
        self._align(4)
        (value,) = struct.unpack_from(f"{self.table.order}I", self.data, self.at)
        self.table.inner.append((self.at, value))
        self.at += 4
        return int(value)

    def _align(self, size: int) -> None:
        if not self.ros1:
            self.at += -(self.at - 4) % size  # CDR aligns by the distance from the end of the encapsulation

    def _take(self, count: int) -> None:
        self.at += count
        if self.at > len(self.data):
            raise IndexError


class FieldReader:
    """The numbers of one topic's messages, block by block.

    Args:
        topic: for error messages.
        kind: short name of the type.
        types: of its definition.
        encoding: "cdr" (ROS 2) or "ros1".
        wanted: the paths to read; None for all numbers and short arrays of them that the first message has,
            without covariances, stamps and layouts.
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
        """Numbers a message."""
        return sum(1 if n is None else n for _, n in self.columns or ())

    def read(self, data: Bytes, start: Stamps, length: Stamps) -> tuple[Stamps, Array]:
        """Header stamps (n,) ns, zeros where there is no header, and numbers (n, width).

        Args:
            data: bytes in which the messages lie.
            start, length: (n,) of each message.

        Raises:
            MagycError: a message is shorter than its type, holds other fields than the first, or is serialized in a
                way that is not known.
        """
        stamp = np.zeros(len(start), dtype=np.int64)
        rest = np.arange(len(start))
        parts: list[tuple[NDArray[np.intp], Array]] = []
        for table in self._tables:
            if len(rest):
                rest = self._rows(table, data, start, length, rest, stamp, parts)
        while len(rest):
            if len(self._tables) == _MOST_LAYOUTS:
                raise MagycError(
                    f"{self.topic} ({self.kind}): its messages have more than {_MOST_LAYOUTS} layouts, by the lengths "
                    "of texts and lists in them"
                )
            first = rest[0]
            table = self._look(
                data[start[first] : start[first] + length[first]].tobytes(), self._seen + int(first)
            )
            self._tables.append(table)
            rest = self._rows(table, data, start, length, rest, stamp, parts)
        self._seen += len(start)
        if len(parts) == 1:
            return stamp, parts[0][1]
        value = np.empty((len(start), self.width))
        for rows, numbers in parts:
            value[rows] = numbers
        return stamp, value

    def _look(self, message: bytes, index: int) -> FieldLayout:
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
        """Places of single elements that are wanted, as "orientation_covariance[0]".

        Raises:
            MagycError: the message has no such field, or not so many elements.
        """
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
        rest: NDArray[np.intp],
        stamp: Stamps,
        parts: list[tuple[NDArray[np.intp], Array]],
    ) -> NDArray[np.intp]:
        """Read those of the rows `rest` that are as the table says; the others are returned."""
        alike = length[rest] == table.length
        if self._encoding != "ros1" and alike.any():
            alike[alike] = (data[start[rest[alike]] + 1] == (table.order == "<")) & (data[start[rest[alike]]] == 0)
        for offset, value in table.inner:
            if not alike.any():
                return rest
            alike[alike] = _at(data, start[rest[alike]], offset, f"{table.order}u4") == value
        rows = rest[alike]
        if not len(rows):
            return rest
        place = start[rows]
        if self.stamped:
            seconds = _at(data, place, table.places["header.stamp.sec"][0], f"{table.order}i4").astype(np.int64)
            nanoseconds = _at(data, place, table.places["header.stamp.nanosec"][0], f"{table.order}u4")
            stamp[rows] = seconds * NANOSECONDS + nanoseconds
        parts.append((rows, self._numbers(table, data, place)))
        return rest[~alike]

    def _numbers(self, table: FieldLayout, data: Bytes, place: Stamps) -> Array:
        value = np.empty((len(place), self.width))
        column = 0
        runs: list[tuple[str, list[int], int]] = []  # of one type, so that each is one look into the bytes
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
    """The numbers of a type that stand at any bytes."""
    size = np.dtype(kind).itemsize
    everywhere: NDArray[Any] = np.ndarray((len(data) - size + 1,), dtype=kind, buffer=data, strides=(1,))
    return everywhere[place + offset]


def _number(path: str, code: str, count: int | None) -> bool:
    """Whether a field is a channel."""
    parents = path.split(".")[:-1]
    if code == "V" or any(p in ("header", "stamp", "layout") for p in parents):
        return False
    return count is None or (0 < count <= _LONGEST_ARRAY and "covariance" not in path.split(".")[-1])
