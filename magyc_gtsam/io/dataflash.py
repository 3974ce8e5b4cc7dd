"""The messages of an ArduPilot dataflash log as arrays. The log itself describes the format of each type.

A message is 0xA3 0x95, the number of its type, and its packed fields. Messages follow each other directly, so that
their places follow from the lengths of their types. Where this chain breaks (damage, or the two bytes by chance inside
a message) it is resumed at the next message.
"""

from __future__ import annotations

import mmap
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError

Places = NDArray[np.int64]

MAGIC = b"\xa3\x95"
_FORMAT = 0x80  # the type that describes the others
_FIELDS = {
    **{"b": "i1", "B": "u1", "M": "i1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8"},
    **{"g": "<f2", "f": "<f4", "d": "<f8", "n": "S4", "N": "S16", "Z": "S64", "a": "(32,)<i2"},
    **{"c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4"},
}
_DIVISORS = {**dict.fromkeys("cCeE", 100.0), "L": 1 / 1.0e-7}
_SEARCHED = 1 << 24  # bytes searched at once
_PAGE = 528  # bytes at the end that block-wise loggers leave unwritten
_TIMES = {"TimeUS": 1_000, "TimeMS": 1_000_000}  # ns; the second before 2014
_LATEST = 10**18  # ns since boot, 31 years; a larger stamp is damaged


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
        return next((c for c in _TIMES if self.holds(c, "numbers")), None)

    def holds(self, column: str, what: Literal["numbers", "text"]) -> bool:
        """Return whether there is such a column, and it has that type: damage can turn a number into text."""
        if column not in self.columns or self.fields is None:
            return False
        code = self.codes[self.columns.index(column)]
        return code in "nNZ" if what == "text" else code not in "nNZa"


_DESCRIPTION = MessageType(
    "FMT",
    _FORMAT,
    89,
    "BBnNZ",
    ("Type", "Length", "Name", "Format", "Columns"),
    np.dtype([("Type", "u1"), ("Length", "u1"), ("Name", "S4"), ("Format", "S16"), ("Columns", "S64")]),
)


@dataclass
class Dataflash:
    """A log, open until `close`.

    Attributes:
        kinds: {name: type}.
        skipped: number of bytes that belong to no message.
    """

    kinds: dict[str, MessageType] = field(default_factory=dict)
    skipped: int = 0
    _data: Any = None
    _bytes: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, dtype=np.uint8))
    _places: dict[int, Places] = field(default_factory=dict)

    def places(self, kind: str) -> Places:
        """Return the bytes at which the messages of a type begin, ascending."""
        known = self.kinds.get(kind)
        empty = np.empty(0, dtype=np.int64)
        return empty if known is None else self._places.get(known.number, empty)

    def column(self, kind: str, name: str, places: Places | None = None) -> NDArray[Any]:
        """Return one column of all messages of a type (or those at `places`): numbers in its unit, or bytes.

        Raises:
            MagycError: the type's format does not fit the length of its messages.
        """
        known = self.kinds[kind]
        if known.fields is None:
            raise MagycError(
                f"{kind}: its format {known.codes!r} does not fill its {known.length} bytes; the log is damaged"
            )
        at = self.places(kind) if places is None else places
        rows = len(self._bytes) - known.length + 1  # number of bytes at which a message of this length can begin
        everywhere: NDArray[Any] = (
            np.ndarray((rows,), dtype=known.fields, buffer=self._data, offset=3, strides=(1,))
            if rows > 0
            else np.empty(0, dtype=known.fields)
        )
        value = everywhere[name][at]
        divisor = _DIVISORS.get(known.codes[known.columns.index(name)])
        return value if divisor is None else value / divisor

    def stamps(self, kind: str, places: Places) -> tuple[Places, NDArray[np.bool_]]:
        """Return the stamps (n,) in ns since boot, and the mask (n,) of the possible ones."""
        time = self.kinds[kind].time
        assert time is not None
        value = self.column(kind, time, places)
        possible = value < _LATEST // _TIMES[time]
        return np.where(possible, value, 0).astype(np.int64) * _TIMES[time], possible

    def close(self) -> None:
        """Close the file."""
        self._bytes = np.empty(0, dtype=np.uint8)
        self._data = None


def load(path: Path) -> Dataflash:
    """Find the messages of a log.

    Raises:
        MagycError: the file describes no message.
    """
    with open(path, "rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    log = Dataflash(_data=data, _bytes=np.frombuffer(data, dtype=np.uint8))
    heads = _heads(log._bytes)
    numbers = log._bytes[heads + 2]
    descriptions = heads[numbers == _FORMAT]
    lengths: NDArray[np.int64] | None = None
    # A description found inside another message falsifies the lengths; the chain of messages then removes it.
    for _ in range(4):
        before, lengths = lengths, _lengths(log, descriptions)
        if before is not None and np.array_equal(before, lengths):
            break
        chain, log.skipped = _chain(heads, numbers, lengths, len(log._bytes))
        descriptions = heads[chain][numbers[chain] == _FORMAT]
    messages, types = heads[chain], numbers[chain]
    order = np.argsort(types, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(types[order])) + 1):
        if len(part):
            log._places[int(types[part[0]])] = messages[part]
    log.kinds = _kinds(log, descriptions)
    if not log.kinds:
        raise MagycError(f"{path}: not an ArduPilot log (it describes no messages); is the file damaged?")
    return log


