"""The topics of an MCAP file, their numbers as they come in, and which of them is which sensor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.growing import GrowingColumns
from magyc_gtsam.io.mcap_records import Block
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros2 import SENSOR_FIELDS, UNKNOWN, fields_of, known_types
from magyc_gtsam.io.ros_fields import Array, FieldReader, Stamps, parse_types, short_type
from magyc_gtsam.io.streams import Stream

NO_SCHEMA = Schema(id=0, data=b"", encoding="", name="")
LARGEST = 2048  # bytes of a message; images, clouds and scans are no channels
# The type that each sensor is published as; of other types the caller must name the topic.
FOUND_BY_TYPE = {
    "magnetic_field": "sensor_msgs/MagneticField",
    "angular_rate": "sensor_msgs/Imu",
    "attitude": "geometry_msgs/QuaternionStamped",
}
_NO_TIME = 1 << 63  # beyond all stamps
_AXES = {"attitude": "xyzw"}


class Topic:
    """One topic: what its messages are, and their numbers where they are `wanted`.

    Args:
        name, encoding, schema: of its first channel.
        wanted: whether to read the messages, or only to count them.
        by_log_time: stamp them by the time of recording, whatever their headers say.
        attitude: whether one that stands beside other sensors is of interest.
    """

    def __init__(
        self,
        name: str,
        encoding: str,
        schema: Schema,
        wanted: bool,
        by_log_time: bool = False,
        attitude: bool = True,
    ) -> None:
        self.name, self.encoding, self.schema, self.wanted = name, encoding, schema, wanted
        self.fields = fields_of(self.type, attitude) if self.type in SENSOR_FIELDS else ()
        self.count = 0
        self.span = (_NO_TIME, -_NO_TIME)  # ns, times of recording
        self.largest_first = 0  # bytes of the first message
        self.problem: MagycError | None = None  # why the messages cannot be read
        self._by_log_time = by_log_time
        self._reader: FieldReader | None = None
        self._stamp: GrowingColumns[np.int64] | None = None
        self._value: GrowingColumns[np.float64] | None = None

    @property
    def type(self) -> str:
        """Of its messages, without the "/msg/" of ROS 2."""
        return short_type(self.schema.name)

    @property
    def columns(self) -> list[tuple[str, int | None]]:
        """The numbers that are read: the path of each, and for arrays how many it is."""
        return (self._reader.columns if self._reader else None) or []

    def add(self, data: NDArray[np.uint8], start: Stamps, length: Stamps, log_time: Stamps) -> None:
        """Messages that lie in `data`; see `FieldReader.read`."""
        if not self.count:
            self.largest_first = int(length[0])
        self.count += len(start)
        self.span = (min(self.span[0], int(log_time.min())), max(self.span[1], int(log_time.max())))
        if not self.wanted or self.problem is not None:
            return
        try:
            if self._reader is None:
                self._reader = self._field_reader()
            stamp, value = self._reader.read(data, start, length)
        except MagycError as error:
            self.problem = error
            self._stamp = self._value = None
            return
        if self._by_log_time or not self._reader.stamped:
            stamp = log_time
        if self._stamp is None or self._value is None:
            self._stamp = GrowingColumns(1, np.int64)
            self._value = GrowingColumns(self._reader.width, np.float64)
        self._stamp.add(stamp)
        self._value.add(value)

    def _field_reader(self) -> FieldReader:
        kind = self.type
        if self.encoding not in ("cdr", "ros1"):
            raise MagycError(
                f"{self.name} ({self.schema.name}): {self.encoding} with a schema in {self.schema.encoding!r} "
                "is not decoded"
            )
        if kind in SENSOR_FIELDS:
            types = known_types(kind, ros1=self.encoding == "ros1")
            return FieldReader(self.name, kind, types, self.encoding, self.fields)
        if self.largest_first > LARGEST:
            raise MagycError(
                f"{self.name} ({self.schema.name}): {self.largest_first} bytes, too large for numbers"
            )
        if self.schema.encoding not in ("ros2msg", "ros1msg"):
            raise MagycError(
                f"{self.name} ({self.schema.name}): {self.encoding} with a schema in {self.schema.encoding!r} "
                "is not decoded"
            )
        try:
            types = parse_types(kind, self.schema.data.decode("utf-8", errors="replace"))
        except MagycError as error:
            raise MagycError(f"{self.name} ({self.schema.name}): {error}") from None
        return FieldReader(self.name, kind, types, self.encoding)

    @property
    def stamp(self) -> Stamps:
        """(n,) ns of the messages.

        Raises:
            MagycError: the messages cannot be read.
        """
        if self.problem is not None:
            raise self.problem
        return np.empty(0, dtype=np.int64) if self._stamp is None else self._stamp.column(0)

    def read(self, columns: Sequence[int], last: bool = False) -> Array:
        """(n, len(columns)) numbers, in the order of `columns`; they are given up where asked for the `last` time.

        Raises:
            MagycError: the messages cannot be read.
        """
        if self.problem is not None:
            raise self.problem
        if self._value is None:
            return np.empty((0, len(columns)))
        return self._value.together(columns, last)

    def forget(self) -> None:
        """Begin anew with what comes next."""
        self._stamp = self._value = None

    def channels(self) -> dict[str, Stream]:
        """The numbers by topic without slash, and field where there are several.

        Raises:
            MagycError: the messages cannot be read, or hold no number.
        """
        stamp = self.stamp
        if not self.columns:
            raise MagycError(f"{self.name} ({self.schema.name}): holds no number")
        base = self.name.lstrip("/")
        result = {}
        first = 0
        for path, count in self.columns:
            name = base if len(self.columns) == 1 else f"{base}.{path}"
            width = 1 if count is None else count
            value = self.read(range(first, first + width), last=True)
            result[name] = Stream(name, stamp, value[:, 0] if count is None else value)
            first += width
        return result


@dataclass(frozen=True)
class Source:
    """Where a sensor's numbers are: the topic, and the columns of what is read of it."""

    topic: Topic
    columns: list[int]
    unknown: int | None = None  # the column that is -1 where there is no estimate

    @property
    def name(self) -> str:
        """Of the topic."""
        return self.topic.name


