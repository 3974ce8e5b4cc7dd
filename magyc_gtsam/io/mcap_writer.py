"""Writer of a `Recording` as a ROS 2 log in MCAP, with each sample at its stamp."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike
from typing import Literal

import numpy as np
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.mcap_records import CALIBRATED_TOPIC, METADATA
from magyc_gtsam.io.ros2 import SENSOR_FIELDS, UNKNOWN, definition, encode, encode_numbers, numbers_of
from magyc_gtsam.io.ros_fields import NANOSECONDS
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.applied import is_calibrated

_COMPRESSION = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, None: CompressionType.NONE}
_LATEST = 2**31 * NANOSECONDS  # the seconds of a stamp are an int32


@dataclass(frozen=True, eq=False)
class _Topic:
    name: str
    schema: str
    stamp: NDArray[np.int64]
    messages: list[bytes]


def write_mcap(
    path: str | PathLike[str],
    recording: Recording,
    *,
    epoch: int = 0,
    compression: Literal["zstd", "lz4"] | None = "zstd",
) -> None:
    """Write a recording such that `read` returns its samples exactly and its stamps to the nanosecond.

    The topics are `/imu/mag` (sensor_msgs/msg/MagneticField), `/imu/data_raw` (sensor_msgs/msg/Imu),
    `/reference/attitude` (geometry_msgs/msg/QuaternionStamped), and `/<name>` for each channel (std_msgs/msg/Float64
    or Float64MultiArray). Filled rows are not written, since reading creates them again; repeated samples are.

    Args:
        path: the file; an existing one is replaced.
        recording: the recording.
        epoch: stamp at the recording's time 0, in ns since 1970 or any other origin.
        compression: compression of the chunks; None for none.

    Raises:
        MagycError: the stamps do not fit a ROS header, or the compression is unknown.
    """
    if compression not in _COMPRESSION:
        raise MagycError(f"compression: must be 'zstd', 'lz4' or None, got {compression!r}")
    stamp = np.round(recording.time * 1e9).astype(np.int64) + int(epoch)
    if stamp[0] < 0 or stamp[-1] >= _LATEST:
        raise MagycError(
            f"stamps from {stamp[0] / 1e9:.3f} to {stamp[-1] / 1e9:.3f} s do not fit a ROS header "
            "(0 to 2^31 s); choose another epoch (ns at the recording's time 0), or write a table (.csv)"
        )
    topics = list(_topics(recording, stamp))
    topic_of_row = np.concatenate([np.full(len(t.stamp), i) for i, t in enumerate(topics)])
    row = np.concatenate([np.arange(len(t.stamp)) for t in topics])
    order = np.argsort(np.concatenate([t.stamp for t in topics]), kind="stable")
    with open(path, "wb") as file:
        writer = Writer(file, compression=_COMPRESSION[compression])
        writer.start(profile=Profile.ROS2, library="magyc-gtsam")
        channels = []
        schemas: dict[str, int] = {}
        for topic in topics:
            if topic.schema not in schemas:
                text = definition(topic.schema).encode()
                name = topic.schema.replace("/", "/msg/")
                schemas[topic.schema] = writer.register_schema(name, SchemaEncoding.ROS2, text)
            channels.append(writer.register_channel(topic.name, MessageEncoding.CDR, schemas[topic.schema]))
        for i, k in zip(topic_of_row[order].tolist(), row[order].tolist(), strict=True):
            at = int(topics[i].stamp[k])
            writer.add_message(channels[i], at, topics[i].messages[k], at, k)
        kinds = {"angular_rate_is": recording.angular_rate_is, "attitude_is": recording.attitude_is}
        marked = {CALIBRATED_TOPIC + topics[0].name: "yes"} if is_calibrated(recording) else {}
        writer.add_metadata(METADATA, {"name": recording.name} | kinds | marked)
        writer.finish()


def _topics(recording: Recording, stamp: NDArray[np.int64]) -> Iterator[_Topic]:
    """Yield the topics of a recording with stamps (N,) ns."""
    entries = recording.magnetic_field_stamped
    yield _topic(
        "/imu/mag", "sensor_msgs/MagneticField", stamp[entries], magnetic_field=recording.magnetic_field[entries]
    )
    imu = {"angular_rate": recording.angular_rate, "acceleration": recording.acceleration}
    known = {k: v[recording.angular_rate_fresh] for k, v in imu.items() if v is not None}
    if known:
        yield _topic("/imu/data_raw", "sensor_msgs/Imu", stamp[recording.angular_rate_fresh], **known)
    if recording.attitude is not None:
        known_rows = np.isfinite(recording.attitude).all(axis=1)
        yield _topic(
            "/reference/attitude",
            "geometry_msgs/QuaternionStamped",
            stamp[known_rows],
            attitude=recording.attitude[known_rows],
        )
    for name, value in recording.channels.items():
        rows = np.isfinite(value).reshape(len(value), -1).all(axis=1)
        schema = "std_msgs/Float64" if value.ndim == 1 else "std_msgs/Float64MultiArray"
        yield _Topic("/" + name.lstrip("/"), schema, stamp[rows], encode_numbers(value[rows]))


def _topic(name: str, schema: str, stamp: NDArray[np.int64], **parts: NDArray[np.float64]) -> _Topic:
    """Return a topic whose messages hold `parts`, {sensor: (n, k)}, and declare other sensors as unknown."""
    places = {path: column for column, path in enumerate(numbers_of(schema))}
    unknown = UNKNOWN.get(schema, {})
    value = np.zeros((len(stamp), len(places)))
    for path in unknown.values():
        value[:, places[path]] = -1.0
    for part, columns in parts.items():
        value[:, [places[path] for path in SENSOR_FIELDS[schema][part]]] = columns
        if part in unknown:
            value[:, places[unknown[part]]] = 0.0
    return _Topic(name, schema, stamp, encode(stamp, value))
