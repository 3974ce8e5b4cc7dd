"""The records of an MCAP file, its messages as blocks of bytes.

What a file asks for is looked at before it is granted: a chunk is unpacked up to the size that it names, and that
is bounded. A chunk or record that is damaged costs itself.
"""

from __future__ import annotations

import os
import struct
import zlib
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

MAGIC = b"\x89MCAP0\r\n"
METADATA = "magyc-gtsam"  # holds what ROS messages have no field for
HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, unpacked size, checksum, length of the compression's name
_MESSAGE_HEAD = np.dtype([("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")])
LARGEST_CHUNK = 1 << 28  # bytes, unpacked; recorders write chunks of 1 to 16 MB
_LARGEST_RECORD = 1 << 24  # bytes of a schema, a channel or metadata, and of a message outside of chunks
_BEYOND_ANY = 1 << 32  # bytes; a record that announces more was not written so
_MOST_OTHERS = 100_000  # schemas, channels and records of other kinds in a chunk
_AT_ONCE = 1 << 22  # bytes of messages outside of chunks
UNPACKED = (100, 1 << 26)  # times the file, and bytes: measurements pack to a fifth, their headers to a tenth


class Damage(MagycError):
    """A record or chunk that cannot be read; the rest of the file can."""


@dataclass(frozen=True, eq=False)
class Block:
    """Messages: the bytes in which they lie, and of each its channel, time of recording (ns) and place."""

    data: NDArray[np.uint8]
    channel: NDArray[np.uint16]
    log_time: NDArray[np.int64]
    start: NDArray[np.int64]
    length: NDArray[np.int64]


Record: TypeAlias = Schema | Channel | Metadata | Block


def records(path: Path, notes: list[str], report: Callable[[float], None]) -> Iterator[Record]:
    """All records in order; where the file is damaged, those before and behind, and a note.

    Raises:
        MagycError: not an MCAP file, or one that unpacks to far more than measurements do.
    """
    size = os.path.getsize(path)
    budget = UNPACKED[0] * size + UNPACKED[1]
    whole = damaged = False
    losses: dict[str, list[str]] = {"chunk": [], "record": [], "message": []}
    with open(path, "rb") as file:
        place = file.seek(len(MAGIC))
        loose = _Loose(file)
        while not whole and (head := file.read(HEAD.size)):
            opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, size)
            end = place + HEAD.size + length
            if end > size:
                damaged = length > _BEYOND_ANY
                break
            if opcode == Opcode.MESSAGE and _MESSAGE_HEAD.itemsize <= length <= _LARGEST_RECORD:
                yield from loose.add(place + HEAD.size, length)
            else:
                yield from loose.taken()
            if opcode == Opcode.MESSAGE and length < _MESSAGE_HEAD.itemsize:
                losses["message"].append("it is cut off")
            elif opcode == Opcode.CHUNK and length > LARGEST_CHUNK:
                losses["chunk"].append(f"it is of {length} bytes, {LARGEST_CHUNK} are granted")
            elif opcode == Opcode.CHUNK or (opcode in _PARSED and length <= _LARGEST_RECORD):
                content = file.read(length)
                try:
                    if opcode == Opcode.CHUNK:
                        report(end / size)
                        data = unpacked(content)
                        budget -= len(data)
                        if budget < 0:
                            raise MagycError(
                                f"{path}: unpacks to more than {UNPACKED[0]} times its {size} bytes, which no log of "
                                "measurements does; refused before it fills the memory"
                            )
                        yield from broken_up(data)
                    else:
                        yield parsed(opcode, content)
                except Damage as error:
                    losses["chunk" if opcode == Opcode.CHUNK else "record"].append(shortened(error))
            whole = opcode == Opcode.FOOTER
            place = file.seek(end)
        yield from loose.taken()
    if place <= len(MAGIC):
        raise MagycError(f"{path}: not an MCAP file (it ends too early)")
    for what, reasons in losses.items():
        if len(reasons) == 1:
            notes.append(f"a {what} is damaged and was left out ({reasons[0]})")
        elif reasons:
            notes.append(f"{len(reasons)} {what}s are damaged and were left out (the first: {reasons[0]})")
    if damaged:
        notes.append(f"the file is damaged at byte {place} (a record of {length} bytes is announced)")
    elif not whole:
        notes.append(f"the file is cut off after {size} bytes (no footer)")
    report(1.0)