class Topics(dict[str, Topic]):
    """The topics of a file by name, filled by its records.

    Args:
        wanted: whether the numbers of a topic of this name and type are to be read.
        request: its stamps.
        notes: what had to be left out.
        announced: whether a channel without messages so far is a topic.
    """

    def __init__(
        self,
        wanted: Callable[[str, str], bool],
        request: Request,
        notes: list[str],
        announced: bool = False,
    ) -> None:
        super().__init__()
        self._announced = announced
        self._wanted, self._by_log_time, self._notes = wanted, request.stamps == "log", notes
        self._attitude = request.named("attitude") is not None
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._early: dict[int, list[Block]] = {}

    def keep(self, record: Schema | Channel | Block) -> None:
        """Take in a record."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record
            if self._announced:
                self._topic(record)
        else:
            for identifier in np.unique(record.channel).tolist():
                rows = record.channel == identifier
                block = Block(
                    record.data,
                    record.channel[rows],
                    record.log_time[rows],
                    record.start[rows],
                    record.length[rows],
                )
                self._messages(identifier, block)

    def _messages(self, identifier: int, block: Block) -> None:
        channel = self._channels.get(identifier)
        if channel is None or (channel.schema_id and channel.schema_id not in self._schemas):
            # Where a chunk is damaged its channels stand in the summary alone, at the end of the file.
            self._early.setdefault(identifier, []).append(_compact(block))
            return
        for early in self._early.pop(identifier, []):
            self._add(channel, early)
        self._add(channel, block)

    def _topic(self, channel: Channel) -> Topic:
        topic = self.get(channel.topic)
        if topic is None:
            schema = self._schemas.get(channel.schema_id, NO_SCHEMA)
            wanted = self._wanted(channel.topic, short_type(schema.name))
            topic = self[channel.topic] = Topic(
                channel.topic, channel.message_encoding, schema, wanted, self._by_log_time, self._attitude
            )
        return topic

    def _add(self, channel: Channel, block: Block) -> None:
        schema = self._schemas.get(channel.schema_id, NO_SCHEMA)
        topic = self._topic(channel)
        # Two publishers of one topic are two channels in the file, but one topic to everyone else.
        if topic.schema.name == schema.name:
            topic.add(block.data, block.start, block.length, block.log_time)
        else:
            note = f"{channel.topic} has two types; messages of {schema.name} were left out"
            if note not in self._notes:
                self._notes.append(note)

    def finish(self) -> None:
        """Take in what had no channel until the end."""
        for identifier, blocks in self._early.items():
            channel = self._channels.get(identifier)
            if channel is None:
                count = sum(len(b.start) for b in blocks)
                self._notes.append(f"{count} messages of a channel without a record ({identifier}) were left out")
                continue
            for block in blocks:
                self._add(channel, block)
        self._early = {}


def _compact(block: Block) -> Block:
    """The block without the bytes between its messages."""
    pieces = [block.data[s : s + n] for s, n in zip(block.start.tolist(), block.length.tolist(), strict=True)]
    start = np.concatenate([[0], np.cumsum(block.length)[:-1]])
    return Block(np.concatenate(pieces), block.channel, block.log_time, start, block.length)


def choose(topics: Mapping[str, Topic], sensor: str, request: Request, notes: list[str]) -> Source | None:
    """The topic of a sensor: the one named, else the only one of its type; None where there is none.

    Raises:
        MagycError: no such topic, several that could be meant, or no magnetometer.
    """
    name = request.named(sensor)
    if name is not None:
        return checked(topics, sensor, name)
    found = [t for t in topics.values() if t.type == FOUND_BY_TYPE[sensor]]
    listed = ", ".join(f"{t.name} ({t.count} messages)" for t in found)
    if len(found) == 1:
        return checked(topics, sensor, found[0].name)
    if len(found) > 1 and sensor == "attitude":
        notes.append(f"attitude left out: {listed} could be meant; name one (attitude=)")
    elif len(found) > 1:
        raise MagycError(f"{sensor}: {len(found)} topics could be meant: {listed}; name one ({sensor}=)")
    elif sensor == "magnetic_field":
        raise MagycError(
            f"no topic of type {FOUND_BY_TYPE[sensor]}; the file has {_listed(topics)}; "
            f"record the magnetometer too, or name its topic (magnetic_field=) where it has another type{_hint(topics)}"
        )
    elif sensor == "angular_rate":
        notes.append(f"no gyroscope: the file has no topic of type {FOUND_BY_TYPE[sensor]}")
    return None


def checked(topics: Mapping[str, Topic], sensor: str, name: str) -> Source:
    """The topic of that name, or the field of one ("/vectornav/raw.imu.mag"), if it can hold the sensor.

    Raises:
        MagycError: no such topic or field, or of a type or encoding that cannot be read.
    """
    base, _, path = name.partition(".")
    topic = topics.get(name) or topics.get(f"/{name}") or topics.get(base) or topics.get(f"/{base}")
    if topic is None:
        raise MagycError(f"{sensor}: no topic {name!r}; the file has {_listed(topics)}")
    if path and topic.name.lstrip("/") != name.lstrip("/"):
        return _nested(topic, sensor, path)
    fields = SENSOR_FIELDS.get(topic.type, {})
    if sensor not in fields:
        fitting = [k for k, v in SENSOR_FIELDS.items() if sensor in v]
        inside = _vectors(topic)
        field = f"; or name a field of it: {', '.join(inside)}" if inside else ""
        raise MagycError(
            f"{sensor}: {name} is of type {topic.schema.name}; one of {', '.join(fitting)} is needed{field}"
        )
    if topic.encoding not in ("cdr", "ros1"):
        raise MagycError(f"{sensor}: {name} is encoded as {topic.encoding}; cdr (ROS 2) and ros1 can be read")
    order = topic.fields
    unknown = UNKNOWN.get(topic.type, {}).get(sensor)
    return Source(topic, [order.index(p) for p in fields[sensor]], order.index(unknown) if unknown else None)


def _nested(topic: Topic, sensor: str, path: str) -> Source:
    """A vector or short array within a message of any type."""
    if topic.problem is not None:
        raise topic.problem
    places: dict[str, list[int]] = {}
    first = 0
    for column, count in topic.columns:
        places[column] = list(range(first, first + (1 if count is None else count)))
        first += len(places[column])
    axes = _AXES.get(sensor, "xyz")
    parts = [places.get(f"{path}.{axis}", []) for axis in axes]
    found = places.get(path) or [column for part in parts for column in part]
    if len(found) != len(axes) or (path not in places and not all(parts)):
        raise MagycError(
            f"{sensor}: {topic.name} ({topic.schema.name}) has no field {path!r} of {len(axes)} numbers; "
            f"it has {', '.join(_vectors(topic)) or 'none'}"
        )
    return Source(topic, found)


def _vectors(topic: Topic) -> list[str]:
    """The fields of three numbers, as they can be named."""
    names = [path for path, _ in topic.columns]
    vectors = [
        path[:-2] for path in names if path.endswith(".x") and {f"{path[:-1]}{a}" for a in "yz"} <= {*names}
    ]
    return [f"{topic.name}.{path}" for path in [*vectors, *(p for p, n in topic.columns if n == 3)]]


def _hint(topics: Mapping[str, Topic]) -> str:
    inside = [v for t in topics.values() if t.type not in SENSOR_FIELDS for v in _vectors(t)]
    return f", or a vector inside a message: {', '.join(inside[:8])}" if inside else ""


def _listed(topics: Mapping[str, Topic]) -> str:
    return ", ".join(f"{t.name} ({t.schema.name})" for t in topics.values())


def unknown(source: Source) -> bool:
    """Whether all messages say that they have no estimate of the sensor (covariance[0] is -1)."""
    return source.unknown is not None and bool((source.topic.read([source.unknown], last=True) == -1).all())


def needed(request: Request, sensors: Sequence[str]) -> Callable[[str, str], bool]:
    """Whether a topic of a name and type can be one of the sensors, or a channel that is asked for."""
    named = {sensor: request.named(sensor) for sensor in (*sensors, "acceleration")}
    names = {n.lstrip("/") for n in named.values() if n}
    bases = names | {n.partition(".")[0] for n in names}
    found = {FOUND_BY_TYPE[s] for s in sensors if named[s] is None}
    channels = None if request.channels is None else {c.lstrip("/").split(".")[0] for c in request.channels}

    def wanted(name: str, kind: str) -> bool:
        own = name.lstrip("/")
        if own in bases or kind in found:
            return True
        return own in channels if channels is not None else kind not in SENSOR_FIELDS

    return wanted