def _heads(data: NDArray[np.uint8]) -> Places:
    """Return all places of the two bytes that begin a message and are followed by a type."""
    parts = []
    for first in range(0, len(data) - 2, _SEARCHED):
        part = data[first : first + _SEARCHED + 1]
        at = np.flatnonzero(part[:-1] == MAGIC[0])
        parts.append(first + at[part[at + 1] == MAGIC[1]])
    places = np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)
    return places[places < len(data) - 2]


def _lengths(log: Dataflash, descriptions: Places) -> NDArray[np.int64]:
    """Return the length (256,) of each type by its first description; 0 without one."""
    lengths = np.zeros(256, dtype=np.int64)
    lengths[_FORMAT] = _DESCRIPTION.length
    log.kinds = {"FMT": _DESCRIPTION}
    whole = descriptions[descriptions + _DESCRIPTION.length <= len(log._bytes)]
    number, length = log.column("FMT", "Type", whole), log.column("FMT", "Length", whole)
    for n, size in zip(number[::-1].tolist(), length[::-1].tolist(), strict=True):
        if n != _FORMAT:
            lengths[n] = size if size >= 3 else 0
    return lengths


def _chain(
    heads: Places, numbers: NDArray[np.uint8], lengths: NDArray[np.int64], size: int
) -> tuple[NDArray[np.intp], int]:
    """Return the indices of the heads that are messages, and the number of bytes that belong to none."""
    length = lengths[numbers]
    end = heads + length
    known = (length > 0) & (end <= size)
    linked = np.zeros(len(heads), dtype=bool)
    linked[:-1] = known[:-1] & (end[:-1] == heads[1:])
    breaks = np.append(np.flatnonzero(~linked), len(heads))
    following = np.append(np.where(known, np.searchsorted(heads, end), 0), len(heads))
    valid = np.append(np.flatnonzero(known), len(heads))
    runs: list[tuple[int, int]] = []
    covered = 0
    at = int(valid[0])
    while at < len(heads):
        last = int(breaks[np.searchsorted(breaks, at)])  # the chain holds from `at` to here
        stop = last + 1 if last < len(heads) and known[last] else last
        if stop > at:
            runs.append((at, stop))
            covered += int(end[stop - 1] - heads[at])
        at = int(following[last]) if stop > last else last + 1
        at = int(valid[np.searchsorted(valid, at)]) if at < len(heads) else at
    chain = np.concatenate([np.arange(a, b) for a, b in runs]) if runs else np.empty(0, dtype=np.intp)
    tail = size - int(end[chain[-1]]) if len(chain) else size
    return chain, size - covered - (tail if tail < _PAGE else 0)


def _kinds(log: Dataflash, descriptions: Places) -> dict[str, MessageType]:
    """Return the types by name, by their last description."""
    rows = zip(*(log.column("FMT", c, descriptions).tolist() for c in _DESCRIPTION.columns), strict=True)
    kinds: dict[int, MessageType] = {}
    for number, length, name, codes, columns in rows:
        kinds[number] = _kind(number, length, _text(name), _text(codes), _text(columns))
    by_name = {kind.name: kind for kind in kinds.values() if kind.number in log._places}
    log.kinds = by_name
    units = by_name.get("FMTU")
    if units is None or not (units.holds("FmtType", "numbers") and units.holds("UnitIds", "text")):
        return by_name
    for number, text in zip(
        log.column("FMTU", "FmtType").tolist(), log.column("FMTU", "UnitIds").tolist(), strict=True
    ):
        kind = kinds.get(number)
        place = _text(text).find("#") if isinstance(text, bytes) else -1
        if kind is not None and 0 <= place < len(kind.columns) and kind.name in by_name:
            by_name[kind.name] = MessageType(
                kind.name, kind.number, kind.length, kind.codes, kind.columns, kind.fields, kind.columns[place]
            )
    return by_name


def _kind(number: int, length: int, name: str, codes: str, columns: str) -> MessageType:
    """Return the type that a description defines."""
    names = tuple(columns.split(",")) if columns else ()
    fields = None
    if len(names) == len(codes) == len(set(names)) and all(
        n and c in _FIELDS for n, c in zip(names, codes, strict=True)
    ):
        fields = np.dtype([(n, _FIELDS[c]) for n, c in zip(names, codes, strict=True)])
        fields = fields if fields.itemsize + 3 == length else None
    return MessageType(name, number, length, codes, names, fields)


def _text(value: bytes) -> str:
    return value.split(b"\0")[0].decode("latin-1")


def names(values: Sequence[bytes]) -> list[str]:
    """Return a text column as text."""
    return [_text(value) for value in values]
