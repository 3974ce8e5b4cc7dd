"""The records of an MCAP file, with messages as blocks of bytes.

Sizes in the file are checked before memory is allocated: a chunk is unpacked up to the size that it declares, and that
size is limited. A damaged chunk or record is left out; the rest of the file is read.
"""

from __future__ import annotations

import os
import struct
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, TypeAlias

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.mcap_compression import LARGEST_CHUNK, Damage, allowance, decompressed

MAGIC = b"\x89MCAP0\r\n"
METADATA = "magyc-gtsam"  # name of the record with data for which ROS messages have no field
CALIBRATED_TOPIC = "calibrated "  # begins a key there, followed by a topic whose field is calibrated already
HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, unpacked size, checksum, length of the compression's name
_MESSAGE_HEAD = np.dtype([("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")])
_LARGEST_RECORD = 1 << 24  # bytes of a schema, a channel or metadata, and of a message outside of chunks
_IMPOSSIBLE_LENGTH = 1 << 32  # bytes; a record that declares more is damaged
_MOST_OTHERS = 100_000  # schemas, channels and records of other kinds in a chunk
_BLOCK = 1 << 22  # bytes of messages outside of chunks that form a block


@dataclass(frozen=True, eq=False)
class Block:
    """A block of n messages.

    Attributes:
        data: bytes that contain the messages.
        channel: (n,) channel of each.
        log_time: (n,) ns, time of recording.
        start: (n,) first byte of each in `data`.
        length: (n,) bytes.
    """

    data: NDArray[np.uint8]
    channel: NDArray[np.uint16]
    log_time: NDArray[np.int64]
    start: NDArray[np.int64]
    length: NDArray[np.int64]


Record: TypeAlias = Schema | Channel | Metadata | Block


def records(path: Path, notes: list[str], report: Callable[[float], None]) -> Iterator[Record]:
    """Yield all readable records in order, and note damage.

    Args:
        path: the file.
        notes: list to which remarks on damage are appended.
        report: called with the fraction done.

    Raises:
        MagycError: not an MCAP file, or it unpacks to more than the limit.
    """
    size = os.path.getsize(path)
    take = allowance(path)
    whole = damaged = False
    losses: dict[str, list[str]] = {"chunk": [], "record": [], "message": []}
    with open(path, "rb") as file:
        place = file.seek(len(MAGIC))
        unchunked = _UnchunkedMessages(file)
        while not whole and (head := file.read(HEAD.size)):
            opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, size)
            end = place + HEAD.size + length
            if end > size:
                damaged = length > _IMPOSSIBLE_LENGTH
                break
            if opcode == Opcode.MESSAGE and _MESSAGE_HEAD.itemsize <= length <= _LARGEST_RECORD:
                yield from unchunked.add(place + HEAD.size, length)
            else:
                yield from unchunked.flush()
            if opcode == Opcode.MESSAGE and length < _MESSAGE_HEAD.itemsize:
                losses["message"].append("it is cut off")
            elif opcode == Opcode.CHUNK and length > LARGEST_CHUNK:
                losses["chunk"].append(f"it has {length} bytes, more than the limit of {LARGEST_CHUNK}")
            elif opcode == Opcode.CHUNK or (opcode in _PARSED and length <= _LARGEST_RECORD):
                content = file.read(length)
                try:
                    if opcode == Opcode.CHUNK:
                        report(end / size)
                        data = unpacked(content)
                        take(len(data))
                        yield from broken_up(data)
                    else:
                        yield parsed(opcode, content)
                except Damage as error:
                    losses["chunk" if opcode == Opcode.CHUNK else "record"].append(shortened(error))
            whole = opcode == Opcode.FOOTER
            place = file.seek(end)
        yield from unchunked.flush()
    if place <= len(MAGIC):
        raise MagycError(f"{path}: not an MCAP file (it ends too early)")
    for what, reasons in losses.items():
        if len(reasons) == 1:
            notes.append(f"a {what} is damaged and was left out ({reasons[0]})")
        elif reasons:
            notes.append(f"{len(reasons)} {what}s are damaged and were left out (the first: {reasons[0]})")
    if not whole:
        notes.append(unfinished(place, size, length if damaged else 0))
    report(1.0)


def unfinished(place: int, size: int, length: int) -> str:
    """Return why a file of `size` bytes has no footer, if its record at byte `place` declares a length."""
    if length > _IMPOSSIBLE_LENGTH:
        return f"the file is damaged at byte {place} (a record declares a length of {length} bytes)"
    return f"the file is cut off after {size} bytes (no footer)"


