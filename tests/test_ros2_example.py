"""The ROS 2 example without ROS: its logic on simulated messages, and its topics on a stand-in for rclpy."""

from __future__ import annotations

import copy
import importlib.util
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.simulation import simulate

PACKAGE = Path(__file__).parents[1] / "ros2" / "magyc_gtsam_ros"
EXAMPLE = PACKAGE / "magyc_gtsam_ros" / "online_node.py"
START = 1_620_000_000


@pytest.fixture(scope="module")
def example() -> ModuleType:
    assert "rclpy" not in sys.modules
    specification = importlib.util.spec_from_file_location("ros2_online_node", EXAMPLE)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    assert "rclpy" not in sys.modules
    return module


@pytest.fixture(scope="module")
def simulation() -> mg.Simulation:
    return simulate("wide", duration=120, rate=10, seed=1)


def messages(simulation: mg.Simulation) -> list[tuple[str, Any]]:
    """(topic, message) in order, both sensors at every stamp."""
    result: list[tuple[str, Any]] = []
    at = simulation.recording
    assert at.angular_rate is not None
    for time, field, rate in zip(at.time, at.magnetic_field, at.angular_rate, strict=True):
        nanoseconds = round(time * 1e9)
        stamp = SimpleNamespace(sec=START + nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        header = SimpleNamespace(stamp=stamp)
        x, y, z = map(float, field)
        vector = SimpleNamespace(x=x, y=y, z=z)
        result.append(("imu/mag", SimpleNamespace(header=header, magnetic_field=vector)))
        x, y, z = map(float, rate)
        imu = SimpleNamespace(
            header=header,
            angular_velocity=SimpleNamespace(x=x, y=y, z=z),
            angular_velocity_covariance=[0.0] * 9,
        )
        result.append(("imu/data_raw", imu))
    return result


def feed(node: Any, part: list[tuple[str, Any]]) -> list[np.ndarray]:
    calibrated = []
    for topic, message in part:
        if topic == "imu/data_raw":
            node.on_imu(message)
        elif (field := node.on_field(message)) is not None:
            calibrated.append(field)
    return calibrated


def earlier(part: list[tuple[str, Any]], seconds: int) -> list[tuple[str, Any]]:
    result = copy.deepcopy(part)
    for stamp in {id(message.header.stamp): message.header.stamp for _, message in result}.values():
        stamp.sec -= seconds
    return result


@pytest.mark.parametrize("restarted", [False, True])
def test_it_begins_anew_where_the_clock_was_set_back(
    restarted: bool, example: ModuleType, simulation: mg.Simulation, tmp_path: Path
) -> None:
    """In a run, or before one that goes on from a saved state; found by the timer or by a message."""
    said: list[str] = []
    arguments = (tmp_path / "cal.yaml", tmp_path / "state", "magyc-ifg", said.append)
    node, everything = example.OnlineNode(*arguments), messages(simulation)
    feed(node, everything)
    assert node.on_timer()["converged"]
    before = node.calibration
    if restarted:
        node = example.OnlineNode(*arguments)
    set_back = earlier(everything, 1000)
    feed(node, set_back[:40])
    node.on_timer()
    assert sum("time goes back" in each and each.endswith("a new run begins") for each in said) == 1
    assert np.array_equal(node.calibration.hard_iron, before.hard_iron)  # the field is calibrated as before
    feed(node, set_back[40:])
    assert node.on_timer()["converged"]
    assert node.calibration.hard_iron == pytest.approx(simulation.truth.hard_iron, abs=2e-6)


def test_it_calibrates_says_what_is_missing_and_goes_on_after_a_kill(
    example: ModuleType, simulation: mg.Simulation, tmp_path: Path
) -> None:
    said: list[str] = []
    arguments = (tmp_path / "cal.yaml", tmp_path / "state", "magyc-ifg", said.append)
    node = example.OnlineNode(*arguments)
    everything = messages(simulation)
    assert feed(node, everything[:60]) == []
    status = node.on_timer()
    assert not status["converged"]
    assert said == [status["sentence"]]
    feed(node, everything[60:1600])
    node.on_timer()
    del node  # killed: nothing is called at the end

    node = example.OnlineNode(*arguments)
    feed(node, everything[1600:2000])
    status = node.on_timer()
    assert status["converged"]
    assert json.loads(json.dumps(status)) == status
    assert said[-1] == "converged"
    calibrated = feed(node, everything[2000:])
    assert len(calibrated) == 200
    spread = np.linalg.norm(calibrated, axis=1).std()
    assert spread < 0.5 * np.linalg.norm(simulation.recording.magnetic_field, axis=1).std()

    node.on_timer()
    found = mg.Calibration.load(tmp_path / "cal.yaml")
    whole = mg.OnlineCalibrator("magyc-ifg")
    at = simulation.recording
    stamps = [m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for topic, m in everything if topic == "imu/mag"]
    whole.update(stamps, at.magnetic_field, at.angular_rate)
    np.testing.assert_array_equal(found.hard_iron, whole.calibration.hard_iron)


def test_an_imu_without_rate_and_a_clock_that_is_set_back_are_survived(
    example: ModuleType, simulation: mg.Simulation, tmp_path: Path
) -> None:
    said: list[str] = []
    node = example.OnlineNode(tmp_path / "cal.yaml", None, "magyc-ifg", said.append)
    everything = messages(simulation)
    feed(node, everything[:400])
    everything[401][1].angular_velocity_covariance[0] = -1
    before = node.online.taken_until[1]
    node.on_imu(everything[401][1])
    assert node.online.taken_until[1] == before
    back = copy.deepcopy(everything[:40])
    for _, message in back:  # the same values again would be messages that are sent again
        turned = message.magnetic_field if hasattr(message, "magnetic_field") else message.angular_velocity
        turned.x *= 1.01
    feed(node, back)
    assert 1 <= len(said) <= 2  # once per sensor, not per message
    assert "time goes back" in said[0]
    feed(node, everything[402:])
    assert node.on_timer()["hard_iron"] is not None


class Ros:
    """As much of rclpy as the example touches: parameters, topics, a timer, and a spin that plays messages."""

    def __init__(self, parameters: dict[str, Any], played: list[tuple[str, Any]]) -> None:
        self.parameters, self.played = parameters, played
        self.subscriptions: dict[str, Callable[[Any], None]] = {}
        self.published: dict[str, list[Any]] = {}
        self.timers: list[Callable[[], None]] = []
        self.services: dict[str, Callable[[Any, Any], Any]] = {}
        self.ended: list[str] = []

    def create_node(self, name: str) -> Ros:
        return self

    def declare_parameter(self, name: str, default: Any) -> SimpleNamespace:
        return SimpleNamespace(value=self.parameters.get(name, default))

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(info=lambda text: None)

    def create_publisher(self, kind: Any, topic: str, qos: Any) -> SimpleNamespace:
        return SimpleNamespace(publish=self.published.setdefault(topic, []).append)

    def create_subscription(self, kind: Any, topic: str, callback: Callable[[Any], None], qos: Any) -> None:
        self.subscriptions[topic] = callback

    def create_service(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> None:
        self.services[name] = callback

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: SimpleNamespace(sec=START, nanosec=0)))

    def create_timer(self, period: float, callback: Callable[[], None]) -> None:
        self.timers.append(callback)

    def spin(self, node: Any) -> None:
        for number, (topic, message) in enumerate(self.played):
            self.subscriptions[topic](message)
            if number % 200 == 199:
                for timer in self.timers:
                    timer()
        raise KeyboardInterrupt

    def destroy_node(self) -> None:
        self.ended.append("node")

    def init(self) -> None:
        pass

    def try_shutdown(self) -> None:
        self.ended.append("ros")


