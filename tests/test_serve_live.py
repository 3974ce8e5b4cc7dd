"""Live in a browser's server: over UDP, frozen and gone on with, killed in the middle; the end is that of Python."""

from __future__ import annotations

import json
import os
import pty
import signal
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sending import free_port, listened_to, rows, send_lines, taken_in
from served import DIVE, PATIENCE, Served

import magyc_gtsam as mg

pytest.importorskip("starlette", reason="pip install 'magyc-gtsam[serve]'")
pytest.importorskip("uvicorn", reason="pip install 'magyc-gtsam[serve]'")


@pytest.fixture(scope="module")
def lines() -> list[dict[str, Any]]:
    """Four minutes of a dive, after which it has converged."""
    return rows(mg.read(DIVE, end=240.0))


@pytest.fixture(scope="module")
def expected(lines: list[dict[str, Any]]) -> mg.Calibration:
    """What Python gives on the same samples in one block."""
    online = mg.OnlineCalibrator()
    online.update(
        *(np.array([line[name] for line in lines]) for name in ("time", "magnetic_field", "angular_rate"))
    )
    assert online.converged
    assert online.calibration is not None
    return online.calibration


def same(path: Path, expected: mg.Calibration) -> None:
    found = mg.Calibration.load(path)
    for name in ("soft_iron", "hard_iron", "gyro_bias", "covariance"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def until(server: Served, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The live run, when the condition holds."""
    limit = time.monotonic() + PATIENCE
    while time.monotonic() < limit:
        run = server.ask("GET", "/api/state")[1]["live"]
        if condition(run):
            return dict(run)
        time.sleep(0.05)
    raise AssertionError(run)


def has(seconds: float) -> Callable[[dict[str, Any]], bool]:
    """A run that has taken so much of the log."""
    return lambda run: bool(run["latest"]) and run["latest"]["duration"] >= seconds


def test_a_server_that_is_killed_in_the_middle(
    tmp_path: Path, lines: list[dict[str, Any]], expected: mg.Calibration
) -> None:
    """The next one finds the run and goes on, bit for bit; what was sent while nobody listened is all that is lost."""
    port = free_port()
    server = Served(tmp_path)
    source = {"kind": "udp", "port": port}
    assert server.ask("POST", "/api/live", {"do": "start", "source": source})[0] == 200
    listened_to(port)
    send_lines(port, lines[:1000])
    until(server, has(99.0))
    assert server.ask("POST", "/api/live", {"do": "start", "source": source})[0] == 400, "one at a time"
    server.stop(signal.SIGKILL)
    listened_to(port, by=False)

    server = Served(tmp_path)
    try:
        assert until(server, lambda run: True)["state"] == "frozen"
        run = server.ask("POST", "/api/live", {"do": "go on"})[1]
        listened_to(port)
        send_lines(port, lines[1000:1500])
        until(server, has(149.0))
        assert server.ask("POST", "/api/live", {"do": "freeze"})[1]["state"] == "frozen"
        server.ask("POST", "/api/live", {"do": "go on"})
        listened_to(port)
        send_lines(port, lines[1500:])
        last = until(
            server,
            lambda run: has(239.0)(run) and run["latest"]["duration"] >= lines[-1]["time"] - lines[0]["time"],
        )
        assert last["latest"]["picture"]["next"]
        server.ask("POST", "/api/live", {"do": "freeze"})
        same(tmp_path / "results" / run["result"] / "online-calibration.yaml", expected)
        found = server.ask("GET", f"/api/results/{run['result']}")[1]
        assert (found["kind"], found["trusted"]) == ("live", True)
        texts = {each["name"]: each["text"] for each in found["exports"]}
        assert texts["PX4"] == expected.export("px4")
    finally:
        assert "Traceback" not in server.stop()


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"do": "start", "source": {"kind": "file", "log": "/etc/passwd"}}, "MCAP file of the folder"),
        ({"do": "start", "source": {"kind": "serial", "port": "/dev/sda", "baud": 9600}}, "no such serial port"),
        ({"do": "start", "source": {"kind": "mavlink", "address": "/etc/passwd"}}, "must be"),
        ({"do": "start", "source": {"kind": "mavlink", "address": "tcp:a b:1"}}, "must be"),
        ({"do": "start", "source": {"kind": "udp", "port": 22}}, "1024 to 65535"),
        ({"do": "start", "source": {"kind": "udp", "port": "14560 --force"}}, "1024 to 65535"),
        ({"do": "start", "source": "-"}, "must be"),
        ({"do": "start", "source": {"kind": "udp", "port": 14999}, "reading": {"state": "/tmp/x"}}, "reading"),
        ({"do": "go on"}, "no live run to resume"),
        ({"do": "rm"}, "must be"),
        ([], "must be"),
    ],
)
def test_sources_that_are_refused(idle: Served, asked: Any, says: str) -> None:
    status, answer, _ = idle.ask("POST", "/api/live", asked)
    assert status == 400
    assert says in answer["problem"]
    assert idle.ask("POST", "/api/live", asked, origin="https://evil.example")[0] == 403
    assert not (idle.folder / "results").exists()


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Any:
    server = Served(tmp_path_factory.mktemp("idle"))
    yield server
    server.stop()


def test_a_port_that_another_program_has(tmp_path: Path) -> None:
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        server = Served(tmp_path)
        try:
            server.ask("POST", "/api/live", {"do": "start", "source": {"kind": "udp", "port": port}})
            run = until(server, lambda run: run["state"] == "failed")
            assert "cannot be listened on" in run["messages"][-1]
        finally:
            server.stop()


def test_in_a_browser_with_a_reload_in_the_middle(
    live_page: tuple[Any, Served], lines: list[dict[str, Any]], expected: mg.Calibration
) -> None:
    """The sphere fills, the verdict changes, a reload loses nothing, and what is copied is what Python exports."""
    (page, server), port = live_page, free_port()
    page.locator("#udp-port").fill(str(port))
    page.locator("#begin").click()
    page.locator("#live-verdict h1", has_text="Waiting for samples").wait_for()
    listened_to(port)
    send_lines(port, lines[:600])
    page.locator("#live-verdict.bad", has_text="Not yet").wait_for()
    page.locator("#map .seen").nth(3).wait_for()
    assert (
        page.locator("#vehicle svg").get_attribute("aria-label")
        in page.locator("#move .worth").text_content().lower()
    )
    page.reload()
    page.locator("#live-verdict.bad", has_text="Not yet").wait_for()
    send_lines(port, lines[600:])
    page.locator("#live-verdict.good").wait_for()
    assert page.evaluate("felt") == 1
    page.reload()
    page.locator("#live-verdict.good").wait_for()
    assert page.evaluate("felt") == 0, "nothing has changed"
    page.locator("#residual", has_text="Undisturbed").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    duration = lines[-1]["time"] - lines[0]["time"]
    until(server, has(duration))
    page.locator("#freeze").click()
    page.locator("#live-verdict.good p", has_text="Continue to add them.").wait_for()
    page.locator("#live-result").click()
    page.locator("#result header.good").wait_for()
    page.locator(".export", has_text="PX4").locator("button").click()
    page.locator(".export button", has_text="Copied").wait_for()
    assert page.evaluate("navigator.clipboard.readText()") == expected.export("px4")
    same(calibration_of(server), expected)

    page.locator("#continue").click()
    listened_to(port)
    # A sensor that was switched off counts from its start again.
    again = [{**line, "magnetic_field": [value + 5e-6 for value in line["magnetic_field"]]} for line in lines]
    send_lines(port, again[:50])
    page.locator("#live-verdict.bad p", has_text="none of the 100 samples is used").wait_for()
    assert "begin a new run (Freeze, then New run)" in page.locator("#live-verdict").text_content()


def test_a_tap_before_the_first_state_has_arrived(idle: Served, new_page: Callable[..., Any]) -> None:
    """The panel that was tapped stays."""
    page = new_page(400)
    page.set_default_timeout(1e3 * PATIENCE)
    held: list[Any] = []
    page.route("**/api/state", lambda route: held.append(route))
    with page.expect_request("**/api/state"):
        page.goto(idle.address)
    page.locator("[data-tab=live]").click()
    with page.expect_websocket():  # the last thing that the page does to begin
        held.pop().continue_()
    assert page.locator("#begin").is_visible()


def live_panel(server: Served, page: Any) -> Any:
    """The live panel of a server's page."""
    page.set_default_timeout(1e3 * PATIENCE)
    page.goto(server.address)
    page.locator("[data-tab=live]").click()
    return page


@pytest.fixture(scope="module")
def live_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    server = Served(tmp_path_factory.mktemp("live"))
    yield server
    assert "Traceback" not in server.stop()


@pytest.fixture
def live_page(live_server: Served, new_page: Callable[..., Any]) -> tuple[Any, Served]:
    """The live panel of a server, before a new run."""
    page = new_page(400)
    page.add_init_script("felt = 0; navigator.vibrate = () => { felt += 1; };")
    live_panel(live_server, page)
    if live_server.ask("POST", "/api/live", {"do": "freeze"})[1]["state"] != "none":
        page.locator("#another").click()
    return page, live_server


def frozen_result(page: Any, server: Served, duration: float) -> Path:
    """The calibration of the run on the page, once it has all samples and was frozen."""
    until(server, has(duration))
    page.locator("#freeze").click()
    page.locator("#live-result").wait_for()
    return calibration_of(server)


def calibration_of(server: Served) -> Path:
    """The file of the live run."""
    result = server.ask("GET", "/api/state")[1]["live"]["result"]
    return server.folder / "results" / result / "online-calibration.yaml"


@pytest.mark.skipif(not Path("/proc/tty/drivers").exists(), reason="ports that are not listed are told by Linux")
def test_a_serial_port_that_is_named_by_hand(
    live_page: tuple[Any, Served], lines: list[dict[str, Any]], expected: mg.Calibration
) -> None:
    """A pseudo terminal, which no list of ports has: at the end what Python gives on the same samples."""
    pytest.importorskip("serial")
    page, server = live_page
    ours, theirs = pty.openpty()
    try:
        page.locator("[data-kind=serial]").click()
        page.locator("#serial-port").fill(os.ttyname(theirs))
        page.locator("#baud").select_option("921600")
        page.locator("#begin").click()
        page.locator("#live-verdict h1", has_text="Waiting for samples").wait_for()
        limit = time.monotonic() + PATIENCE
        while termios.tcgetattr(ours)[3] & termios.ECHO and time.monotonic() < limit:
            time.sleep(0.02)  # not opened yet
        time.sleep(0.1)
        for line in lines:
            os.write(ours, json.dumps(line).encode() + b"\r\n")
        page.locator("#live-verdict.good").wait_for()
        same(frozen_result(page, server, lines[-1]["time"] - lines[0]["time"]), expected)
    finally:
        os.close(ours)
        os.close(theirs)


def test_a_port_is_not_chosen_while_another_is_typed(idle: Served, new_page: Callable[..., Any]) -> None:
    """The list of ports may come late; it fills in a field that nobody is in."""
    page = live_panel(idle, new_page(400))
    held: list[Any] = []
    page.route("**/api/ports", lambda route: held.append(route))
    for focused, value in ((False, "/dev/ttyS0"), (True, "")):
        page.locator("[data-kind=mavlink]").click()
        with page.expect_request("**/api/ports"):
            page.locator("[data-kind=serial]").click()
        page.locator("#serial-port").fill("")
        page.locator("#serial-port" if focused else "#baud").focus()
        page.locator("#ports").evaluate("list => list.replaceChildren()")
        held.pop().fulfill(json={"ports": ["/dev/ttyS0"]})
        page.locator("#ports option").wait_for(state="attached")
        assert page.locator("#serial-port").input_value() == value


def test_an_autopilot_over_mavlink(live_page: tuple[Any, Served], lines: list[dict[str, Any]]) -> None:
    """HIGHRES_IMU over loopback, to the last digit what Python gives on the values of the messages."""
    mavutil = pytest.importorskip("pymavlink.mavutil")
    page, server = live_page
    port = free_port()
    page.locator("[data-kind=mavlink]").click()
    page.locator("#mavlink-address").fill(f"udpin:127.0.0.1:{port}")
    page.locator("#begin").click()
    listened_to(port)
    vehicle = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=7, dialect="ardupilotmega")
    time_us, field, rate = [], [], []
    for number, line in enumerate(lines):
        time_us.append(5_000_000 + round((line["time"] - lines[0]["time"]) * 1e6))
        field.append(np.float32(np.array(line["magnetic_field"]) * 1e4))
        rate.append(np.float32(line["angular_rate"]))
        m, w = field[-1].tolist(), rate[-1].tolist()
        vehicle.mav.highres_imu_send(time_us[-1], 0, 0, 9.8, *w, *m, 1013, 0, 0, 20, 0x1FF)
        if number % 20 == 0:
            taken_in(port)
    page.locator("#live-verdict.good").wait_for()
    file = frozen_result(page, server, (time_us[-1] - time_us[0]) / 1e6)
    vehicle.close()
    online = mg.OnlineCalibrator()
    stamps = np.array(time_us) * 1_000 / 1e9
    online.update(stamps, np.float64(field) * 1e-4, np.float64(rate))
    assert online.calibration is not None
    same(file, online.calibration)


@pytest.mark.skipif(not Path("/proc/tty/drivers").exists(), reason="ports that are not listed are told by Linux")
def test_devices_that_are_no_serial_lines_are_refused(idle: Served) -> None:
    """Nor is somebody's terminal, whose keys would be read."""
    pytest.importorskip("serial")
    child, ours = pty.fork()
    if child == 0:
        time.sleep(PATIENCE)
        os._exit(0)
    try:
        terminal = os.readlink(f"/proc/{child}/fd/0")
        names = ["/dev/tty", "/dev/zero", "/dev/../etc/passwd", "/dev/pts/../zero", "/dev/ptmx", terminal]
        for name in names:
            for kind in ("serial", "mavlink"):
                source = {"kind": kind, "port": name, "baud": 9600}
                status, answer, _ = idle.ask("POST", "/api/live", {"do": "start", "source": source})
                assert (status, "no such serial port" in answer["problem"]) == (400, True), name
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(ours)
