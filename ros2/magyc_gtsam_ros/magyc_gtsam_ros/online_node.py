"""A ROS 2 node that calibrates magnetometer and gyroscope while the vehicle moves.

    ros2 launch magyc_gtsam_ros online.launch.py mag:=/sensors/mag imu:=/sensors/imu state:=/var/lib/compass.state

or, without building the package:

    python online_node.py --ros-args -p output:=/var/lib/compass.yaml -p state:=/var/lib/compass.state \
        -r imu/mag:=/sensors/mag -r imu/data_raw:=/sensors/imu

Subscribes to `imu/mag` (sensor_msgs/MagneticField, tesla) and `imu/data_raw` (sensor_msgs/Imu). Publishes the field
calibrated as `imu/mag_calibrated`, once there is a calibration that has converged, and how far it is as
`magnetometer_calibration` (std_msgs/String, JSON) and on `/diagnostics`. The services `~/start`, `~/stop` and `~/save`
(std_srvs/Trigger) say when it learns, and write the files at once. Writes the calibration and the state every `every`
seconds and at the end; with `state` it goes on where the last run ended, whatever ended it.

`OnlineNode` is all of the logic and needs no ROS; `main` connects it to topics.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.online import Progress
from magyc_gtsam.online.intake import ClockSetBack


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
        self.output, self.state, self.say, self._method = output, state, say, method
        resumed = state is not None and state.exists()
        self.online = mg.OnlineCalibrator.load(state) if resumed else mg.OnlineCalibrator(method)
        self.calibration = self.online.calibration if self.online.converged else None
        self.learning = True
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

    def start(self) -> str:
        """Learn from what comes."""
        self.learning = True
        return "learning"

    def stop(self) -> str:
        """Learn no more; the field is still calibrated, and the estimate kept."""
        self.learning = False
        return f"stopped: {self.progress.sentence}"

    def save(self) -> str:
        """Write the files now."""
        status = self.on_timer()
        return f"{status['sentence']}; saved" if status["hard_iron"] is not None else "there is no calibration yet"

    def diagnosis(self) -> tuple[bool, str, dict[str, str]]:
        """(whether all is well, one sentence, values) for diagnostic_msgs."""
        progress, calibration = self.progress, self.online.calibration
        values = {"coverage": f"{progress.coverage:.0%}", "duration": f"{progress.duration:.0f} s"}
        if calibration is not None:
            values["hard iron"] = ", ".join(f"{1e6 * value:.2f}" for value in calibration.hard_iron) + " µT"
        return progress.converged, progress.sentence if self.learning else f"stopped: {progress.sentence}", values

    @property
    def progress(self) -> Progress:
        """How far the estimate is; that of a new run where the last samples show that the clock was set back."""
        try:
            return self.online.progress
        except ClockSetBack as problem:
            self._begin_anew(problem)
            return self.online.progress

    def _begin_anew(self, problem: ClockSetBack) -> None:
        """Begin a new run, as after a step of the clock; the field is calibrated as before until it has converged."""
        self.say(f"{problem}; a new run begins")
        self.online = mg.OnlineCalibrator(self._method)

    def _update(self, stamp: float, **sample: np.ndarray) -> None:
        if not self.learning:
            return
        try:
            self.online.update(stamp, **sample)
        except ClockSetBack as problem:
            self._begin_anew(problem)
        except mg.MagycError as problem:  # a driver in another unit
            kind = re.sub(r"[\d.]+", "", str(problem))
            if kind not in self._problems:  # once, not at every message
                self._problems.add(kind)
                self.say(str(problem))

    def on_timer(self) -> dict[str, Any]:
        """Look at the estimate, write the files, and say what an operator should know.

        Looking can cost a fit of all data so far, so it is not done at every message.
        """
        progress, calibration = self.progress, self.online.calibration
        if self.state is not None:
            self.online.save(self.state)
        if calibration is not None:
            calibration.save(self.output)
        if progress.converged and calibration is not None and calibration.trusted:
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
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import Imu, MagneticField
    from std_msgs.msg import String
    from std_srvs.srv import Trigger

    rclpy.init()
    ros = rclpy.create_node("magnetometer_calibration")
    output = Path(ros.declare_parameter("output", "calibration.yaml").value)
    state = ros.declare_parameter("state", "").value
    method = ros.declare_parameter("method", "smoother").value
    every = ros.declare_parameter("every", 10.0).value
    node = OnlineNode(output, Path(state) if state else None, method, ros.get_logger().info)

    calibrated = ros.create_publisher(MagneticField, "imu/mag_calibrated", qos_profile_sensor_data)
    status = ros.create_publisher(String, "magnetometer_calibration", 1)

    diagnostics = ros.create_publisher(DiagnosticArray, "/diagnostics", 1)

    def on_timer() -> None:
        status.publish(String(data=json.dumps(node.on_timer())))
        good, sentence, values = node.diagnosis()
        level = DiagnosticStatus.OK if good else DiagnosticStatus.WARN
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        said = DiagnosticStatus(level=level, name="magnetometer calibration", message=sentence, values=pairs)
        array = DiagnosticArray(status=[said])
        array.header.stamp = ros.get_clock().now().to_msg()
        diagnostics.publish(array)

    def service(action: Callable[[], str]) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            try:
                response.success, response.message = True, action()
            except (mg.MagycError, OSError) as problem:  # a full disk, a folder that is gone
                response.success, response.message = False, str(problem)
            return response

        return answer

    for name, action in (("start", node.start), ("stop", node.stop), ("save", node.save)):
        ros.create_service(Trigger, f"~/{name}", service(action))

    def on_field(message: Any) -> None:
        field = node.on_field(message)
        if field is not None:
            vector = message.magnetic_field
            vector.x, vector.y, vector.z = (float(value) for value in field)
            calibrated.publish(message)

    ros.create_subscription(MagneticField, "imu/mag", on_field, qos_profile_sensor_data)
    ros.create_subscription(Imu, "imu/data_raw", node.on_imu, qos_profile_sensor_data)
    ros.create_timer(every, on_timer)
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
