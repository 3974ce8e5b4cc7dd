"""The topics of an MCAP file, and which of them is which sensor."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

import zstandard
from mcap.exceptions import EndOfFile
from mcap.records import Schema
from mcap.stream_reader import CRCValidationError

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros2 import LAYOUTS, Array, Layout, short_type

# What a chunk that was damaged on disk raises: checksum, zstd, lz4 (a bare RuntimeError), records cut short.
DAMAGE = (CRCValidationError, zstandard.ZstdError, RuntimeError, EndOfFile, struct.error)
NO_SCHEMA = Schema(id=0, data=b"", encoding="", name="")
# The type that each sensor is published as; of other types in LAYOUTS the caller must name the topic.
FOUND_BY_TYPE = {
    "magnetic_field": "sensor_msgs/MagneticField",
    "angular_rate": "sensor_msgs/Imu",
    "attitude": "geometry_msgs/QuaternionStamped",
}


@dataclass
class Topic:
    """The messages of one topic, in the order of the file."""

    name: str
    encoding: str
    schema: Schema
    log_time: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)

    @property
    def type(self) -> str:
        """Of its messages, without the "/msg/" of ROS 2."""
        return short_type(self.schema.name)


def choose(topics: Mapping[str, Topic], sensor: str, request: Request, notes: list[str]) -> Topic | None:
    """The topic of a sensor: the one named, else the only one of its type; None where there is none.

    Raises:
        MagycError: no such topic, several that could be meant, or no magnetometer.
    """
    name = request.named(sensor)
    if name is not None:
        return checked(topics, sensor, name)
    found = [t for t in topics.values() if t.type == FOUND_BY_TYPE[sensor]]
    listed = ", ".join(f"{t.name} ({len(t.data)} messages)" for t in found)
    if len(found) == 1:
        return checked(topics, sensor, found[0].name)
    if len(found) > 1 and sensor == "attitude":
        notes.append(f"attitude left out: {listed} could be meant; name one (attitude=)")
    elif len(found) > 1:
        raise MagycError(f"{sensor}: {len(found)} topics could be meant: {listed}; name one ({sensor}=)")
    elif sensor == "magnetic_field":
        others = ", ".join(f"{t.name} ({t.schema.name})" for t in topics.values())
        raise MagycError(
            f"no topic of type {FOUND_BY_TYPE[sensor]}; the file has {others}; "
            "record the magnetometer too, or name its topic (magnetic_field=) where it has another type"
        )
    elif sensor == "angular_rate":
        notes.append(f"no gyroscope: the file has no topic of type {FOUND_BY_TYPE[sensor]}")
    return None


def checked(topics: Mapping[str, Topic], sensor: str, name: str) -> Topic:
    """The topic of that name, if it can hold the sensor.

    Raises:
        MagycError: no such topic, or of a type or encoding that cannot be read.
    """
    topic = topics.get(name) or topics.get(f"/{name}")
    if topic is None:
        listed = ", ".join(f"{t.name} ({t.schema.name})" for t in topics.values())
        raise MagycError(f"{sensor}: no topic {name!r}; the file has {listed}")
    fitting = [k for k, v in LAYOUTS.items() if sensor in v.parts]
    if topic.type not in fitting:
        raise MagycError(f"{sensor}: {name} is of type {topic.schema.name}; one of {', '.join(fitting)} is needed")
    if topic.encoding not in ("cdr", "ros1"):
        raise MagycError(f"{sensor}: {name} is encoded as {topic.encoding}; cdr (ROS 2) and ros1 can be read")
    return topic


def unknown(layout: Layout, sensor: str, numbers: Array) -> bool:
    """Whether all messages say that they have no estimate of the sensor (covariance[0] is -1)."""
    return bool(layout.unknown and (numbers[:, layout.unknown[sensor]] == -1).all())
