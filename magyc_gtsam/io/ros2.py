"""The ROS message types of the sensors: their fields, their definitions, and their encoding."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.io.ros_fields import NANOSECONDS, Array, Stamps
from magyc_gtsam.io.ros_types import Types, parse_types

_FRAME = b"imu\0"


def axes(path: str, names: str = "xyz") -> tuple[str, ...]:
    """Return the paths of the components of a vector or quaternion."""
    return tuple(f"{path}.{name}" for name in names)


# {type: {sensor: the paths of its components}}
SENSOR_FIELDS: dict[str, dict[str, tuple[str, ...]]] = {
    "sensor_msgs/Imu": {
        "attitude": axes("orientation", "xyzw"),
        "angular_rate": axes("angular_velocity"),
        "acceleration": axes("linear_acceleration"),
    },
    "sensor_msgs/MagneticField": {"magnetic_field": axes("magnetic_field")},
    "geometry_msgs/Vector3Stamped": dict.fromkeys(
        ("magnetic_field", "angular_rate", "acceleration"), axes("vector")
    ),
    "geometry_msgs/QuaternionStamped": {"attitude": axes("quaternion", "xyzw")},
    "geometry_msgs/PoseStamped": {"attitude": axes("pose.orientation", "xyzw")},
    "geometry_msgs/PoseWithCovarianceStamped": {"attitude": axes("pose.pose.orientation", "xyzw")},
    "nav_msgs/Odometry": {"attitude": axes("pose.pose.orientation", "xyzw")},
}
# {type: {sensor: the number that is -1 if a message has no estimate of the sensor}}
UNKNOWN = {
    "sensor_msgs/Imu": {
        "attitude": "orientation_covariance[0]",
        "angular_rate": "angular_velocity_covariance[0]",
        "acceleration": "linear_acceleration_covariance[0]",
    }
}


def fields_of(kind: str, attitude: bool = True) -> tuple[str, ...]:
    """Return the paths to read from a known type.

    Args:
        kind: the type.
        attitude: whether to include an attitude in a message that has other sensors too.
    """
    sensors = {k: v for k, v in SENSOR_FIELDS[kind].items() if attitude or k != "attitude"} or SENSOR_FIELDS[kind]
    paths = [path for components in sensors.values() for path in components]
    return tuple(dict.fromkeys([*paths, *(p for k, p in UNKNOWN.get(kind, {}).items() if k in sensors)]))


def known_types(kind: str, ros1: bool) -> Types:
    """Return the definition of a known type, independent of the file."""
    types = dict(parse_types(kind, definition(kind)))
    if ros1:
        types["std_msgs/Header"] = parse_types("std_msgs/Header", "uint32 seq\ntime stamp\nstring frame_id")[
            "std_msgs/Header"
        ]
    return types


def numbers_of(kind: str) -> list[str]:
    """Return the paths of the float64 numbers after the header of a type that is written, in their order."""
    types = known_types(kind, ros1=False)

    def below(name: str, prefix: str) -> list[str]:
        paths: list[str] = []
        for field in types[name]:
            path = f"{prefix}{field.name}"
            if field.type == "float64":
                paths += [f"{path}[{k}]" for k in range(field.size or 0)] if field.array else [path]
            elif field.name != "header":
                paths += below(field.type, f"{path}.")
        return paths

    return below(kind, "")


def encode(stamp: Stamps, value: Array) -> list[bytes]:
    """Encode header stamps (n,) ns and numbers (n, width), in the order of `numbers_of`, as CDR messages."""
    fields = [("encapsulation", "V4"), ("sec", "<i4"), ("nanosec", "<u4"), ("length", "<u4"), ("frame", "S4")]
    table = np.zeros(len(stamp), dtype=[*fields, ("value", "<f8", value.shape[1])])
    table["encapsulation"] = np.void(b"\0\1\0\0")
    table["sec"], table["nanosec"] = np.divmod(stamp, NANOSECONDS)
    table["length"], table["frame"] = len(_FRAME), _FRAME
    table["value"] = value
    return _rows(table)


def encode_numbers(value: Array) -> list[bytes]:
    """Encode (n,) as CDR messages of std_msgs/Float64, or (n, k) of std_msgs/Float64MultiArray."""
    width = 1 if value.ndim == 1 else value.shape[1]
    # The array has an empty list of dimensions, no offset, the number of values, and padding.
    array = [] if value.ndim == 1 else [("dim", "<u4"), ("offset", "<u4"), ("length", "<u4"), ("align", "V4")]
    table = np.zeros(len(value), dtype=[("encapsulation", "V4"), *array, ("value", "<f8", (width,))])
    table["encapsulation"] = np.void(b"\0\1\0\0")
    if value.ndim == 2:
        table["length"] = width
    table["value"] = value.reshape(len(value), width)
    return _rows(table)


def _rows(table: NDArray[np.void]) -> list[bytes]:
    """Return the bytes of each row."""
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
    "geometry_msgs/Vector3Stamped": "std_msgs/Header header\nVector3 vector\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Pose": "Point position\nQuaternion orientation\n",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\nPose pose\n",
    "geometry_msgs/PoseWithCovariance": "Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header header\nPoseWithCovariance pose\n",
    "geometry_msgs/Twist": "Vector3 linear\nVector3 angular\n",
    "geometry_msgs/TwistWithCovariance": "Twist twist\nfloat64[36] covariance\n",
    "nav_msgs/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\n"
        "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist\n"
    ),
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
    """Return the definition of a message type ('sensor_msgs/Imu') and its parts in the format ros2msg of MCAP."""
    parts = [_DEFINITIONS[name]]
    needed = _parts_of(name)
    for part in needed:
        parts.append(f"{_SEPARATOR}\nMSG: {part}\n{_DEFINITIONS[part]}")
        needed.extend(p for p in _parts_of(part) if p not in needed)
    return "".join(parts)


def _parts_of(name: str) -> list[str]:
    """Return the message types of the fields of a type."""
    package = name.split("/")[0]
    types = [line.split()[0].split("[")[0] for line in _DEFINITIONS[name].splitlines()]
    full = [t if "/" in t else f"{package}/{t}" for t in types]
    return list(dict.fromkeys(t for t in full if t in _DEFINITIONS))
