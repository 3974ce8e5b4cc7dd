"""Copy an MCAP log with the field and the angular rate replaced by calibrated ones."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.mcap_compression import Damage, decompressed
from magyc_gtsam.io.mcap_records import CALIBRATED_TOPIC, METADATA
from magyc_gtsam.io.ros_fields import NANOSECONDS, Array
from magyc_gtsam.io.ros_sources import FOUND_BY_TYPE
from magyc_gtsam.io.ros_types import short_type
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.applied import is_calibrated

# Offset (bytes) of each sensor's vector from the first number of a message; the numbers are float64.
_PLACES = {
    ("sensor_msgs/MagneticField", "magnetic_field"): 0,
    ("geometry_msgs/Vector3Stamped", "magnetic_field"): 0,
    ("geometry_msgs/Vector3Stamped", "angular_rate"): 0,
    ("sensor_msgs/Imu", "angular_rate"): 8 * (4 + 9),
}
_CDR = b"\x00\x01"  # little-endian, the byte order of the common ROS 2 platforms
_VECTOR = struct.Struct("<3d")
_STAMP = struct.Struct("<iI")  # of a header


@dataclass
class CopyCounts:
    """Numbers of messages in a copy.

    Attributes:
        unchanged: copied byte for byte.
        calibrated: of each sensor, copied with its vector replaced.
        left_out: messages of the sensors without a sample in the recording: outside its time, or faulty.
    """

    calibrated: dict[str, int]
    unchanged: int = 0
    left_out: int = 0


@dataclass
class _Copy:
    """The state of a copy: the writer, and the ids of the source's schemas and channels in the target."""

    writer: Writer
    replaced: Mapping[str, Mapping[int, bytes]]  # by sensor, the vector at each stamp
    end: int  # ns, of the recording's last row
    named: Mapping[str, str | None]
    by_log_time: bool
    lag: int  # ns, by which the stamps of the magnetometer are too late
    count: CopyCounts
    schemas: dict[int, int] = field(default_factory=dict)
    kinds: dict[int, str] = field(default_factory=dict)
    channels: dict[int, int] = field(default_factory=dict)
    sensors: dict[int, tuple[str, int]] = field(default_factory=dict)  # {channel: (sensor, offset of its vector)}
    latest: dict[int, tuple[bytes, bytes]] = field(default_factory=dict)  # {channel: (own vector, calibrated)}
    calibrated_topics: set[str] = field(default_factory=set)  # keys of the metadata

    def take(self, record: object) -> None:
        """Copy a record."""
        if isinstance(record, Schema):
            self.schemas[record.id] = self.writer.register_schema(record.name, record.encoding, record.data)
            self.kinds[record.id] = short_type(record.name)
        elif isinstance(record, Channel):
            if record.id in self.channels:
                return
            schema = self.schemas.get(record.schema_id, 0)
            self.channels[record.id] = self.writer.register_channel(
                record.topic, record.message_encoding, schema, record.metadata
            )
            sensor = self._sensor(record)
            if sensor is not None:
                self.sensors[record.id] = sensor
                if sensor[0] == "magnetic_field":
                    self.calibrated_topics.add(CALIBRATED_TOPIC + record.topic)
        elif isinstance(record, Message):
            self._message(record)
        elif isinstance(record, Metadata):
            self.writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self.writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )

    def _sensor(self, channel: Channel) -> tuple[str, int] | None:
        """Return the sensor whose vector is replaced in a channel, and the vector's offset; None without one."""
        kind = self.kinds.get(channel.schema_id, "")
        for sensor in self.replaced:
            name = self.named[sensor]
            matches = (
                kind == FOUND_BY_TYPE[sensor] if name is None else channel.topic.lstrip("/") == name.lstrip("/")
            )
            if matches and (kind, sensor) in _PLACES and channel.message_encoding == "cdr":
                return sensor, _PLACES[kind, sensor]
        return None

    def _message(self, message: Message) -> None:
        """Copy a message, with its vector replaced if its channel is a sensor's."""
        data, sensor = message.data, self.sensors.get(message.channel_id)
        if sensor is None:
            self.count.unchanged += 1
        else:
            name, place = sensor
            stamp, numbers = _stamp_and_numbers(data)
            first = numbers + place
            end = first + _VECTOR.size
            at = message.log_time if self.by_log_time else stamp
            vector = self._calibrated(message.channel_id, name, at, data[first:end])
            late = self.lag if name == "magnetic_field" else 0
            if vector is None or at < late:
                self.count.left_out += 1
                return
            data = data[:first] + vector + data[end:]
            self.count.calibrated[name] += 1
            if late and stamp >= late:  # a header that was never filled in stays as it is
                data = data[:4] + _STAMP.pack(*divmod(stamp - late, NANOSECONDS)) + data[4 + _STAMP.size :]
            if self.by_log_time:
                message = replace(message, log_time=at - late)
        self.writer.add_message(
            self.channels[message.channel_id], message.log_time, data, message.publish_time, message.sequence
        )

    def _calibrated(self, channel: int, sensor: str, at: int, own: bytes) -> bytes | None:
        """Return the calibrated vector of a message with the stamp `at` (ns) in place of its `own`.

        A repeat that a held gyroscope writes is no sample of the recording and takes the vector of the message before.
        None for other messages without a sample.
        """
        before, held = self.latest.get(channel, (b"", None))
        vector = self.replaced[sensor].get(at, held if own == before and at <= self.end else None)
        if vector is not None:
            self.latest[channel] = own, vector
        return vector


