"""The ROS messages that carry what is read here: their layout, their definitions, and their bytes in bulk.

These messages are a header, at most one more string, and float64s, so all messages of a topic are read as
one array. Every other message is left to `mcap_ros2`.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

NANOSECONDS = 1_000_000_000
_FRAME = b"imu\0"


@dataclass(frozen=True)
class Layout:
    """float64s behind the header of a message, and which of them are what.

    Args:
        width: how many float64s there are.
        parts: {"magnetic_field" | "angular_rate" | "acceleration" | "attitude": their slice}.
        strings: further strings between header and numbers.
        unknown: {part: index of the float64 that is -1 where the part has no estimate}.
    """

    width: int
    parts: dict[str, slice]
    strings: int = 0
    unknown: dict[str, int] | None = None


_VECTOR = slice(0, 3)
LAYOUTS = {
    "sensor_msgs/Imu": Layout(
        37,
        {"attitude": slice(0, 4), "angular_rate": slice(13, 16), "acceleration": slice(25, 28)},
        unknown={"attitude": 4, "angular_rate": 16, "acceleration": 28},
    ),
    "sensor_msgs/MagneticField": Layout(12, {"magnetic_field": _VECTOR}),
    "geometry_msgs/Vector3Stamped": Layout(
        3, dict.fromkeys(("magnetic_field", "angular_rate", "acceleration"), _VECTOR)
    ),
    "geometry_msgs/QuaternionStamped": Layout(4, {"attitude": slice(0, 4)}),
    "geometry_msgs/PoseStamped": Layout(7, {"attitude": slice(3, 7)}),
    "geometry_msgs/PoseWithCovarianceStamped": Layout(43, {"attitude": slice(3, 7)}),
    "nav_msgs/Odometry": Layout(85, {"attitude": slice(3, 7)}, strings=1),
}


def short_type(schema_name: str) -> str:
    """'sensor_msgs/Imu' for both 'sensor_msgs/msg/Imu' (ROS 2) and 'sensor_msgs/Imu' (ROS 1)."""
    return schema_name.replace("/msg/", "/")


def decode(topic: str, messages: Sequence[bytes], layout: Layout, encoding: str) -> tuple[Stamps, Array]:
    """Header stamps (n,) ns and numbers (n, width) of all messages of a topic.

    Args:
        topic: for error messages.
        messages: the serialized messages.
        layout: of their type.
        encoding: "cdr" (ROS 2) or "ros1".

    Raises:
        MagycError: a message is shorter than its type, or serialized in a way that is not known.
    """
    stamp = np.empty(len(messages), dtype=np.int64)
    value = np.empty((len(messages), layout.width))
    # All messages with the numbers at the same place are read at once; as a rule that is all of them.
    alike: dict[tuple[str, int, int], list[int]] = {}
    for i, data in enumerate(messages):
        try:
            order, place = _place(data, layout, encoding)
        except (struct.error, IndexError):
            raise _broken(topic, i, len(data)) from None
        if place + 8 * layout.width > len(data):
            raise _broken(topic, i, len(data))
        alike.setdefault((order, place, len(data)), []).append(i)
    for (order, place, length), rows in alike.items():
        table = np.frombuffer(b"".join([messages[i] for i in rows]), dtype=np.uint8).reshape(len(rows), length)
        seconds, nanoseconds = (
            table[:, 4:8].copy().view(f"{order}i4"),
            table[:, 8:12].copy().view(f"{order}u4"),
        )
        stamp[rows] = seconds[:, 0].astype(np.int64) * NANOSECONDS + nanoseconds[:, 0]
        value[rows] = table[:, place : place + 8 * layout.width].copy().view(f"{order}f8")
    return stamp, value


def _place(data: bytes, layout: Layout, encoding: str) -> tuple[str, int]:
    """Byte order, and where the numbers start. Bytes 4 to 16 are sec, nanosec and the frame's length."""
    if encoding == "ros1":
        order, align = "<", 1
    elif data[0] == 0 and data[1] in (0, 1):
        order, align = "><"[data[1]], 4
    else:
        raise MagycError(
            f"encapsulation 0x{data[:2].hex()} of CDR is not supported, only plain CDR (0x0000, 0x0001)"
        )
    place = 12
    for _ in range(1 + layout.strings):
        place += -place % align
        place += 4 + int(struct.unpack_from(f"{order}I", data, place)[0])
    if encoding == "cdr":
        place += -(place - 4) % 8  # CDR aligns by the distance from the end of the encapsulation
    return order, place


