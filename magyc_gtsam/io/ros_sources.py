"""Assignment of the topics of a ROS log to sensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros2 import SENSOR_FIELDS, UNKNOWN
from magyc_gtsam.io.ros_topic import Topic

# The message type of each sensor; for other types the caller must name the topic.
FOUND_BY_TYPE = {
    "magnetic_field": "sensor_msgs/MagneticField",
    "angular_rate": "sensor_msgs/Imu",
    "attitude": "geometry_msgs/QuaternionStamped",
}
_AXES = {"attitude": "xyzw"}


@dataclass(frozen=True)
class SensorSource:
    """The source of a sensor's numbers.

    Attributes:
        topic: the topic.
        columns: the sensor's columns in the numbers of the topic.
        mark: the field that is -1 if a message has no estimate of the sensor; None without such a field.
    """

    topic: Topic
    columns: list[int]
    mark: str | None = None

    @property
    def name(self) -> str:
        """The name of the topic."""
        return self.topic.name


def choose(topics: Mapping[str, Topic], sensor: str, request: Request, notes: list[str]) -> SensorSource | None:
    """Return the source of a sensor: the topic that is named, else the only one of its type; None without any.

    Raises:
        MagycError: the named topic does not exist, several topics match, or there is no magnetometer.
    """
    name = request.named(sensor)
    if name is not None:
        return checked(topics, sensor, name)
    matches = [t for t in topics.values() if t.type == FOUND_BY_TYPE[sensor]]
    several = listed([f"{t.name} ({t.count} messages)" for t in matches])
    if len(matches) == 1:
        return checked(topics, sensor, matches[0].name)
    if len(matches) > 1 and sensor == "attitude":
        notes.append(f"attitude left out: {several} could be meant; name one (attitude=)")
    elif len(matches) > 1:
        raise MagycError(f"{sensor}: {len(matches)} topics could be meant: {several}; name one ({sensor}=)")
    elif sensor == "magnetic_field":
        raise MagycError(
            f"no topic of type {FOUND_BY_TYPE[sensor]}; the file has {_listed(topics)}; "
            f"record the magnetometer too, or name its topic (magnetic_field=) if it has another type{_hint(topics)}"
        )
    elif sensor == "angular_rate":
        notes.append(f"no gyroscope: the file has no topic of type {FOUND_BY_TYPE[sensor]}")
    return None


def checked(topics: Mapping[str, Topic], sensor: str, name: str) -> SensorSource:
    """Return the topic with a name, or the field of one ("/vectornav/raw.imu.mag"), as the source of a sensor.

    Raises:
        MagycError: the topic or field does not exist, or its type or encoding cannot be read.
    """
    base, _, path = name.partition(".")
    topic = topics.get(name) or topics.get(f"/{name}") or topics.get(base) or topics.get(f"/{base}")
    if topic is None:
        raise MagycError(f"{sensor}: no topic {name!r}; the file has {_listed(topics)}")
    if path and topic.name.lstrip("/") != name.lstrip("/"):
        return _nested(topic, sensor, path)
    fields = SENSOR_FIELDS.get(topic.type, {})
    if sensor not in fields:
        suitable = [k for k, v in SENSOR_FIELDS.items() if sensor in v]
        inside = _vectors(topic)
        field = f"; or name a field of it: {listed(inside)}" if inside else ""
        raise MagycError(
            f"{sensor}: {name} must be of type {' or '.join(suitable)}, got {topic.schema.name}{field}"
        )
    if topic.encoding not in ("cdr", "ros1"):
        raise MagycError(f"{sensor}: {name} is encoded as {topic.encoding}; cdr (ROS 2) and ros1 can be read")
    order = topic.fields
    return SensorSource(topic, [order.index(p) for p in fields[sensor]], UNKNOWN.get(topic.type, {}).get(sensor))


def _nested(topic: Topic, sensor: str, path: str) -> SensorSource:
    """Return a vector or short array within a message of any type as the source of a sensor."""
    if topic.problem is not None:
        raise topic.problem
    places: dict[str, list[int]] = {}
    first = 0
    for column, count in topic.columns:
        places[column] = list(range(first, first + (1 if count is None else count)))
        first += len(places[column])
    axes = _AXES.get(sensor, "xyz")
    parts = [places.get(f"{path}.{axis}", []) for axis in axes]
    columns = places.get(path) or [column for part in parts for column in part]
    if len(columns) != len(axes) or (path not in places and not all(parts)):
        raise MagycError(
            f"{sensor}: {topic.name} ({topic.schema.name}) has no field {path!r} of {len(axes)} numbers; "
            f"it has {listed(_vectors(topic)) or 'none'}"
        )
    return SensorSource(topic, columns)


def _vectors(topic: Topic) -> list[str]:
    """Return the names of the fields with three numbers."""
    names = [path for path, _ in topic.columns]
    vectors = [
        path[:-2] for path in names if path.endswith(".x") and {f"{path[:-1]}{a}" for a in "yz"} <= {*names}
    ]
    return [f"{topic.name}.{path}" for path in [*vectors, *(p for p, n in topic.columns if n == 3)]]


def _hint(topics: Mapping[str, Topic]) -> str:
    """Return the vectors inside messages that the caller could name, in words; "" without any."""
    inside = [v for t in topics.values() if t.type not in SENSOR_FIELDS for v in _vectors(t)]
    return f", or a vector inside a message: {listed(inside)}" if inside else ""


def _listed(topics: Mapping[str, Topic]) -> str:
    return listed([f"{t.name} ({t.schema.name})" for t in topics.values()])


def unknown(source: SensorSource) -> bool:
    """Return whether all messages declare that they have no estimate of the sensor (covariance[0] is -1)."""
    return source.mark is not None and source.topic.unknown(source.mark)


def needed(request: Request, sensors: Sequence[str]) -> Callable[[str, str], bool]:
    """Return a function that decides by name and type whether a topic can be a sensor or a requested channel."""
    named = {sensor: request.named(sensor) for sensor in (*sensors, "acceleration")}
    names = {n.lstrip("/") for n in named.values() if n}
    bases = names | {n.partition(".")[0] for n in names}
    types = {FOUND_BY_TYPE[s] for s in sensors if named[s] is None}
    channels = None if request.channels is None else {c.lstrip("/").split(".")[0] for c in request.channels}

    def wanted(name: str, kind: str) -> bool:
        name = name.lstrip("/")
        if name in bases or kind in types:
            return True
        return name in channels if channels is not None else kind not in SENSOR_FIELDS

    return wanted
