"""From the topics of a log with ROS messages, whatever file they are in, to a recording or a description."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from mcap.records import Channel, Schema

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.mcap_records import Block
from magyc_gtsam.io.mcap_topics import Topics
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros2 import SENSOR_FIELDS
from magyc_gtsam.io.ros_sources import FOUND_BY_TYPE, checked, choose, needed, unknown
from magyc_gtsam.io.ros_topic import LARGEST, Topic
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Recording

# What is kept of a file: times its size, and bytes. Numbers of a byte grow eightfold, and pack to a fifth.
_KEPT = (30, 1 << 26)


@dataclass(frozen=True)
class RosLog:
    """What was read of a log: its topics, names with values that were put into it, and what is wrong with it."""

    topics: dict[str, Topic]
    metadata: dict[str, str]
    notes: tuple[str, ...]


Load = Callable[[Path, Request, Callable[[str, str], bool]], RosLog]


def recording_of(load: Load, path: Path, request: Request) -> Recording:
    """As `magyc_gtsam.io.read`, of a log that `load` reads; it takes the path, the request and which topics to read."""
    log = load(path, request, needed(request, tuple(FOUND_BY_TYPE)))
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
        attitude_is="estimate" if log.metadata.get("attitude_is") == "estimate" else "independent",
    )


def info_of(load: Load, path: Path, kind: str) -> LogInfo:
    """As `magyc_gtsam.io.info`, of a log that `load` reads; `problem` is left to the caller."""
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
    return LogInfo(str(path), f"{kind} ({ros})", (last - zero) / 1e9, tuple(sources), log.notes)


def collected(
    path: Path,
    records: Iterable[Schema | Channel | Block],
    request: Request,
    wanted: Callable[[str, str], bool],
    notes: list[str],
    metadata: dict[str, str],
) -> RosLog:
    """The topics of all records; `notes` and `metadata` may grow while they come.

    Raises:
        MagycError: there is no message, or more numbers than are granted for a file of its size.
    """
    size = path.stat().st_size
    left = _KEPT[0] * size + _KEPT[1]

    def grant(count: int) -> None:
        nonlocal left
        left -= count
        if left < 0:
            raise MagycError(
                f"{path}: holds more numbers than {_KEPT[0]} times its {size} bytes; read only what is needed of it "
                "(channels=), or without other channels (channels=[])"
            )

    topics = Topics(wanted, request, notes, grant=grant)
    for record in records:
        topics.keep(record)
    topics.finish()
    count = sum(t.count for t in topics.values())
    if not count:
        raise MagycError(f"{path}: holds no message that can be read{': ' if notes else ''}{'; '.join(notes)}")
    return RosLog(topics, metadata, tuple(f"{n}; {count} messages could be read" for n in notes))


def _sensors(topics: dict[str, Topic], request: Request, notes: list[str]) -> tuple[dict[str, Stream], set[str]]:
    """The streams of the sensors, and the topics they are from."""
    chosen = {sensor: choose(topics, sensor, request, notes) for sensor in FOUND_BY_TYPE}
    acceleration = request.named("acceleration")
    if acceleration:
        chosen["acceleration"] = checked(topics, "acceleration", acceleration)
    elif (gyroscope := chosen["angular_rate"]) and gyroscope.mark is not None:  # an Imu message, read as one
        chosen["acceleration"] = checked(topics, "acceleration", gyroscope.name)
    result, used = {}, set()
    left = [source for source in chosen.values() if source is not None]
    for sensor, source in chosen.items():
        if source is None:
            continue
        left.remove(source)
        stamp = source.topic.stamp
        if unknown(source):
            if request.sensors.get(sensor):
                raise MagycError(f"{source.name}: says that it has no {sensor} (covariance[0] is -1)")
            notes.append(f"{source.name}: says that it has no {sensor} (covariance[0] is -1)")
            continue
        shared = any(other.topic is source.topic and {*other.columns} & {*source.columns} for other in left)
        value = source.topic.read(source.columns, last=not shared)
        if sensor == "attitude":
            keep = np.abs(np.linalg.norm(value, axis=1) - 1) < 0.01
            if not keep.all():
                notes.append(
                    f"{source.name}: {(~keep).sum()} of {len(keep)} quaternions are not of norm 1, left out"
                )
            stamp, value = stamp[keep], value[keep]
        else:
            scale, said = request.scale(sensor)
            notes.extend(said)
            if said:
                value *= scale
        result[sensor] = Stream(source.name, stamp, value)
        used.add(source.name)
    return result, used


def _channels(topics: dict[str, Topic], used: set[str], request: Request, notes: list[str]) -> dict[str, Stream]:
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
            found = topic.channels()
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
            raise MagycError(f"channels: the file has no {listed(missing)}")
    return result
