"""Reader of ROS bags: .bag of ROS 1 (by the package rosbags) and .db3 of ROS 2 (SQLite)."""

from __future__ import annotations

import bz2
import contextlib
import itertools
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.log_info import LogInfo
from magyc_gtsam.io.mcap_compression import LARGEST_CHUNK, Damage, allowance, decompressed
from magyc_gtsam.io.mcap_records import Block
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros_log import RosLog, collected, info_of, recording_of
from magyc_gtsam.recording import Recording

_BLOCK = 4096  # messages
_LARGEST = 1 << 24  # bytes of a message
_KEPT = 1 << 26  # bytes of unpacked chunks of ROS 1; a chunk usually has 768 kB
SQLITE = b"SQLite format 3\0"
_ZSTD = b"\x28\xb5\x2f\xfd"  # how a packed file or message begins; no message begins so unpacked


def read(path: Path, request: Request) -> Recording:
    """Read a bag; see `magyc_gtsam.io.read`.

    Raises:
        MagycError: rosbags is not installed, or the file is damaged.
    """
    request.only("ROS bag")
    return recording_of(_load, path, request)


def info(path: Path) -> LogInfo:
    """Describe a bag; see `magyc_gtsam.io.info`, which sets `problem`."""
    return info_of(_load, path, "bag")


def _load(path: Path, request: Request, wanted: Callable[[str, str], bool]) -> RosLog:
    """Load the topics of a bag; see `ros_log.Load`."""
    with open(path, "rb") as file:
        head = file.read(len(SQLITE))
    refuse_packed(path, head)
    notes: list[str] = []
    source = sqlite_records(path, notes, request.report) if head == SQLITE else _ros1(path, notes, request.report)
    return collected(path, source, request, wanted, notes, {})


def refuse_packed(path: Path, head: bytes) -> None:
    """Raise a MagycError if a file, which begins with `head`, is one that rosbag2 compressed."""
    if head.startswith(_ZSTD):
        raise MagycError(
            f"{path}: rosbag2 compressed the whole file; unpack it first (zstd -d {path.name} -o {path.stem})"
        )


def sqlite_records(
    path: Path, notes: list[str], report: Callable[[float], None]
) -> Iterator[Schema | Channel | Block]:
    """Yield the records of a ROS 2 bag; damage ends them with a note."""
    try:
        with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
            tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"topics", "messages"} <= tables:
                raise MagycError(f"{path}: not a ROS 2 bag (an SQLite file without topics and messages)")
            texts: dict[str, str] = {}
            if "message_definitions" in tables:  # since 2023; only unknown types need it
                written = base.execute(
                    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
                )
                texts = {str(kind): str(text) for kind, encoding, text in written if encoding == "ros2msg"}
            for number, name, kind, encoding in base.execute(
                "SELECT id, name, type, serialization_format FROM topics"
            ).fetchall():
                yield Schema(number, texts.get(str(kind), "").encode(), "ros2msg", str(kind))
                yield Channel(number, str(name), str(encoding), {}, number)
            (count,) = base.execute("SELECT COUNT(*) FROM messages").fetchone()
            place = base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id")
            done, damaged, take = 0, 0, allowance(path)
            for rows in _in_blocks(place):
                whole = []
                for topic, at, data in rows:
                    if isinstance(data, bytes) and 0 < len(data) <= _LARGEST:
                        try:
                            whole.append((int(topic), int(at), _unpacked(data, take)))
                        except Damage:
                            damaged += 1
                yield from _blocks(whole)
                done += len(rows)
                report(done / max(count, 1))
            if damaged:
                notes.append(f"{damaged} of {done} messages damaged and left out")
    except MemoryError:  # how sqlite3 reports a record whose length cannot be; nothing of that size was asked for
        notes.append("the bag is damaged (a record of an impossible length)")
    except (sqlite3.Error, ValueError, TypeError, OverflowError) as error:
        if isinstance(error, MagycError):
            raise
        notes.append(f"the bag is damaged ({shortened(error)})")
    report(1.0)


def _unpacked(data: bytes, take: Callable[[int], None]) -> bytes:
    """Return a message as it was before rosbag2 compressed it, if it did.

    Raises:
        MagycError: `Damage` if it cannot be unpacked; otherwise the bag unpacks to too much.
    """
    if not data.startswith(_ZSTD):
        return data
    result = decompressed(data, "zstd", _LARGEST, 0)
    take(len(result))
    return result


