"""A ROS 2 node that calibrates magnetometer and gyroscope while the vehicle moves.

    python ros2_online_node.py --ros-args -p output:=/var/lib/compass.yaml -p state:=/var/lib/compass.state \
        -r imu/mag:=/sensors/mag -r imu/data_raw:=/sensors/imu

Subscribes to `imu/mag` (sensor_msgs/MagneticField, tesla) and `imu/data_raw` (sensor_msgs/Imu). Publishes the field
calibrated as `imu/mag_calibrated`, once there is a calibration that has converged, and how far it is as
`magnetometer_calibration` (std_msgs/String, JSON). Writes the calibration and the state every `every` seconds and
at the end; with `state` it goes on where the last run ended, whatever ended it.

`OnlineNode` is all of the logic and needs no ROS; `main` connects it to topics.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

import magyc_gtsam as mg


class OnlineNode:
    """What the node does, message by message.

    Args:
        output: file of the calibration, .yaml or .json.
        state: file of the state to go on from, and to save; None for none.
        method: "smoother" or "magyc-ifg".
        say: called with what an operator should read.
    """

    def __init__(
        self, output: Path, state: Path | None = None, method: str = "smoother", say: Any = print
    ) -> None:
        self.output, self.state, self.say = output, state, say
        resumed = state is not None and state.exists()
        self.online = mg.OnlineCalibrator.load(state) if resumed else mg.OnlineCalibrator(method)
        self.calibration = self.online.calibration if self.online.converged else None
        self._said = ""
        self._problems: set[str] = set()

    def on_field(self, message: Any) -> np.ndarray | None:
        """Take a MagneticField; its field calibrated (3,) T, None while the calibration has not converged."""
        vector = message.magnetic_field
        field = np.array([vector.x, vector.y, vector.z])
        self._update(_seconds(message.header.stamp), magnetic_field=field)
        return None if self.calibration is None else self.calibration.apply(field)

    def on_imu(self, message: Any) -> None:
        """Take an Imu; one without angular rate (covariance[0] = −1) is left out."""
        if message.angular_velocity_covariance[0] == -1:
            return
        vector = message.angular_velocity
        self._update(_seconds(message.header.stamp), angular_rate=np.array([vector.x, vector.y, vector.z]))

    def _update(self, stamp: float, **sample: np.ndarray) -> None:
        try:
            self.online.update(stamp, **sample)
        except mg.MagycError as problem:  # a clock that was set back, a driver in another unit
            kind = re.sub(r"[\d.]+", "", str(problem))
            if kind not in self._problems:  # once, not at every message
                self._problems.add(kind)
                self.say(str(problem))

    def on_timer(self) -> dict[str, Any]:
        """Look at the estimate, write the files, and say what an operator should know.

        Looking can cost a fit of all data so far, so it is not done at every message.
        """
        progress, calibration = self.online.progress, self.online.calibration
        if self.state is not None:
            self.online.save(self.state)
        if calibration is not None:
            calibration.save(self.output)
        if progress.converged:
            self.calibration = calibration
        if progress.sentence != self._said:
            self._said = progress.sentence
            self.say(progress.sentence)
        return {
            "converged": progress.converged,
            "sentence": progress.sentence,
            "coverage": progress.coverage,
            "duration": progress.duration,
            "hard_iron": None if calibration is None else calibration.hard_iron.tolist(),
            "changes": [{"time": change.time, "step": change.step.tolist()} for change in self.online.changes],
        }


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


def main() -> None:
    """Run the node until it is told to end."""
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import Imu, MagneticField
    from std_msgs.msg import String

    rclpy.init()
    ros = rclpy.create_node("magnetometer_calibration")
    output = Path(ros.declare_parameter("output", "calibration.yaml").value)
    state = ros.declare_parameter("state", "").value
    method = ros.declare_parameter("method", "smoother").value
    every = ros.declare_parameter("every", 10.0).value
    node = OnlineNode(output, Path(state) if state else None, method, ros.get_logger().info)

    calibrated = ros.create_publisher(MagneticField, "imu/mag_calibrated", qos_profile_sensor_data)
    status = ros.create_publisher(String, "magnetometer_calibration", 1)

    def on_field(message: Any) -> None:
        field = node.on_field(message)
        if field is not None:
            vector = message.magnetic_field
            vector.x, vector.y, vector.z = (float(value) for value in field)
            calibrated.publish(message)

    ros.create_subscription(MagneticField, "imu/mag", on_field, qos_profile_sensor_data)
    ros.create_subscription(Imu, "imu/data_raw", node.on_imu, qos_profile_sensor_data)
    ros.create_timer(every, lambda: status.publish(String(data=json.dumps(node.on_timer()))))
    try:
        rclpy.spin(ros)
    except KeyboardInterrupt:
        pass
    finally:
        node.on_timer()
        ros.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