class _Loose:
    """Messages outside of chunks, put together to blocks."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._places: list[tuple[int, int]] = []

    def add(self, start: int, length: int) -> Iterator[Block]:
        if self._places and start - self._places[0][0] > _AT_ONCE:
            yield from self.taken()
        self._places.append((start, length))

    def taken(self) -> Iterator[Block]:
        if not self._places:
            return
        back = self._file.tell()
        first = self._places[0][0]
        last, length = self._places[-1]
        self._file.seek(first)
        data = self._file.read(last + length - first)
        self._file.seek(back)
        places = [(start - first, length) for start, length in self._places if start + length - first <= len(data)]
        self._places = []
        yield from block_of(data, [start for start, _ in places], [length for _, length in places])


def unpacked(content: bytes) -> bytes:
    """The records in a chunk.

    Raises:
        Damage: it does not unpack, or not to what it says, or is larger than is granted.
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


def decompressed(data: bytes, compression: str, size: int, checksum: int) -> bytes:
    """The records in a chunk, as they lie in `data`, of which it says that they are so many bytes.

    Raises:
        Damage: as `unpacked`.
    """
    if compression in ("zstd", "lz4"):
        if size > LARGEST_CHUNK:
            raise Damage(f"it asks for {size} bytes, {LARGEST_CHUNK} are granted")
        try:
            data = _zstd(data, size) if compression == "zstd" else _lz4(data, size)
        except (RuntimeError, ValueError, MemoryError) as error:  # lz4 raises RuntimeError
            raise Damage(str(error) or type(error).__name__) from None
    if checksum and (calculated := zlib.crc32(data)) != checksum:
        raise Damage(f"crc validation failed in Chunk, expected: {checksum}, calculated: {calculated}")
    return data


def _zstd(data: bytes, size: int) -> bytes:
    import zstandard  # which a file with chunks of its kind needs

    try:
        named = zstandard.frame_content_size(data)
        if named > size:
            raise ValueError(f"it unpacks to {named} bytes, not to {size}")
        decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK)
        return decompressor.decompress(data, max_output_size=max(size, 1))
    except zstandard.ZstdError as error:
        raise ValueError(str(error) or type(error).__name__) from None


def _lz4(data: bytes, size: int) -> bytes:
    import lz4.frame  # likewise

    decompressor = lz4.frame.LZ4FrameDecompressor()
    # An input that is not bounded would be unpacked in full before its length is known.
    result = bytes(decompressor.decompress(data, max_length=size + 1))
    if len(result) > size:
        raise ValueError(f"it unpacks to more than {size} bytes")
    if not decompressor.eof:
        raise ValueError("it ends too early")
    return result


def broken_up(data: bytes) -> list[Record]:
    """The schemas, channels and messages in the records of a chunk.

    Raises:
        Damage: a record is cut off or cannot be read, or there are many that no chunk holds.
    """
    found: list[Record] = []
    others = 0
    starts, lengths = (
        array("q"),
        array("q"),
    )  # of messages; an object of Python's for each would take ten times as much
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
                raise Damage(f"it holds more than {_MOST_OTHERS} records that are no messages")
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                found.append(parsed(opcode, data[place : place + length]))
        place += length
    return [*found, *block_of(data, starts, lengths)]


def block_of(data: bytes, starts: Sequence[int], lengths: Sequence[int]) -> list[Block]:
    """The messages whose records begin at these places in `data`; none where there are none.

    Raises:
        Damage: one is shorter than its head.
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
    """A schema, channel or metadata record.

    Raises:
        Damage: it is cut off, or its text cannot be decoded.
    """
    try:
        record: Schema | Channel | Metadata = _PARSED[Opcode(opcode)].read(ReadDataStream(BytesIO(content)))
    except (EndOfFile, struct.error, UnicodeDecodeError, MemoryError, OverflowError) as error:
        raise Damage(f"a record cannot be read: {error or type(error).__name__}") from None
    return record