class _UnchunkedMessages:
    """Messages outside of chunks, collected into blocks."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._places: list[tuple[int, int]] = []

    def add(self, start: int, length: int) -> Iterator[Block]:
        """Add a message; yield a block if enough were collected."""
        if self._places and start - self._places[0][0] > _BLOCK:
            yield from self.flush()
        self._places.append((start, length))

    def flush(self) -> Iterator[Block]:
        """Yield a block of the collected messages, if any."""
        if not self._places:
            return
        position = self._file.tell()
        first = self._places[0][0]
        last, length = self._places[-1]
        self._file.seek(first)
        data = self._file.read(last + length - first)
        self._file.seek(position)
        places = [(start - first, length) for start, length in self._places if start + length - first <= len(data)]
        self._places = []
        yield from block_of(data, [start for start, _ in places], [length for _, length in places])


def unpacked(content: bytes) -> bytes:
    """Return the bytes of the records in a chunk.

    Raises:
        Damage: the chunk cannot be unpacked, differs from its declared size or checksum, or is too large.
    """
    try:
        _, _, size, checksum, name = _CHUNK_HEAD.unpack_from(content)
        compression = content[_CHUNK_HEAD.size : _CHUNK_HEAD.size + name].decode("ascii")
        (length,) = struct.unpack_from("<Q", content, _CHUNK_HEAD.size + name)
    except (struct.error, UnicodeDecodeError) as error:
        raise Damage(f"its head cannot be read: {error}") from None
    data = content[_CHUNK_HEAD.size + name + 8 :][:length]
    if len(data) < length:
        raise Damage("its records are cut off")
    return decompressed(data, compression, size, checksum)


def broken_up(data: bytes) -> list[Record]:
    """Return the schemas, channels and messages in the unpacked records of a chunk.

    Raises:
        Damage: a record is cut off or cannot be read, or there are too many that are not messages.
    """
    definitions: list[Record] = []
    others = 0
    starts, lengths = array("q"), array("q")  # of messages; lists of Python integers take ten times the memory
    place, size, unpack, add_start, add_length = 0, len(data), HEAD.unpack_from, starts.append, lengths.append
    while place < size:
        try:
            opcode, length = unpack(data, place)
        except struct.error:
            raise Damage("a record in it is cut off") from None
        place += 9
        if place + length > size:
            raise Damage("a record in it is cut off")
        if opcode == 5:  # a message
            add_start(place)
            add_length(length)
        else:
            others += 1
            if others > _MOST_OTHERS:
                raise Damage(f"it holds more than {_MOST_OTHERS} records that are not messages")
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                definitions.append(parsed(opcode, data[place : place + length]))
        place += length
    return [*definitions, *block_of(data, starts, lengths)]


def block_of(data: bytes, starts: Sequence[int], lengths: Sequence[int]) -> list[Block]:
    """Return the messages whose records begin at the places `starts` in `data`, as one block; [] without any.

    Raises:
        Damage: a message is shorter than its header.
    """
    if not len(starts):
        return []
    start, length = np.asarray(starts, dtype=np.int64), np.asarray(lengths, dtype=np.int64)
    if length.min() < _MESSAGE_HEAD.itemsize:
        raise Damage("a message in it is cut off")
    content = np.frombuffer(data, dtype=np.uint8)
    everywhere: NDArray[np.void] = np.ndarray(
        (len(content) - _MESSAGE_HEAD.itemsize + 1,), dtype=_MESSAGE_HEAD, buffer=content, strides=(1,)
    )
    return [
        Block(
            content,
            everywhere["channel"][start],
            everywhere["log_time"][start].astype(np.int64),
            start + _MESSAGE_HEAD.itemsize,
            length - _MESSAGE_HEAD.itemsize,
        )
    ]


_PARSED = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata}


def parsed(opcode: int, content: bytes) -> Schema | Channel | Metadata:
    """Parse a schema, channel or metadata record.

    Raises:
        Damage: the record is cut off, or its text cannot be decoded.
    """
    try:
        record: Schema | Channel | Metadata = _PARSED[Opcode(opcode)].read(ReadDataStream(BytesIO(content)))
    except (EndOfFile, struct.error, UnicodeDecodeError, MemoryError, OverflowError) as error:
        raise Damage(f"a record cannot be read: {error or type(error).__name__}") from None
    return record
