"""The messages of an ArduPilot dataflash log as arrays. The log itself describes the format of each type.

A message is 0xA3 0x95, the number of its type, and its packed fields. Messages follow each other directly, so that
their places follow from the lengths of their types. Where this chain breaks (damage, or the two bytes by chance inside
a message) it is resumed at the next message. A type may be described again, in another form: each message has that of
the last description before it.
"""

from __future__ import annotations

import mmap
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.dataflash_types import (
    DESCRIPTION,
    FORMAT,
    TIMES,
    MessageType,
    described,
    in_common,
    same_layout,
    text,
)

Places = NDArray[np.int64]

MAGIC = b"\xa3\x95"
_SEARCHED = 1 << 24  # bytes searched at once
_PAGE = 528  # bytes at the end that block-wise loggers leave unwritten
_LATEST = 10**18  # ns since boot, 31 years; a larger stamp is damaged


@dataclass
class Dataflash:
    """A log, open until `close`.

    Attributes:
        kinds: {name: type}; of a type that was described in several ways, with the columns that all have.
        boots: bytes at which the log begins anew, after the vehicle was switched on again.
        skipped: number of bytes that belong to no message.
        misfits: {name: number of messages} whose format does not fit their length, beside others of that name.
    """

    kinds: dict[str, MessageType] = field(default_factory=dict)
    boots: Places = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    skipped: int = 0
    misfits: dict[str, int] = field(default_factory=dict)
    _data: Any = None
    _bytes: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, dtype=np.uint8))
    _parts: dict[str, list[tuple[MessageType, Places]]] = field(default_factory=dict)

    def places(self, kind: str) -> Places:
        """Return the bytes at which the messages of a type begin, ascending."""
        parts = [places for _, places in self._parts.get(kind, [])]
        return np.sort(np.concatenate(parts)) if parts else np.empty(0, dtype=np.int64)

    def only_in_part(self, kind: str, columns: Sequence[str]) -> list[str]:
        """Return which columns a type has in a part of the log, and not, or not of that sort, in another."""
        types = [one for one, _ in self._parts.get(kind, [])]
        common = in_common(types).columns if types else ()
        return [c for c in columns if c not in common and any(c in one.columns for one in types)]

    def column(self, kind: str, name: str, places: Places | None = None) -> NDArray[Any]:
        """Return one column of all messages of a type (or those at `places`): numbers in its unit, or bytes.

        Raises:
            MagycError: the type's format does not fit the length of its messages.
        """
        at = self.places(kind) if places is None else places
        parts = self._parts[kind]
        if len(parts) == 1:
            return self._read(parts[0][0], name, at)
        own = [np.isin(at, there) for _, there in parts]
        values = [self._read(one, name, at[rows]) for (one, _), rows in zip(parts, own, strict=True)]
        result = np.empty(len(at), dtype=np.result_type(*values))
        for rows, value in zip(own, values, strict=True):
            result[rows] = value
        return result

    def _read(self, known: MessageType, name: str, at: Places) -> NDArray[Any]:
        if known.fields is None:
            raise MagycError(
                f"{known.name}: its format {known.codes!r} does not fill its {known.length} bytes; the log is damaged"
            )
        rows = len(self._bytes) - known.length + 1  # number of bytes at which a message of this length can begin
        everywhere: NDArray[Any] = (
            np.ndarray((rows,), dtype=known.fields, buffer=self._data, offset=3, strides=(1,))
            if rows > 0
            else np.empty(0, dtype=known.fields)
        )
        value, divisor = everywhere[name][at], known.divisor(name)
        return value if divisor is None else value / divisor

    def stamps(self, kind: str, places: Places) -> tuple[Places, NDArray[np.bool_]]:
        """Return the stamps (n,) in ns since boot, and the mask (n,) of the possible ones."""
        time = self.kinds[kind].time
        assert time is not None
        value = self.column(kind, time, places)
        possible = value < _LATEST // TIMES[time]
        return np.where(possible, value, 0).astype(np.int64) * TIMES[time], possible

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
    descriptions = heads[numbers == FORMAT]
    lengths: NDArray[np.int64] | None = None
    # A description found inside another message falsifies the lengths; the chain of messages then removes it.
    for _ in range(4):
        before, lengths = lengths, _lengths(log, heads, numbers, descriptions)
        if before is not None and np.array_equal(before, lengths):
            break
        chain, log.skipped = _chain(heads, lengths, len(log._bytes))
        descriptions = heads[chain][numbers[chain] == FORMAT]
    _sort(log, heads[chain], numbers[chain], descriptions)
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


