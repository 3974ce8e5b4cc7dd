"""Read ROS messages from MCAP: whole, unindexed, or cut off in the middle of a chunk."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from mcap.exceptions import EndOfFile, InvalidMagic, RecordLengthLimitExceeded
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.mcap_channels import LARGEST, channels_of
from magyc_gtsam.io.mcap_topics import DAMAGE, FOUND_BY_TYPE, NO_SCHEMA, Topic, checked, choose, unknown
from magyc_gtsam.io.mcap_writer import METADATA
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros2 import LAYOUTS, decode, short_type
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Recording


@dataclass(frozen=True)
class _Log:
    topics: dict[str, Topic]
    metadata: dict[str, str]
    notes: tuple[str, ...]


def read(path: Path, request: Request) -> Recording:
    """As `magyc_gtsam.io.read`, of an MCAP file."""
    request.only("MCAP")
    log = _load(path, request.report)
    notes = list(log.notes)
    sensors, used = _sensors(log.topics, request, notes)
    channels = _channels(log.topics, used, request, notes)
    is_mean: Literal["instant", "interval-mean"] = (
        "interval-mean" if log.metadata.get("angular_rate_is") == "interval-mean" else "instant"
    )
    return assemble(
        sensors,
        channels,
        request,
        name=log.metadata.get("name") or path.stem,
        notes=tuple(notes),
        angular_rate_is=is_mean,
    )


def info(path: Path) -> LogInfo:
    """As `magyc_gtsam.io.info`, of an MCAP file; `problem` is left to the caller."""
    log = _load(path, lambda _: None)
    times = [t for topic in log.topics.values() for t in (min(topic.log_time), max(topic.log_time))]
    zero, last = min(times, default=0), max(times, default=0)
    sources = []
    for topic in log.topics.values():
        layout = LAYOUTS.get(topic.type)
        sources.append(
            Source(
                topic.name,
                topic.schema.name,
                len(topic.data),
                ((min(topic.log_time) - zero) / 1e9, (max(topic.log_time) - zero) / 1e9),
                tuple(layout.parts) if layout else ("channel",) if len(topic.data[0]) <= LARGEST else (),
            )
        )
    ros = "ROS 1" if any(t.encoding == "ros1" for t in log.topics.values()) else "ROS 2"
    return LogInfo(str(path), f"MCAP ({ros})", (last - zero) / 1e9, tuple(sources), log.notes)


def _load(path: Path, report: Callable[[float], None]) -> _Log:
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    messages: dict[int, tuple[list[int], list[bytes]]] = {}
    metadata: dict[str, str] = {}
    notes: list[str] = []
    too_large: set[int] = set()
    for record in _records(path, notes, report):
        if isinstance(record, Message):
            if record.channel_id in too_large:
                continue
            log_time, data = messages.setdefault(record.channel_id, ([], []))
            log_time.append(record.log_time)
            data.append(record.data)
            if len(record.data) > LARGEST and _type(record.channel_id, channels, schemas) not in LAYOUTS:
                too_large.add(record.channel_id)  # its first message says what it is; the rest need not be kept
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Metadata) and record.name == METADATA:
            metadata.update(record.metadata)
    merged: dict[str, Topic] = {}
    for identifier, (log_time, data) in messages.items():
        # Only now: where a chunk is damaged its channels stand in the summary alone, at the end of the file.
        channel = channels.get(identifier)
        if channel is None:
            notes.append(f"{len(data)} messages of a channel without a record ({identifier}) were left out")
            continue
        schema = schemas.get(channel.schema_id, NO_SCHEMA)
        topic = merged.setdefault(channel.topic, Topic(channel.topic, channel.message_encoding, schema))
        # Two publishers of one topic are two channels in the file, but one topic to everyone else.
        if topic.schema.name == schema.name:
            topic.log_time.extend(log_time)
            topic.data.extend(data)
        else:
            notes.append(f"{channel.topic} has two types; {len(data)} messages of {schema.name} were left out")
    count = sum(len(t.data) for t in merged.values())
    if not count:
        raise MagycError(f"{path}: holds no message that can be read{': ' if notes else ''}{'; '.join(notes)}")
    return _Log(merged, metadata, tuple(f"{n}; {count} messages could be read" for n in notes))


def _type(identifier: int, channels: dict[int, Channel], schemas: dict[int, Schema]) -> str:
    channel = channels.get(identifier)
    return short_type(schemas.get(channel.schema_id, NO_SCHEMA).name) if channel else ""


def _records(path: Path, notes: list[str], report: Callable[[float], None]) -> Iterator[McapRecord]:
    """All records in order; where the file is damaged, those before and behind, and a note."""
    size = max(os.path.getsize(path), 1)
    whole = False
    with open(path, "rb") as file:
        records = StreamReader(file, emit_chunks=True).records
        try:
            for record in records:
                if isinstance(record, Chunk):
                    report(file.tell() / size)
                    try:
                        yield from breakup_chunk(record, validate_crc=True)
                    except DAMAGE as error:
                        notes.append(f"a chunk is damaged and was left out ({error or type(error).__name__})")
                else:
                    whole |= isinstance(record, Footer)
                    yield record
        except RecordLengthLimitExceeded as error:
            notes.append(f"the file is damaged at byte {file.tell()} ({error})")
        except (EndOfFile, InvalidMagic, struct.error) as error:
            if file.tell() <= 8:
                raise MagycError(f"{path}: not an MCAP file ({str(error) or 'it ends too early'})") from None
            if not whole:
                notes.append(f"the file is cut off after {size} bytes (no footer)")
    report(1.0)


def _sensors(topics: dict[str, Topic], request: Request, notes: list[str]) -> tuple[dict[str, Stream], set[str]]:
    """The streams of the sensors, and the topics they are from."""
    chosen = {sensor: choose(topics, sensor, request, notes) for sensor in FOUND_BY_TYPE}
    acceleration = request.named("acceleration")
    chosen["acceleration"] = (
        checked(topics, "acceleration", acceleration) if acceleration else chosen["angular_rate"]
    )
    result, used = {}, set()
    decoded = {}
    for sensor, topic in chosen.items():
        if topic is None:
            continue
        if topic.name not in decoded:
            decoded[topic.name] = decode(topic.name, topic.data, LAYOUTS[topic.type], topic.encoding)
        stamp, numbers = decoded[topic.name]
        layout = LAYOUTS[topic.type]
        if sensor not in layout.parts:
            continue  # the gyroscope's topic need not have an accelerometer
        if unknown(layout, sensor, numbers):
            if request.sensors.get(sensor):
                raise MagycError(f"{topic.name}: says that it has no {sensor} (covariance[0] is -1)")
            notes.append(f"{topic.name}: says that it has no {sensor} (covariance[0] is -1)")
            continue
        if request.stamps == "log":
            stamp = np.array(topic.log_time, dtype=np.int64)
        value = numbers[:, layout.parts[sensor]]
        if sensor == "attitude":
            keep = np.abs(np.linalg.norm(value, axis=1) - 1) < 0.01
            if not keep.all():
                notes.append(
                    f"{topic.name}: {(~keep).sum()} of {len(keep)} quaternions are not of norm 1, left out"
                )
            stamp, value = stamp[keep], value[keep]
        else:
            scale, said = request.scale(sensor)
            notes.extend(said)
            value = value * scale if said else value
        result[sensor] = Stream(topic.name, stamp, value)
        used.add(topic.name)
    return result, used


def _channels(topics: dict[str, Topic], used: set[str], request: Request, notes: list[str]) -> dict[str, Stream]:
    result: dict[str, Stream] = {}
    wanted = request.channels
    for topic in topics.values():
        base = topic.name.lstrip("/")
        named = wanted is not None and any(w.lstrip("/").split(".")[0] == base for w in wanted)
        if topic.name in used or (wanted is not None and not named) or (wanted is None and topic.type in LAYOUTS):
            continue
        try:
            if len(topic.data[0]) > LARGEST:
                raise MagycError(
                    f"{topic.name} ({topic.schema.name}): {len(topic.data[0])} bytes, too large for numbers"
                )
            found = channels_of(
                topic.name, topic.schema, topic.encoding, topic.data, topic.log_time, request.stamps == "log"
            )
        except MagycError as error:
            if named:
                raise
            notes.append(f"channel left out: {error}")
            continue
        result |= {k: v for k, v in found.items() if wanted is None or {k, base} & {w.lstrip("/") for w in wanted}}
    if wanted is not None:
        missing = [
            w for w in wanted if not any(k == w.lstrip("/") or k.startswith(f"{w.lstrip('/')}.") for k in result)
        ]
        if missing:
            raise MagycError(f"channels: the file has no {', '.join(missing)}")
    return result