def _in_blocks(place: Iterator[Any]) -> Iterator[list[Any]]:
    """Yield rows in blocks. A damaged row raises its error after the rows before it."""
    while True:
        rows: list[Any] = []
        try:
            rows.extend(itertools.islice(place, _BLOCK))
        finally:
            if rows:
                yield rows
        if not rows:
            return


def _ros1(path: Path, notes: list[str], report: Callable[[float], None]) -> Iterator[Schema | Channel | Block]:
    """Yield the records of a ROS 1 bag; damage ends them with a note."""
    with needs(f"{path}", "rosbags", "ros"):
        from rosbags.rosbag1 import Reader
    try:
        with Reader(path) as bag:
            _limit_unpacking(bag, path)
            for connection in bag.connections:
                number = connection.id + 1
                yield Schema(number, connection.msgdef.data.encode(), "ros1msg", connection.msgtype)
                yield Channel(number, connection.topic, "ros1", {}, number)
            rows: list[tuple[int, int, bytes]] = []
            for done, (connection, at, data) in enumerate(bag.messages()):
                if 0 < len(data) <= _LARGEST:
                    rows.append((connection.id + 1, at, bytes(data)))
                if len(rows) == _BLOCK:
                    yield from _blocks(rows)
                    rows = []
                    report(done / max(bag.message_count, 1))
            yield from _blocks(rows)
    except (MemoryError, GeneratorExit):
        raise
    except Exception as error:  # the exceptions of rosbags on damaged bytes have no common class
        if isinstance(error, MagycError) and not isinstance(error, Damage):
            raise
        notes.append(f"the bag is damaged ({shortened(error) or type(error).__name__})")
    report(1.0)


def _limit_unpacking(bag: Any, path: Path) -> None:
    """Limit each chunk of an open bag to its declared size when unpacked, and all chunks to a multiple of the file.

    rosbags itself sets no limit, and unpacks a chunk again each time that messages of two chunks alternate, as in a bag
    that was written topic by topic; the latest chunks are therefore kept.
    """
    from rosbags.rosbag1.reader import Header, RecordType

    take = allowance(path)
    kept: dict[int, bytes] = {}  # {place: content}, the most recently used last

    def limited(place: int, compression: str, declared: int) -> Callable[[bytes], bytes]:
        def unpack(data: bytes) -> bytes:
            if place in kept:
                kept[place] = kept.pop(place)
                return kept[place]
            result = (
                _unbzipped(data, declared)
                if compression == "bz2"
                else decompressed(data, compression, declared, 0)
            )
            take(len(result))
            kept[place] = result
            while len(kept) > 1 and sum(map(len, kept.values())) > _KEPT:
                del kept[next(iter(kept))]
            return result

        return unpack

    for place, chunk in bag.chunks.items():
        bag.bio.seek(place)
        head = Header.read(bag.bio, RecordType.CHUNK)
        unpack = limited(place, head.get_string("compression"), head.get_uint32("size"))
        bag.chunks[place] = chunk._replace(decompressor=unpack)


def _unbzipped(data: bytes, declared: int) -> bytes:
    """Decompress a chunk in the format bz2."""
    if declared > LARGEST_CHUNK:
        raise Damage(f"a chunk declares {declared} bytes, more than the limit of {LARGEST_CHUNK}")
    result = bz2.BZ2Decompressor().decompress(data, max_length=declared + 1)
    if len(result) > declared:
        raise Damage(f"a chunk unpacks to more than the {declared} bytes that it declares")
    return result


def _blocks(rows: Sequence[tuple[int, int, bytes]]) -> Iterator[Block]:
    """Yield a block of messages, each (channel, time of recording in ns, data); nothing without messages."""
    if rows:
        length = np.array([len(data) for _, _, data in rows], dtype=np.int64)
        yield Block(
            np.frombuffer(b"".join(data for _, _, data in rows), dtype=np.uint8),
            np.array([number for number, _, _ in rows], dtype=np.int64).astype(np.uint16),
            np.array([at for _, at, _ in rows], dtype=np.int64),
            np.cumsum(length) - length,
            length,
        )
