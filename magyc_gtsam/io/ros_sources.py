"""Which topic of a ROS log is which sensor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros2 import SENSOR_FIELDS, UNKNOWN
from magyc_gtsam.io.ros_topic import Topic

# The type that each sensor is published as; of other types the caller must name the topic.
FOUND_BY_TYPE = {
    "magnetic_field": "sensor_msgs/MagneticField",
    "angular_rate": "sensor_msgs/Imu",
    "attitude": "geometry_msgs/QuaternionStamped",
}
_AXES = {"attitude": "xyzw"}


@dataclass(frozen=True)
class SensorSource:
    """Where a sensor's numbers are: the topic, and the columns of what is read of it."""

    topic: Topic
    columns: list[int]
    mark: str | None = None  # the field that is -1 where there is no estimate

    @property
    def name(self) -> str:
        """Of the topic."""
        return self.topic.name


def choose(topics: Mapping[str, Topic], sensor: str, request: Request, notes: list[str]) -> SensorSource | None:
    """The topic of a sensor: the one named, else the only one of its type; None where there is none.

    Raises:
        MagycError: no such topic, several that could be meant, or no magnetometer.
    """
    name = request.named(sensor)
    if name is not None:
        return checked(topics, sensor, name)
    found = [t for t in topics.values() if t.type == FOUND_BY_TYPE[sensor]]
    several = listed([f"{t.name} ({t.count} messages)" for t in found])
    if len(found) == 1:
        return checked(topics, sensor, found[0].name)
    if len(found) > 1 and sensor == "attitude":
        notes.append(f"attitude left out: {several} could be meant; name one (attitude=)")
    elif len(found) > 1:
        raise MagycError(f"{sensor}: {len(found)} topics could be meant: {several}; name one ({sensor}=)")
    elif sensor == "magnetic_field":
        raise MagycError(
            f"no topic of type {FOUND_BY_TYPE[sensor]}; the file has {_listed(topics)}; "
            f"record the magnetometer too, or name its topic (magnetic_field=) where it has another type{_hint(topics)}"
        )
    elif sensor == "angular_rate":
        notes.append(f"no gyroscope: the file has no topic of type {FOUND_BY_TYPE[sensor]}")
    return None


def checked(topics: Mapping[str, Topic], sensor: str, name: str) -> SensorSource:
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
        field = f"; or name a field of it: {listed(inside)}" if inside else ""
        raise MagycError(
            f"{sensor}: {name} is of type {topic.schema.name}; one of {', '.join(fitting)} is needed{field}"
        )
    if topic.encoding not in ("cdr", "ros1"):
        raise MagycError(f"{sensor}: {name} is encoded as {topic.encoding}; cdr (ROS 2) and ros1 can be read")
    order = topic.fields
    return SensorSource(topic, [order.index(p) for p in fields[sensor]], UNKNOWN.get(topic.type, {}).get(sensor))


def _nested(topic: Topic, sensor: str, path: str) -> SensorSource:
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
            f"it has {listed(_vectors(topic)) or 'none'}"
        )
    return SensorSource(topic, found)


def _vectors(topic: Topic) -> list[str]:
    """The fields of three numbers, as they can be named."""
    names = [path for path, _ in topic.columns]
    vectors = [
        path[:-2] for path in names if path.endswith(".x") and {f"{path[:-1]}{a}" for a in "yz"} <= {*names}
    ]
    return [f"{topic.name}.{path}" for path in [*vectors, *(p for p, n in topic.columns if n == 3)]]


def _hint(topics: Mapping[str, Topic]) -> str:
    inside = [v for t in topics.values() if t.type not in SENSOR_FIELDS for v in _vectors(t)]
    return f", or a vector inside a message: {listed(inside)}" if inside else ""


def _listed(topics: Mapping[str, Topic]) -> str:
    return listed([f"{t.name} ({t.schema.name})" for t in topics.values()])


def unknown(source: SensorSource) -> bool:
    """Whether all messages say that they have no estimate of the sensor (covariance[0] is -1)."""
    return source.mark is not None and source.topic.unknown(source.mark)


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
