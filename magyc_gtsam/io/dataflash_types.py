"""Types of messages of an ArduPilot dataflash log, by the descriptions in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

_FIELDS = {
    **{"b": "i1", "B": "u1", "M": "i1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8"},
    **{"g": "<f2", "f": "<f4", "d": "<f8", "n": "S4", "N": "S16", "Z": "S64", "a": "(32,)<i2"},
    **{"c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4"},
}
_DIVISORS = {**dict.fromkeys("cCeE", 100.0), "L": 1 / 1.0e-7}
TIMES = {"TimeUS": 1_000, "TimeMS": 1_000_000}  # ns; the second before 2014
FORMAT = 0x80  # the type that describes the others


@dataclass(frozen=True, eq=False)
class MessageType:
    """A type of message.

    Attributes:
        name: such as "MAG".
        number: identifies the type in the log.
        length: bytes of a message, with the three bytes before its fields.
        codes: the letter of each column's type.
        columns: names of the columns.
        fields: the packed fields; None if they do not fill the length.
        instance: the column that numbers the instances, by the log's units; None if the log has none.
    """

    name: str
    number: int
    length: int
    codes: str
    columns: tuple[str, ...]
    fields: np.dtype[Any] | None
    instance: str | None = None

    @property
    def time(self) -> str | None:
        """The column of time stamps; None without one."""
        return next((c for c in TIMES if self.holds(c, "numbers")), None)

    def holds(self, column: str, what: Literal["numbers", "text"]) -> bool:
        """Return whether there is such a column, and it has that type: damage can turn a number into text."""
        if column not in self.columns or self.fields is None:
            return False
        code = self.codes[self.columns.index(column)]
        return code in "nNZ" if what == "text" else code not in "nNZa"

    def divisor(self, column: str) -> float | None:
        """Return by what the numbers of a column are divided; None for 1."""
        return _DIVISORS.get(self.codes[self.columns.index(column)])


DESCRIPTION = MessageType(
    "FMT",
    FORMAT,
    89,
    "BBnNZ",
    ("Type", "Length", "Name", "Format", "Columns"),
    np.dtype([("Type", "u1"), ("Length", "u1"), ("Name", "S4"), ("Format", "S16"), ("Columns", "S64")]),
)


def described(number: int, length: int, name: bytes, codes: bytes, columns: bytes) -> MessageType:
    """Return the type that a description defines."""
    letters, names = text(codes), tuple(text(columns).split(",")) if text(columns) else ()
    fields = None
    if len(names) == len(letters) == len(set(names)) and all(
        n and c in _FIELDS for n, c in zip(names, letters, strict=True)
    ):
        fields = np.dtype([(n, _FIELDS[c]) for n, c in zip(names, letters, strict=True)])
        fields = fields if fields.itemsize + 3 == length else None
    return MessageType(text(name), number, length, letters, names, fields)


def same_layout(one: MessageType, other: MessageType) -> bool:
    """Return whether the messages of two types are read alike."""
    return (one.name, one.length, one.codes, one.columns) == (other.name, other.length, other.codes, other.columns)


def in_common(types: Sequence[MessageType]) -> MessageType:
    """Return the last of the types with the columns that all have, as numbers or as text."""
    last = types[-1]
    held = [c for c in last.columns for what in ("numbers", "text") if all(one.holds(c, what) for one in types)]
    codes = "".join(last.codes[last.columns.index(c)] for c in held)
    instance = last.instance if last.instance in held else None
    return replace(last, columns=tuple(held), codes=codes, instance=instance)


def text(value: bytes) -> str:
    """Return the text before the first zero."""
    return value.split(b"\0")[0].decode("latin-1")
