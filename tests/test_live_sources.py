"""Samples from sockets, a serial port, MAVLink and ROS 2: the end is that of `online` on the same samples in a file."""

from __future__ import annotations

import json
import logging
import os
import pty
import socket
import sys
import termios
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sending import free_port, listened_to, rows, taken_in

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.address import open_source
from magyc_gtsam.live.arrival import ArrivalClock
from magyc_gtsam.live.health import StreamMonitor
from magyc_gtsam.live.source import LiveSource, NewSamples
from magyc_gtsam.recording import Samples
from magyc_gtsam.simulation import simulate

IFG = ("--method", "magyc-ifg", "--option", "estimate=current")  # quick, and bit for bit
RAW = 0.1e-6, np.pi / 180 / 16  # T and rad/s per count of MotionCal's lines


@pytest.fixture(scope="module")
def recording() -> mg.Recording:
    return simulate("wide", duration=90, rate=20, seed=1).recording


@pytest.fixture
def online(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[Callable[..., tuple[mg.Calibration, dict[str, Any]]]]:
    """The command in this process, while a thread sends: the calibration, and the last line of JSON."""
    monkeypatch.chdir(tmp_path)

    def call(
        source: str, send: Callable[[], None], *arguments: str, idle: str = "1"
    ) -> tuple[mg.Calibration, dict[str, Any]]:
        sender = threading.Thread(target=send)
        sender.start()
        code = cli.main(["online", source, *IFG, "--json", "--idle", idle, "--every", "1e9", *arguments])
        sender.join()
        output = capsys.readouterr()
        assert code in (0, 1), output.err
        return mg.Calibration.load("online-calibration.yaml"), json.loads(output.out.splitlines()[-1])

    with warnings.catch_warnings():
        yield call
    logging.disable(logging.NOTSET)


def direct(samples: list[dict[str, Any]]) -> mg.Calibration:
    """What Python gives on the same samples."""
    found = mg.OnlineCalibrator("magyc-ifg", estimate="current")
    columns = (np.array([row[name] for row in samples]) for name in ("time", "magnetic_field", "angular_rate"))
    found.update(*columns)
    assert found.calibration is not None
    return found.calibration


def same(found: mg.Calibration, expected: mg.Calibration) -> None:
    for name in ("soft_iron", "hard_iron", "gyro_bias"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_datagrams(recording: mg.Recording, online: Any) -> None:
    """With one that is no JSON and one that is lost on the way."""
    port, sent = free_port(), rows(recording)

    def send() -> None:
        listened_to(port)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for number, row in enumerate(sent):
                if number != 400:
                    sender.sendto(json.dumps(row).encode(), ("127.0.0.1", port))
                if number == 700:
                    sender.sendto(b"\xff{", ("127.0.0.1", port))
                if number % 50 == 0:
                    taken_in(port)

    found, last = online(f"udp://:{port}", send)
    same(found, direct(sent[:400] + sent[401:]))
    source = last["source"]
    assert source["taken"] == 2 * (len(sent) - 1)
    assert source["missing"] == 2
    assert source["refused"] == 1
    assert last["end"] == "no new data"


def test_a_second_sender_is_not_listened_to() -> None:
    source = open_source("udp://127.0.0.1:0", Request())
    line = b'{"time": 1, "magnetic_field": [1e-5, 2e-5, 3e-5]}'
    for number in (1, 2):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            try:
                sender.bind((f"127.0.0.{number}", 0))
            except OSError:
                pytest.skip("this machine has only one loopback address")
            sender.sendto(line, ("127.0.0.1", source.port))  # type: ignore[attr-defined]
    assert len(source.read(1.0).magnetometer.time) == 1
    assert "datagrams from 127.0.0.2 are ignored" in source.notes[0]
    source.close()


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """The one end of a pair of pseudo terminals, and the name of the other."""
    ours, theirs = pty.openpty()
    yield ours, os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def test_json_through_a_serial_port(recording: mg.Recording, online: Any, terminal: tuple[int, str]) -> None:
    pytest.importorskip("serial")
    ours, port = terminal
    sent = rows(recording)

    def send() -> None:
        until = time.monotonic() + 60
        while termios.tcgetattr(ours)[3] & termios.ECHO and time.monotonic() < until:
            time.sleep(0.05)  # not opened yet
        time.sleep(0.1)
        os.write(ours, b"09, 0.1]}\n")  # what it was in the middle of
        for row in sent:
            os.write(ours, json.dumps(row).encode() + b"\r\n")

    found, last = online(f"serial://{port}?baud=921600", send)
    same(found, direct(sent))
    assert last["source"]["refused"] == 0


def test_lines_of_motioncal_are_stamped_as_they_come(terminal: tuple[int, str]) -> None:
    """In counts of 0.1 µT and 1/16 °/s, unless another unit is named; one that is cut is left out."""
    pytest.importorskip("serial")
    ours, port = terminal
    source = open_source(f"serial://{port}", Request())
    counts = np.random.default_rng(0).integers(-900, 900, (40, 9))
    before, batches = time.time(), []
    for row in counts:
        os.write(ours, b"Raw:" + b",".join(b"%d" % n for n in row) + b"\r\n")
        batches.append(source.read(0.5))
    os.write(ours, b"Raw:1,2,3\r\n")
    assert not source.read(0.5)
    magnetometer = np.vstack([batch.magnetometer.value for batch in batches])
    gyroscope = np.vstack([batch.gyroscope.value for batch in batches])
    np.testing.assert_allclose(magnetometer, counts[:, 6:] * RAW[0], rtol=1e-12)
    np.testing.assert_allclose(gyroscope, counts[:, 3:6] * RAW[1], rtol=1e-12)
    stamps = np.concatenate([batch.magnetometer.time for batch in batches])
    assert (np.diff(stamps) > 0).all()
    assert before - 0.01 < stamps[0]
    assert stamps[-1] < time.time() + 1.0
    assert source.lost == 1
    assert "expected nine whole numbers" in source.notes[-1]
    source.close()


def test_a_port_that_is_unplugged_and_one_that_is_not_there() -> None:
    pytest.importorskip("serial")
    ours, theirs = pty.openpty()
    source = open_source(f"serial://{os.ttyname(theirs)}", Request())
    os.close(ours)
    with pytest.raises(mg.MagycError, match="the port is lost .* start again"):
        source.read(0.1)
    source.close()
    os.close(theirs)
    with pytest.raises(mg.MagycError, match="cannot be opened at 9600 baud"):
        open_source("serial:///dev/no-such-port?baud=9600", Request())


def autopilot(port: int) -> Any:
    """The sending end of a MAVLink connection over loopback."""
    mavutil = pytest.importorskip("pymavlink.mavutil")
    return mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=7, dialect="ardupilotmega")


def test_an_autopilot(recording: mg.Recording, online: Any) -> None:
    """HIGHRES_IMU in gauss, beside messages that are not wanted; one is lost, and the sequence numbers show it."""
    port = free_port()
    vehicle = autopilot(port)
    assert recording.angular_rate is not None
    stamps = np.round(recording.time * 1e6).astype(np.int64) + 5_000_000
    field = (recording.magnetic_field * 1e4).astype(np.float32)
    rate = recording.angular_rate.astype(np.float32)
    kept = [k for k in range(len(stamps)) if k != 300]

    def send() -> None:
        listened_to(port)
        for k, stamp in enumerate(stamps.tolist()):
            m, w = field[k].tolist(), rate[k].tolist()
            if k == 300:
                vehicle.mav.seq = (vehicle.mav.seq + 1) % 256
                continue
            vehicle.mav.scaled_imu_send(stamp // 1000, 0, 0, 981, 1, 2, 3, 100, 200, 300)
            vehicle.mav.highres_imu_send(stamp, 0, 0, 9.8, *w, *m, 1013, 0, 0, 20, 0x1FF)
            if k % 20 == 0:
                taken_in(port)

    found, last = online(f"mavlink://udpin:127.0.0.1:{port}", send, idle="1.5")
    sent = [
        {"time": stamps[k] * 1_000 / 1e9, "magnetic_field": m * 1e-4, "angular_rate": w * 1.0}
        for k, m, w in zip(kept, field[kept].astype(float), rate[kept].astype(float), strict=True)
    ]
    same(found, direct(sent))
    assert last["source"]["refused"] == 1
    assert last["source"]["missing"] == 2
    vehicle.close()


def read_until(source: LiveSource, count: int) -> NewSamples:
    batches: list[NewSamples] = []
    until = time.monotonic() + 60
    while sum(len(batch.magnetometer.time) for batch in batches) < count:
        batches.append(source.read(0.05))
        assert time.monotonic() < until, source.waiting_for
    parts = [[batch[i] for batch in batches] for i in range(2)]
    return NewSamples(
        *(Samples(np.concatenate([p.time for p in part]), np.vstack([p.value for p in part])) for part in parts)
    )


def test_an_autopilot_without_a_clock_and_how_long_a_message_takes() -> None:
    """RAW_IMU in milligauss and mrad/s; zeros for the time: the times of arrival. TIMESYNC is answered."""
    port = free_port()
    vehicle = autopilot(port)
    source = open_source(f"mavlink://udpin:127.0.0.1:{port}", Request(sensors={"magnetic_field": "RAW_IMU"}))
    assert "none of RAW_IMU with both sensors yet; heard so far: nothing" in source.waiting_for
    stop = threading.Event()

    def send() -> None:
        while not stop.is_set():
            vehicle.mav.raw_imu_send(0, 0, 0, 981, 10, -20, 30, 100, -200, 300)
            time.sleep(0.02)
            while (message := vehicle.recv_msg()) is not None:
                if message.get_type() == "TIMESYNC":
                    vehicle.mav.timesync_send(time.monotonic_ns(), message.ts1)

    sender = threading.Thread(target=send)
    sender.start()
    try:
        source.read(5.0)
        assert "heard so far: RAW_IMU" in source.waiting_for  # also of an autopilot that sends no HEARTBEAT
        batch = read_until(source, 100)
    finally:
        stop.set()
        sender.join()
    np.testing.assert_allclose(batch.magnetometer.value[0], [1e-5, -2e-5, 3e-5], rtol=1e-12)
    np.testing.assert_allclose(batch.gyroscope.value[0], [0.01, -0.02, 0.03], rtol=1e-12)
    assert (np.diff(batch.magnetometer.time) > 0).all()
    assert abs(batch.magnetometer.time[-1] - time.time()) < 5
    assert any("has no stamps" in note for note in source.notes)
    assert source.round_trip is not None  # type: ignore[attr-defined]
    assert 0 <= source.round_trip < 5  # type: ignore[attr-defined]
    source.close()
    vehicle.close()


def test_topics_of_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a stand-in for rclpy that has as much of it as is touched."""
    subscribed: dict[str, Callable[[Any], None]] = {}
    played: list[tuple[str, Any]] = []
    topics = [("/mag", ["sensor_msgs/msg/MagneticField"]), ("/imu", ["sensor_msgs/msg/Imu"])]

    def subscribe(kind: Any, topic: str, callback: Callable[[Any], None], quality: Any) -> None:
        subscribed[topic] = callback

    def spin_once(timeout_sec: float) -> None:
        if played:
            topic, message = played.pop(0)
            subscribed[topic](message)

    node = SimpleNamespace(
        get_topic_names_and_types=lambda: topics, create_subscription=subscribe, destroy_node=lambda: None
    )
    executor = SimpleNamespace(add_node=lambda node: None, spin_once=spin_once, shutdown=lambda: None)
    executors = SimpleNamespace(SingleThreadedExecutor=lambda context: executor)
    rclpy = SimpleNamespace(
        Context=object, init=lambda context: None, create_node=lambda name, context: node, executors=executors,
        shutdown=lambda context: None,
    )  # fmt: skip
    for name, content in {
        "rclpy": rclpy, "rclpy.executors": executors, "rclpy.qos": SimpleNamespace(qos_profile_sensor_data=10),
        "sensor_msgs": SimpleNamespace(), "sensor_msgs.msg": SimpleNamespace(Imu=object, MagneticField=object),
    }.items():  # fmt: skip
        monkeypatch.setitem(sys.modules, name, content)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=5, nanosec=250_000_000))
    vector = SimpleNamespace(x=10.0, y=20.0, z=30.0)
    covariance = [0.0] * 9
    played += [
        ("/mag", SimpleNamespace(header=header, magnetic_field=vector)),
        ("/imu", SimpleNamespace(header=header, angular_velocity=vector, angular_velocity_covariance=[-1.0] * 9)),
        ("/imu", SimpleNamespace(header=header, angular_velocity=vector, angular_velocity_covariance=covariance)),
    ]
    source = open_source("ros2://", Request(units={"magnetic_field": "uT"}))
    first, second = source.read(0.01), source.read(0.05)
    assert first.magnetometer.time.tolist() == [5.25]
    np.testing.assert_allclose(first.magnetometer.value, [[1e-5, 2e-5, 3e-5]])
    assert second.gyroscope.value.tolist() == [[10.0, 20.0, 30.0]]
    assert (source.lost, source.waiting_for) == (1, "")
    source.close()
    topics.append(("/mag2", ["sensor_msgs/msg/MagneticField"]))
    with pytest.raises(mg.MagycError, match="/mag, /mag2 could be the magnetic_field"):
        open_source("ros2://", Request()).read(0.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("udp://:99999", "expected a whole number from 0 to 65535"),
        ("udp://:", "expected a whole number"),
        ("udp://203.0.113.1:14560", "cannot be listened on"),
        ("ftp://host:21", "unknown kind of source"),
        ("serial:///dev/ttyUSB0?speed=9600", "unknown kind of source"),
        ("mavlink:///etc/passwd", "write it as mavlink://udpin"),
        ("mavlink://udpin:127.0.0.1:14550?baud=fast", "expected a whole number"),
        ("ros2://", "needs rclpy"),
    ],
)
def test_what_is_no_source(text: str, message: str) -> None:
    with pytest.raises(mg.MagycError, match=message):
        open_source(text, Request())


def test_stamps_of_arrival_are_evened_out_and_pauses_kept() -> None:
    sampled = np.concatenate([np.arange(2000) / 100, 60 + np.arange(2000) / 100])
    arrived = np.ceil(sampled / 0.016) * 0.016
    clock = ArrivalClock(now=lambda: 0.0)
    stamps = np.array([clock(t) for t in arrived.tolist()])
    assert (np.diff(stamps) > 0).all()
    for part in (slice(500, 2000), slice(2500, 4000)):
        assert np.std(stamps[part] - sampled[part]) < 1e-4 < np.std(arrived[part] - sampled[part])
    assert abs(stamps[-1] - sampled[-1]) < 0.02


def test_wrong_stamps_lose_and_delay_nothing() -> None:
    monitor = StreamMonitor()
    for k in range(3000):
        stamp = {1000: 0.0, 1500: 1e12}.get(k, 1.7e9 + k / 20)
        one = Samples(np.array([stamp]), np.zeros((1, 3)))
        monitor.take(NewSamples(one, one), k / 20)
        health = monitor.health
        assert health.missing == 0
        assert health.late < 1e-3
        if k >= 100:
            assert health.rate == pytest.approx((20, 20), rel=0.03)


def test_rate_losses_and_delay() -> None:
    """100 Hz and 200 Hz for a minute, 5 % of the magnetometer lost, the last seconds 80 ms later than before."""
    monitor, random = StreamMonitor(), np.random.default_rng(1)
    field = np.arange(6000) / 100
    field = field[(random.random(6000) > 0.05) | (np.arange(6000) % 5999 == 0)]
    rate = np.arange(12000) / 200
    for second in np.arange(0, 60, 0.1):
        parts = [t[(t >= second - 1e-9) & (t < second + 0.1 - 1e-9)] for t in (field, rate)]
        batch = NewSamples(*(Samples(t, np.zeros((len(t), 3))) for t in parts))
        monitor.take(batch, 1000 + second + 0.1 + 0.08 * (second > 57), round_trip=0.01)
    health = monitor.health
    once = StreamMonitor()  # a file that is complete arrives at once
    once.take(NewSamples(*(Samples(t, np.zeros((len(t), 3))) for t in (field, rate))), 1000.0)
    assert once.health.rate == pytest.approx((len(field) / 60, 200), rel=1e-3)
    assert health.rate[0] == pytest.approx(95, abs=4)
    assert health.rate[1] == pytest.approx(200, abs=1)
    assert (
        6000 - len(field) - 3 <= health.missing <= 6000 - len(field)
    )  # those before the period is known are not seen
    assert health.late == pytest.approx(0.08, abs=0.02)
    assert "link 5.0 ms" in health.sentence


def test_a_closed_standard_input_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its number may belong to another file by then."""
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(mg.MagycError, match="standard input: is closed; pipe lines of JSON into it"):
        open_source("-", Request())
