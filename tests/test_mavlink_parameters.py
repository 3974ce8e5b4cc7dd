"""Parameters written to a vehicle over MAVLink: only what a person agreed to, and compared with what is read back."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run
from sending import free_port

import magyc_gtsam as mg
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.live.mavlink_parameters import settings_of

mavutil = pytest.importorskip("pymavlink.mavutil")

COVARIANCE = np.diag([*[1e-6] * 6, *[1e-14] * 3, *[1e-8] * 3])
MOTOR = Term("motor-current", [3e-8, -5e-8, 8e-8], np.eye(3) * 1e-18, {"reference_0": 12.0})


class Vehicle(threading.Thread):
    """An autopilot on loopback with parameters: {name: value}; those of `deaf` are never taken."""

    def __init__(
        self, port: int, target: str, known: dict[str, float], deaf: tuple[str, ...], armed: bool
    ) -> None:
        super().__init__(daemon=True)
        self.known, self.deaf, self.target = known, deaf, target
        self.link: Any = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port}", source_system=3, source_component=1
        )
        self.heartbeat = (2, 12 if target == "px4" else 3, 128 if armed else 0, 0, 3)
        self.set: list[str] = []
        self.over = threading.Event()

    def run(self) -> None:
        beat = 0.0
        while not self.over.is_set():
            if time.monotonic() - beat > 0.1:
                beat = time.monotonic()
                self.link.mav.heartbeat_send(*self.heartbeat)
            try:
                message = self.link.recv_match(blocking=True, timeout=0.05)
            except OSError:  # nobody listens yet
                continue
            kind = message.get_type() if message is not None else ""
            if kind == "PARAM_SET":
                self.set.append(message.param_id)
                if message.param_id not in self.deaf:
                    self.known[message.param_id] = self.decoded(message)
            if kind in ("PARAM_SET", "PARAM_REQUEST_READ") and message.param_id in self.known:
                self.say(message.param_id)

    def decoded(self, message: Any) -> float:
        if self.target == "px4" and message.param_type == 6:
            return float(struct.unpack("<i", struct.pack("<f", message.param_value))[0])
        return float(message.param_value)

    def say(self, name: str) -> None:
        value, whole = self.known[name], name.endswith(("_TYP", "MOTCT"))
        sent = struct.unpack("<f", struct.pack("<i", int(value)))[0] if whole and self.target == "px4" else value
        self.link.mav.param_value_send(name.encode(), sent, 6 if whole else 9, len(self.known), 0)


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    mg.Calibration(
        np.diag([1.02, 0.97, 1.01]), [3e-5, -2e-5, 1e-5], [1e-3, 2e-3, -1e-3], COVARIANCE, terms=(MOTOR,)
    ).save(tmp_path / "a.yaml")
    return tmp_path / "a.yaml"


Write = Callable[..., tuple[int, str, str, Vehicle]]


@pytest.fixture
def write(calibration: Path) -> Iterator[Write]:
    started = []

    def call(
        target: str, answer: str, deaf: tuple[str, ...] = (), armed: bool = False, autopilot: str = ""
    ) -> tuple[int, str, str, Vehicle]:
        port = free_port()
        settings = settings_of(mg.Calibration.load(calibration).export(target), target)
        vehicle = Vehicle(port, autopilot or target, {s.name: 0.0 for s in settings}, deaf, armed)
        started.append(vehicle)
        vehicle.start()
        command = ("export", calibration, target, "--write", f"mavlink://udpin:127.0.0.1:{port}")
        ended = run(*command, cwd=calibration.parent, stdin=answer)
        return ended.returncode, ended.stdout, ended.stderr, vehicle

    yield call
    for vehicle in started:
        vehicle.over.set()
        vehicle.join()
        vehicle.link.close()


@pytest.mark.parametrize("target", ["ardupilot", "px4"])
def test_what_was_agreed_to_is_written_and_read_back(write: Write, calibration: Path, target: str) -> None:
    code, output, error, vehicle = write(target, "y\n")
    assert (code, error) == (0, "")
    expected = settings_of(mg.Calibration.load(calibration).export(target), target)
    assert {s.name for s in expected} == set(vehicle.set)
    for setting in expected:
        assert setting.name in output
        assert np.float32(vehicle.known[setting.name]) == np.float32(setting.value), setting.name
    assert f"{len(expected)} parameters written and confirmed" in output


@pytest.mark.parametrize("answer", ["n\n", ""])
def test_without_a_yes_nothing_is_written(write: Write, answer: str) -> None:
    code, output, _, vehicle = write("ardupilot", answer)
    assert code == 1
    assert "nothing was written" in output
    assert vehicle.set == []


def test_a_parameter_that_is_not_taken_is_named(write: Write) -> None:
    code, _, error, _ = write("ardupilot", "y\n", deaf=("COMPASS_DIA_Y",))
    assert code == 1
    assert "1 of " in error
    assert "(COMPASS_DIA_Y)" in error


@pytest.mark.parametrize(
    ("more", "says"), [({"armed": True}, "armed"), ({"autopilot": "px4"}, "the vehicle does not run ardupilot")]
)
def test_an_armed_vehicle_and_another_autopilot_are_left_alone(
    write: Write, more: dict[str, Any], says: str
) -> None:
    code, _, error, vehicle = write("ardupilot", "y\n", **more)
    assert code == 2
    assert says in error
    assert vehicle.set == []


def test_an_untrusted_calibration_is_never_written(calibration: Path) -> None:
    mg.Calibration(np.eye(3), np.zeros(3), converged=False, message="no luck").save(calibration)
    command = ("export", calibration, "px4", "--write", "mavlink://udpin:127.0.0.1:9", "--force")
    ended = run(*command, cwd=calibration.parent, stdin="y\n")
    assert ended.returncode == 1
    assert "must not be trusted" in ended.stderr