def copy_mcap(
    source: Path,
    target: Path,
    calibrated: Recording,
    epoch: int,
    named: Mapping[str, str | None],
    lag: float = 0.0,
    by_log_time: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> CopyCounts | None:
    """Copy a log and replace the vectors of its sensors; everything else in the log stays the same.

    Args:
        source, target: the files.
        calibrated: the recording of `source` with the calibrated field, and an angular rate if that is to be replaced.
        epoch: stamp of the log's clock at the recording's time 0, ns.
        named: the topics of "magnetic_field" and "angular_rate"; None for the only one of its type.
        lag: s by which the magnetometer's stamps are too late; those written are earlier by it.
        by_log_time: whether the recording's stamps are those of the recorder.
        progress: called with the share done, 0 to 1.

    Returns:
        The numbers of messages; None, without a file, if a sensor's messages are not of the types MagneticField,
        Vector3Stamped or Imu of ROS 2, in which the vector can be replaced.

    Raises:
        MagycError: the file is damaged, or no message of a sensor can be written with a calibrated vector.
    """
    replaced = {"magnetic_field": _vectors(*calibrated.magnetometer, epoch)}
    if calibrated.angular_rate is not None:
        replaced["angular_rate"] = _vectors(*calibrated.gyroscope, epoch)
    end = round(calibrated.time[-1] * NANOSECONDS) + epoch
    size = max(source.stat().st_size, 1)
    with open(source, "rb") as read, open(target, "wb") as written:
        count = CopyCounts(dict.fromkeys(replaced, 0))
        delay = round(lag * NANOSECONDS)
        copy = _Copy(Writer(written), replaced, end, named, by_log_time, delay, count)
        try:
            for k, record in enumerate(_records(read)):
                if isinstance(record, Header):
                    copy.writer.start(record.profile, record.library)
                copy.take(record)
                if k % 4096 == 0:
                    progress(read.tell() / size)
        except (McapError, EOFError, struct.error, UnicodeDecodeError, Damage) as error:
            raise MagycError(
                f"{source}: is damaged ({type(error).__name__}), and only a complete MCAP file can be copied; repair "
                "it with `mcap recover`, or write a table (a name that ends in .csv)"
            ) from None
        if is_calibrated(calibrated):
            copy.writer.add_metadata(METADATA, dict.fromkeys(copy.calibrated_topics, "yes"))
        copy.writer.finish()
    if {sensor for sensor, _ in copy.sensors.values()} != set(replaced):
        target.unlink()
        return None
    for sensor, number in count.calibrated.items():
        if not number:
            raise MagycError(
                f"{source}: no message of the {sensor} can be written: their stamps are not those of the samples that "
                f"were read, or are less than the delay of {lag:.3f} s that is taken from them; write a table (a name "
                "that ends in .csv)"
            )
    return count


def _records(file: IO[bytes]) -> Iterator[McapRecord]:
    """Yield the records of the file in order; chunks are unpacked up to the largest permitted size."""
    for record in StreamReader(file, emit_chunks=True).records:
        if isinstance(record, Chunk):
            data = decompressed(record.data, record.compression, record.uncompressed_size, record.uncompressed_crc)
            yield from breakup_chunk(replace(record, compression="", data=data))
        else:
            yield record


def _vectors(time: Array, value: Array, epoch: int) -> dict[int, bytes]:
    """Return {stamp (ns): bytes of the vector} of samples (n, 3)."""
    stamps = np.round(time * NANOSECONDS).astype(np.int64) + epoch
    rows = np.ascontiguousarray(value, dtype="<f8").tobytes()
    return {stamp: rows[24 * k : 24 * (k + 1)] for k, stamp in enumerate(stamps.tolist())}


def _stamp_and_numbers(data: bytes) -> tuple[int, int]:
    """Return the header's stamp (ns), and the byte at which the numbers begin: after the frame's name, aligned to 8."""
    if data[:2] != _CDR:
        raise MagycError(
            "a message of the magnetometer or gyroscope is not little-endian CDR and cannot be copied; write a table "
            "(a name that ends in .csv)"
        )
    seconds, nanoseconds, length = struct.unpack_from("<iII", data, 4)
    end = 4 + 12 + length
    return seconds * NANOSECONDS + nanoseconds, 4 + -(-(end - 4) // 8) * 8