def _lengths(log: Dataflash, heads: Places, numbers: NDArray[np.uint8], descriptions: Places) -> NDArray[np.int64]:
    """Return the length of the message at each head, by the description before it; 0 without one."""
    log._parts = {"FMT": [(DESCRIPTION, descriptions)]}
    whole = descriptions[descriptions + DESCRIPTION.length <= len(log._bytes)]
    number, length = log.column("FMT", "Type", whole), log.column("FMT", "Length", whole).astype(np.int64)
    length[length < len(MAGIC) + 1] = 0
    result = np.where(numbers == FORMAT, DESCRIPTION.length, 0).astype(np.int64)
    for one in np.unique(number[number != FORMAT]).tolist():
        rows, mine = np.flatnonzero(numbers == one), number == one
        result[rows] = length[mine][_in_force(whole[mine], heads[rows])]
    return result


def _in_force(descriptions: Places, places: Places) -> NDArray[np.intp]:
    """Return the index of the last description before each place; of the first, where none is before it."""
    return np.maximum(np.searchsorted(descriptions, places, side="right") - 1, 0)


def _chain(heads: Places, length: NDArray[np.int64], size: int) -> tuple[NDArray[np.intp], int]:
    """Return the indices of the heads that are messages, and the number of bytes that belong to none.

    Args:
        heads: where messages may begin.
        length: of the message at each; 0 if it is not known.
        size: of the file.
    """
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


def _sort(log: Dataflash, messages: Places, numbers: NDArray[np.uint8], descriptions: Places) -> None:
    """Sort the messages by their types, and set `kinds`, `boots` and the parts of each kind."""
    log._parts = {"FMT": [(DESCRIPTION, descriptions)]}
    rows = zip(*(log.column("FMT", c, descriptions).tolist() for c in DESCRIPTION.columns), strict=True)
    types = [described(*row) for row in rows]
    of_formats = [place for place, one in zip(descriptions.tolist(), types, strict=True) if one.number == FORMAT]
    log.boots = np.array(of_formats[1:], dtype=np.int64)
    found: list[tuple[int, Places]] = []  # index of a description, the messages that have it
    for number in np.unique([one.number for one in types]).tolist():
        mine = np.array([k for k, one in enumerate(types) if one.number == number], dtype=np.int64)
        different = [
            True,
            *(not same_layout(types[a], types[b]) for a, b in pairwise(mine.tolist())),
        ]
        mine = mine[different]
        there = messages[numbers == number]
        which = _in_force(descriptions[mine], there)
        found += [(int(k), there[which == i]) for i, k in enumerate(mine) if (which == i).any()]
    _set_parts(log, types, found)
    units = log.kinds.get("FMTU")
    if units is None or not (units.holds("FmtType", "numbers") and units.holds("UnitIds", "text")):
        return
    columns = (log.places("FMTU"), log.column("FMTU", "FmtType"), log.column("FMTU", "UnitIds"))
    for at, number, letters in zip(*(c.tolist() for c in columns), strict=True):
        place = text(letters).find("#") if isinstance(letters, bytes) else -1
        mine = np.array([k for k, _ in found if types[k].number == number], dtype=np.int64)
        if len(mine):
            k = mine[_in_force(descriptions[mine], np.array([at]))[0]]
            if 0 <= place < len(types[k].columns):
                types[k] = replace(types[k], instance=types[k].columns[place])
    _set_parts(log, types, found)


def _set_parts(log: Dataflash, types: Sequence[MessageType], found: Sequence[tuple[int, Places]]) -> None:
    """Set the parts of each kind in the order of the log, without those whose format does not fit, if others do."""
    parts: dict[str, list[tuple[MessageType, Places]]] = {}
    for k, places in sorted(found, key=lambda part: part[0]):
        parts.setdefault(types[k].name, []).append((types[k], places))
    for name, mine in parts.items():
        fitting = [part for part in mine if part[0].fields is not None]
        if 0 < len(fitting) < len(mine):
            log.misfits[name] = sum(len(places) for one, places in mine if one.fields is None)
        parts[name] = fitting or mine[-1:]
    log._parts = parts
    log.kinds = {name: _known([one for one, _ in mine]) for name, mine in parts.items()}


def _known(types: Sequence[MessageType]) -> MessageType:
    return types[0] if len(types) == 1 else in_common(types)


def names(values: Sequence[bytes]) -> list[str]:
    """Return a text column as text."""
    return [text(value) for value in values]