class Status(SimpleNamespace):
    """diagnostic_msgs/DiagnosticStatus."""

    OK, WARN = b"\x00", b"\x01"


def test_the_topics(
    example: ModuleType, simulation: mg.Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ros = Ros({"output": str(tmp_path / "cal.json"), "method": "magyc-ifg"}, messages(simulation))
    for name, content in {
        "rclpy": ros,
        "rclpy.qos": SimpleNamespace(qos_profile_sensor_data=10),
        "sensor_msgs": SimpleNamespace(),
        "sensor_msgs.msg": SimpleNamespace(Imu=object, MagneticField=object),
        "diagnostic_msgs": SimpleNamespace(),
        "diagnostic_msgs.msg": SimpleNamespace(
            DiagnosticArray=lambda status: SimpleNamespace(header=SimpleNamespace(stamp=None), status=status),
            DiagnosticStatus=Status,
            KeyValue=SimpleNamespace,
        ),
        "std_srvs": SimpleNamespace(),
        "std_srvs.srv": SimpleNamespace(Trigger=object),
        "std_msgs": SimpleNamespace(),
        "std_msgs.msg": SimpleNamespace(String=SimpleNamespace),
    }.items():
        monkeypatch.setitem(sys.modules, name, content)
    example.main()
    assert ros.ended == ["node", "ros"]
    statuses = [json.loads(message.data) for message in ros.published["magnetometer_calibration"]]
    assert statuses[-1]["converged"]
    assert not statuses[0]["converged"]
    assert len(ros.published["imu/mag_calibrated"]) > 100
    assert mg.Calibration.load(tmp_path / "cal.json").method == "magyc-ifg"
    levels = [array.status[0].level for array in ros.published["/diagnostics"]]
    assert levels[0] == Status.WARN
    assert levels[-1] == Status.OK
    values = {pair.key: pair.value for pair in ros.published["/diagnostics"][-1].status[0].values}
    assert values["hard iron"].endswith("µT")

    (tmp_path / "cal.json").unlink()
    answer = ros.services["~/save"](None, SimpleNamespace())
    assert answer.success
    assert (tmp_path / "cal.json").exists()
    assert ros.services["~/stop"](None, SimpleNamespace()).message.startswith("stopped: ")
    taken = len(ros.published["imu/mag_calibrated"])
    ros.subscriptions["imu/mag"](messages(simulation)[0][1])  # calibrated, and not learned from
    assert len(ros.published["imu/mag_calibrated"]) == taken + 1
    assert ros.services["~/start"](None, SimpleNamespace()).message == "learning"


def test_the_package_is_what_colcon_expects() -> None:
    """An ament_python package: the names agree, and what setup.py installs is there."""
    root = ElementTree.parse(PACKAGE / "package.xml").getroot()
    name = root.findtext("name")
    assert name == "magyc_gtsam_ros"
    assert root.findtext("export/build_type") == "ament_python"
    assert root.findtext("version") == mg.__version__
    setup = (PACKAGE / "setup.py").read_text(encoding="utf-8")
    assert f'NAME = "{name}"' in setup
    assert f'version="{mg.__version__}"' in setup
    assert (PACKAGE / "resource" / name).exists()
    depends = {element.text for element in root.iter("exec_depend")}
    imported = set(re.findall(r"^ +(?:from|import) (\w+)", EXAMPLE.read_text(encoding="utf-8"), re.MULTILINE))
    assert imported & {"rclpy", "sensor_msgs", "std_msgs", "std_srvs", "diagnostic_msgs"} <= depends
    launch = (PACKAGE / "launch" / "online.launch.py").read_text(encoding="utf-8")
    compile(launch, "online.launch.py", "exec")
    declared = set(re.findall(r'declare_parameter\("(\w+)"', EXAMPLE.read_text(encoding="utf-8")))
    assert all(f'"{parameter}"' in launch for parameter in declared)


def test_the_package_is_valid_and_builds(tmp_path: Path) -> None:
    """By ROS' own parser, and by colcon, which need no ROS for a package in Python."""
    catkin_package = pytest.importorskip("catkin_pkg.package", reason="pip install colcon-common-extensions")
    parsed = catkin_package.parse_package(str(PACKAGE / "package.xml"))
    parsed.validate()
    assert parsed.get_build_type() == "ament_python"
    colcon = shutil.which("colcon")
    if colcon is None:
        pytest.skip("pip install colcon-common-extensions")
    shutil.copytree(PACKAGE, tmp_path / "src" / PACKAGE.name)
    subprocess.run([colcon, "build"], cwd=tmp_path, check=True, capture_output=True, timeout=200)
    installed = tmp_path / "install" / PACKAGE.name
    assert (installed / "lib" / PACKAGE.name / "online").exists()
    assert (installed / "share" / PACKAGE.name / "launch" / "online.launch.py").exists()