def _broken(topic: str, index: int, length: int) -> MagycError:
    return MagycError(
        f"{topic}: message {index + 1} of {length} bytes is too short for its type; "
        "the log is damaged there, or its schema names the wrong type"
    )


def encode(stamp: Stamps, value: Array) -> list[bytes]:
    """CDR messages of header stamps (n,) ns and numbers (n, width), the reverse of `decode`."""
    fields = [("encapsulation", "V4"), ("sec", "<i4"), ("nanosec", "<u4"), ("length", "<u4"), ("frame", "S4")]
    table = np.zeros(len(stamp), dtype=[*fields, ("value", "<f8", value.shape[1])])
    table["encapsulation"] = np.void(b"\0\1\0\0")
    table["sec"], table["nanosec"] = np.divmod(stamp, NANOSECONDS)
    table["length"], table["frame"] = len(_FRAME), _FRAME
    table["value"] = value
    return _rows(table)


def encode_numbers(value: Array) -> list[bytes]:
    """CDR messages of std_msgs/Float64 from (n,) or std_msgs/Float64MultiArray from (n, k)."""
    width = 1 if value.ndim == 1 else value.shape[1]
    # An empty list of dimensions, no offset, the number of values, and what aligns them.
    array = [] if value.ndim == 1 else [("dim", "<u4"), ("offset", "<u4"), ("length", "<u4"), ("align", "V4")]
    table = np.zeros(len(value), dtype=[("encapsulation", "V4"), *array, ("value", "<f8", width)])
    table["encapsulation"] = np.void(b"\0\1\0\0")
    if value.ndim == 2:
        table["length"] = width
    table["value"] = value.reshape(len(value), width)
    return _rows(table)


def _rows(table: NDArray[np.void]) -> list[bytes]:
    data, size = table.tobytes(), table.dtype.itemsize
    return [data[i : i + size] for i in range(0, len(data), size)]


_SEPARATOR = "=" * 80
_DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "std_msgs/Float64": "float64 data\n",
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride\n",
    "std_msgs/MultiArrayLayout": "MultiArrayDimension[] dim\nuint32 data_offset\n",
    "std_msgs/Float64MultiArray": "MultiArrayLayout layout\nfloat64[] data\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    "geometry_msgs/QuaternionStamped": "std_msgs/Header header\nQuaternion quaternion\n",
    "sensor_msgs/Imu": (
        "std_msgs/Header header\n"
        "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
    ),
    "sensor_msgs/MagneticField": (
        "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance\n"
    ),
}


def definition(name: str) -> str:
    """The definition of a message type ('sensor_msgs/Imu') with those it is made of, as MCAP's ros2msg."""
    parts = [_DEFINITIONS[name]]
    needed = _parts_of(name)
    for part in needed:
        parts.append(f"{_SEPARATOR}\nMSG: {part}\n{_DEFINITIONS[part]}")
        needed.extend(p for p in _parts_of(part) if p not in needed)
    return "".join(parts)


def _parts_of(name: str) -> list[str]:
    package = name.split("/")[0]
    types = [line.split()[0].split("[")[0] for line in _DEFINITIONS[name].splitlines()]
    full = [t if "/" in t else f"{package}/{t}" for t in types]
    return list(dict.fromkeys(t for t in full if t in _DEFINITIONS))
