"""Samples from ROS 2 topics; needs a ROS 2 installation (`rclpy`)."""

from __future__ import annotations

import time
from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros_sources import FOUND_BY_TYPE
from magyc_gtsam.live.source import SENSORS, NewSamples, samples_of

_VECTOR = {"magnetic_field": "magnetic_field", "angular_rate": "angular_velocity"}  # fields of the messages


class Ros2Topics:
    """Samples from a MagneticField and an Imu topic; a `LiveSource`.

    Args:
        request: topics and units; a sensor without a named topic takes the only topic of its type.

    Raises:
        MagycError: here or from `read`: ROS 2 is not available, or several topics match.
    """

    def __init__(self, request: Request) -> None:
        try:
            import rclpy
            import rclpy.executors
            from rclpy.qos import qos_profile_sensor_data
            from sensor_msgs.msg import Imu, MagneticField
        except ImportError:
            raise MagycError(
                "ros2://: needs rclpy and sensor_msgs; source the setup file of your ROS 2 in this terminal first"
            ) from None
        self.name = "ros2://"
        self.ended = False
        self.received = self.lost = 0
        self.notes: list[str] = []
        self._types = {"magnetic_field": MagneticField, "angular_rate": Imu}
        self._request, self._rclpy, self._quality = request, rclpy, qos_profile_sensor_data
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("magyc_gtsam_online", context=self._context)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._rows: dict[str, list[list[float]]] = {sensor: [] for sensor in SENSORS}
        self._topic: dict[str, str] = {}

    @property
    def waiting_for(self) -> str:
        """The sensors without a topic so far; see `LiveSource`."""
        absent = [f"{s} ({self._request.named(s) or FOUND_BY_TYPE[s]})" for s in SENSORS if s not in self._topic]
        return f"no topic of {' and '.join(absent)} yet" if absent else ""

    def read(self, wait: float = 0.0) -> NewSamples:
        """Return the new samples; see `LiveSource.read`."""
        self._subscribe()
        until = time.monotonic() + wait
        while not any(self._rows.values()):
            self._executor.spin_once(timeout_sec=max(until - time.monotonic(), 0.0))
            if time.monotonic() >= until:
                break
        rows, self._rows = self._rows, {sensor: [] for sensor in SENSORS}
        new = [samples_of(rows[sensor]) for sensor in SENSORS]
        scales = [self._request.scale(sensor) for sensor in SENSORS]
        return NewSamples(*(s._replace(value=s.value * scale) for s, scale in zip(new, scales, strict=True)))

    def close(self) -> None:
        """Leave the ROS network."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._rclpy.shutdown(context=self._context)

    def _subscribe(self) -> None:
        """Subscribe to the topics of sensors that have none yet."""
        absent = [sensor for sensor in SENSORS if sensor not in self._topic]
        present = self._node.get_topic_names_and_types() if absent else []
        for sensor in absent:
            named = self._request.named(sensor)
            matches = [name for name, types in present if _ros2_name(sensor) in types]
            if named is None and len(matches) > 1:
                raise MagycError(
                    f"ros2://: {', '.join(matches)} could be the {sensor}; name one ({sensor}={matches[0]})"
                )
            if topic := named or next(iter(matches), None):
                self._topic[sensor] = topic
                self._node.create_subscription(
                    self._types[sensor], topic, lambda message, s=sensor: self._take(s, message), self._quality
                )

    def _take(self, sensor: str, message: Any) -> None:
        if sensor == "angular_rate" and message.angular_velocity_covariance[0] == -1:
            self.lost += 1  # -1 declares that the message holds no angular rate
            return
        stamp, vector = message.header.stamp, getattr(message, _VECTOR[sensor])
        self.received += 1
        self._rows[sensor].append([(stamp.sec * 10**9 + stamp.nanosec) / 1e9, vector.x, vector.y, vector.z])


def _ros2_name(sensor: str) -> str:
    package, message = FOUND_BY_TYPE[sensor].split("/")
    return f"{package}/msg/{message}"
