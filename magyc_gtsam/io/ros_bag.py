"""Read ROS bags: .bag of ROS 1 (by rosbags) and .db3 of ROS 2 (SQLite)."""

from __future__ import annotations

import bz2
import contextlib
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.log_info import LogInfo
from magyc_gtsam.io.mcap_records import LARGEST_CHUNK, UNPACKED, Block, Damage, decompressed
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros_log import RosLog, collected, info_of, recording_of
from magyc_gtsam.recording import Recording

_AT_ONCE = 4096  # messages
_LARGEST = 1 << 24  # bytes of a message
_KEPT = 1 << 26  # bytes of unpacked chunks of ROS 1; a chunk is 768 kB as a rule
SQLITE = b"SQLite format 3\0"


def read(path: Path, request: Request) -> Recording:
    """As `magyc_gtsam.io.read`, of a bag.

    Raises:
        MagycError: rosbags is not installed, or the file is damaged.
    """
    request.only("ROS bag")
    return recording_of(_load, path, request)


def info(path: Path) -> LogInfo:
    """As `magyc_gtsam.io.info`, of a bag; `problem` is left to the caller."""
    return info_of(_load, path, "bag")


def _load(path: Path, request: Request, wanted: Callable[[str, str], bool]) -> RosLog:
    with open(path, "rb") as file:
        sqlite = file.read(len(SQLITE)) == SQLITE
    notes: list[str] = []
    source = _sqlite(path, notes, request.report) if sqlite else _ros1(path, notes, request.report)
    return collected(path, source, request, wanted, notes, {})


def _sqlite(path: Path, notes: list[str], report: Callable[[float], None]) -> Iterator[Schema | Channel | Block]:
    try:
        with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
            tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"topics", "messages"} <= tables:
                raise MagycError(f"{path}: not a ROS 2 bag (an SQLite file without topics and messages)")
            texts: dict[str, str] = {}
            if "message_definitions" in tables:  # since 2023; types that are known need none
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
            done = 0
            while rows := place.fetchmany(_AT_ONCE):
                whole = [r for r in rows if isinstance(r[2], bytes) and 0 < len(r[2]) <= _LARGEST]
                yield from _blocks([(int(t), int(at), data) for t, at, data in whole])
                done += len(rows)
                report(done / max(count, 1))
    except (sqlite3.Error, ValueError, TypeError, OverflowError) as error:
        notes.append(f"the bag is damaged ({shortened(error)})")
    report(1.0)


def _ros1(path: Path, notes: list[str], report: Callable[[float], None]) -> Iterator[Schema | Channel | Block]:
    try:
        from rosbags.rosbag1 import Reader
    except ImportError:
        raise MagycError(
            f"{path}: ROS 1 bags need rosbags; install it with: pip install 'magyc-gtsam[ros]'"
        ) from None
    try:
        with Reader(path) as bag:
            _bound(bag, path)
            for connection in bag.connections:
                number = connection.id + 1
                yield Schema(number, connection.msgdef.data.encode(), "ros1msg", connection.msgtype)
                yield Channel(number, connection.topic, "ros1", {}, number)
            rows: list[tuple[int, int, bytes]] = []
            for done, (connection, at, data) in enumerate(bag.messages()):
                if 0 < len(data) <= _LARGEST:
                    rows.append((connection.id + 1, at, bytes(data)))
                if len(rows) == _AT_ONCE:
                    yield from _blocks(rows)
                    rows = []
                    report(done / max(bag.message_count, 1))
            yield from _blocks(rows)
    except (MemoryError, GeneratorExit):
        raise
    except Exception as error:  # what the library raises at damaged bytes depends on the bytes
        if isinstance(error, MagycError) and not isinstance(error, Damage):
            raise
        notes.append(f"the bag is damaged ({shortened(error) or type(error).__name__})")
    report(1.0)


def _bound(bag: Any, path: Path) -> None:
    """Let no chunk of a bag that is open unpack to more than it announces, nor all to far more than the file.

    The library unpacks in full whatever a chunk holds, and once more each time that messages of two take turns, as
    they do where a bag was written topic by topic: so the latest chunks are kept.
    """
    from rosbags.rosbag1.reader import Header, RecordType

    size = path.stat().st_size
    left = UNPACKED[0] * size + UNPACKED[1]
    kept: dict[int, bytes] = {}  # by place, the one that was used last at the end

    def bounded(place: int, compression: str, announced: int) -> Callable[[bytes], bytes]:
        def unpack(data: bytes) -> bytes:
            nonlocal left
            if place in kept:
                kept[place] = kept.pop(place)
                return kept[place]
            result = (
                _unbzipped(data, announced)
                if compression == "bz2"
                else decompressed(data, compression, announced, 0)
            )
            left -= len(result)
            if left < 0:
                raise MagycError(
                    f"{path}: unpacks to more than {UNPACKED[0]} times its {size} bytes, which no log of measurements "
                    "does; refused before it fills the memory"
                )
            kept[place] = result
            while len(kept) > 1 and sum(map(len, kept.values())) > _KEPT:
                del kept[next(iter(kept))]
            return result

        return unpack

    for place, chunk in bag.chunks.items():
        bag.bio.seek(place)
        head = Header.read(bag.bio, RecordType.CHUNK)
        unpack = bounded(place, head.get_string("compression"), head.get_uint32("size"))
        bag.chunks[place] = chunk._replace(decompressor=unpack)


def _unbzipped(data: bytes, announced: int) -> bytes:
    """What a chunk holds.

    Raises:
        Damage: more than it announces, or than is granted.
    """
    if announced > LARGEST_CHUNK:
        raise Damage(f"a chunk asks for {announced} bytes, {LARGEST_CHUNK} are granted")
    result = bz2.BZ2Decompressor().decompress(data, max_length=announced + 1)
    if len(result) > announced:
        raise Damage(f"a chunk unpacks to more than the {announced} bytes that it announces")
    return result


def _blocks(rows: Sequence[tuple[int, int, bytes]]) -> Iterator[Block]:
    if rows:
        length = np.array([len(data) for _, _, data in rows], dtype=np.int64)
        yield Block(
            np.frombuffer(b"".join(data for _, _, data in rows), dtype=np.uint8),
            np.array([number for number, _, _ in rows], dtype=np.int64).astype(np.uint16),
            np.array([at for _, at, _ in rows], dtype=np.int64),
            np.cumsum(length) - length,
            length,
        )
