"""Recording and description of a log with ROS messages, independent of the file format."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from mcap.records import Channel, Schema

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import counted, listed
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.mcap_compression import allowance
from magyc_gtsam.io.mcap_records import CALIBRATED_TOPIC, Block
from magyc_gtsam.io.mcap_topics import Topics
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros2 import SENSOR_FIELDS
from magyc_gtsam.io.ros_sources import FOUND_BY_TYPE, checked, choose, needed, unknown
from magyc_gtsam.io.ros_topic import LARGEST, Topic
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.applied import CALIBRATED
from magyc_gtsam.storage.files import size_of

# Limit of the numbers kept: a multiple of the file's size, and bytes. One-byte numbers grow eightfold.
_KEPT = (30, 1 << 26)


@dataclass(frozen=True)
class RosLog:
    """The contents of a log: its topics, its metadata, and notes on damage."""

    topics: dict[str, Topic]
    metadata: dict[str, str]
    notes: tuple[str, ...]


# Loads a log, given the path, the request, and which topics (name, type) to read.
Load = Callable[[Path, Request, Callable[[str, str], bool]], RosLog]


def recording_of(load: Load, path: Path, request: Request) -> Recording:
    """Read a log of the format that `load` loads; see `magyc_gtsam.io.read`."""
    log = load(path, request, needed(request, tuple(FOUND_BY_TYPE)))
    notes = list(log.notes)
    sensors, used = _sensors(log.topics, request, notes)
    channels = _channels(log.topics, used, request, notes)
    if "magnetic_field" in sensors and CALIBRATED_TOPIC + sensors["magnetic_field"].name in log.metadata:
        notes.insert(0, CALIBRATED)
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
        attitude_is="estimate" if log.metadata.get("attitude_is") == "estimate" else "independent",
    )


def info_of(load: Load, path: Path, kind: str) -> LogInfo:
    """Describe a log of the format that `load` loads; see `magyc_gtsam.io.info`, which sets `problem`."""
    log = load(path, Request(), lambda name, kind: False)
    zero = min((t.span[0] for t in log.topics.values()), default=0)
    last = max((t.span[1] for t in log.topics.values()), default=0)
    sources = []
    for topic in log.topics.values():
        sensors = SENSOR_FIELDS.get(topic.type)
        sources.append(
            Source(
                topic.name,
                topic.schema.name,
                topic.count,
                ((topic.span[0] - zero) / 1e9, (topic.span[1] - zero) / 1e9),
                tuple(sensors) if sensors else ("channel",) if topic.largest_first <= LARGEST else (),
            )
        )
    ros = "ROS 1" if any(t.encoding == "ros1" for t in log.topics.values()) else "ROS 2"
    duration = (last - zero) / 1e9
    return LogInfo(str(path), f"{kind} ({ros})", duration, tuple(sources), log.notes, first=zero, recorded=True)


def collected(
    path: Path,
    records: Iterable[Schema | Channel | Block],
    request: Request,
    wanted: Callable[[str, str], bool],
    notes: list[str],
    metadata: dict[str, str],
) -> RosLog:
    """Collect the topics from all records; `notes` and `metadata` may grow while the records are read.

    Raises:
        MagycError: there is no message, or the numbers exceed the limit for a file of this size.
    """
    much = (
        f"holds more numbers than {_KEPT[0]} times its {size_of(path)} bytes; read only the channels that are "
        "needed (channels=), or none (channels=[])"
    )
    topics = Topics(wanted, request, notes, grant=allowance(path, much, _KEPT))
    for record in records:
        topics.keep(record)
    topics.finish()
    count = sum(t.count for t in topics.values())
    if not count:
        raise MagycError(f"{path}: holds no message that can be read{': ' if notes else ''}{'; '.join(notes)}")
    return RosLog(topics, metadata, tuple(f"{n}; {counted(count, 'message')} could be read" for n in notes))


def _sensors(topics: dict[str, Topic], request: Request, notes: list[str]) -> tuple[dict[str, Stream], set[str]]:
    """Return the streams of the sensors, and the names of their topics."""
    chosen = {sensor: choose(topics, sensor, request, notes) for sensor in FOUND_BY_TYPE}
    acceleration = request.named("acceleration")
    if acceleration:
        chosen["acceleration"] = checked(topics, "acceleration", acceleration)
    elif (gyroscope := chosen["angular_rate"]) and gyroscope.mark is not None:  # an Imu message has both
        chosen["acceleration"] = checked(topics, "acceleration", gyroscope.name)
    result, used = {}, set()
    pending = [source for source in chosen.values() if source is not None]
    for sensor, source in chosen.items():
        if source is None:
            continue
        pending.remove(source)
        stamp = source.topic.stamp
        if unknown(source):
            absent = f"{source.name}: declares that it has no {sensor} (covariance[0] is -1)"
            if request.sensors.get(sensor):
                raise MagycError(f"{absent}; name another topic ({sensor}=)")
            notes.append(absent)
            continue
        shared = any(other.topic is source.topic and {*other.columns} & {*source.columns} for other in pending)
        value = source.topic.read(source.columns, last=not shared)
        if sensor == "attitude":
            keep = np.abs(np.linalg.norm(value, axis=1) - 1) < 0.01
            if not keep.all():
                notes.append(
                    f"{source.name}: {(~keep).sum()} of {len(keep)} quaternions are not of norm 1, left out"
                )
            stamp, value = stamp[keep], value[keep]
        else:
            scale = request.scale(sensor, notes=notes)
            if scale != 1:
                value *= scale
        result[sensor] = Stream(source.name, stamp, value)
        used.add(source.name)
    return result, used


def _channels(topics: dict[str, Topic], used: set[str], request: Request, notes: list[str]) -> dict[str, Stream]:
    """Return the channels: those that the caller named, else all numbers in topics that no sensor `used`."""
    result: dict[str, Stream] = {}
    wanted = request.channels
    for topic in topics.values():
        base = topic.name.lstrip("/")
        named = wanted is not None and any(w.lstrip("/").split(".")[0] == base for w in wanted)
        if (
            topic.name in used
            or (wanted is not None and not named)
            or (wanted is None and topic.type in SENSOR_FIELDS)
        ):
            continue
        try:
            streams = topic.channels()
        except MagycError as error:
            if named:
                raise
            notes.append(f"channel left out: {error}")
            continue
        result |= {
            k: v for k, v in streams.items() if wanted is None or {k, base} & {w.lstrip("/") for w in wanted}
        }
    if wanted is not None:
        missing = [
            w for w in wanted if not any(k == w.lstrip("/") or k.startswith(f"{w.lstrip('/')}.") for k in result)
        ]
        if missing:
            raise MagycError(f"channels: the file has no {listed(missing)}")
    return result
