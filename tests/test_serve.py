"""`magyc-gtsam serve` without a browser: what it refuses, and jobs that are the command line."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import socket
import struct
import sys
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run
from served import DIVE, PATIENCE, Served

import magyc_gtsam as mg
from magyc_gtsam.serve.limits import Limits
from magyc_gtsam.serve.store import Store, safe_name

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import fuzz_files

pytest.importorskip("starlette", reason="pip install 'magyc-gtsam[serve]'")
pytest.importorskip("uvicorn", reason="pip install 'magyc-gtsam[serve]'")


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("served")
    shutil.copy(DIVE, folder)
    server = Served(folder, "--most", "0.01")
    yield server
    assert "Traceback" not in server.stop()


def log(served: Served, name: str = DIVE.name) -> str:
    return next(each["key"] for each in served.ask("GET", "/api/state")[1]["logs"] if each["name"] == name)


def test_a_job_is_the_command_line(served: Served, tmp_path: Path) -> None:
    """To the last byte of the calibration and of what is to be pasted; with an interval, and listed afterwards."""
    asked = {"kind": "calibrate", "logs": [log(served)], "start": 60.0, "end": 480.5}
    status, job, _ = served.ask("POST", "/api/jobs", asked)
    assert status == 201
    job = served.ended(job["key"])
    assert (job["state"], job["code"]) == ("done", 0), job
    assert run("calibrate", DIVE, "--start", 60, "--end", 480.5, "-o", "own", "-q", cwd=tmp_path).returncode == 0
    folder = served.folder / "results" / job["result"]
    for name in ("calibration.yaml", "px4.params", "ardupilot.param", "vectornav.txt", "ros.yaml"):
        assert (folder / name).read_bytes() == (tmp_path / "own" / name).read_bytes(), name
    listed = served.ask("GET", "/api/state")[1]["results"]
    (mine,) = [each for each in listed if each["key"] == job["result"]]
    assert (mine["trusted"], mine["kind"], mine["interval"]) == (True, "calibrate", [60.0, 480.5])
    assert "heading error" in mine["sentence"]
    details = served.ask("GET", f"/api/results/{job['result']}")[1]
    assert [each["name"] for each in details["exports"]] == [
        "PX4",
        "ArduPilot",
        "VectorNav",
        "ROS",
        "calibration.yaml",
    ]
    status, text, headers = served.ask("GET", f"/results/{job['result']}/px4.params")
    assert text == (folder / "px4.params").read_bytes()
    assert headers["content-disposition"].startswith("attachment")
    status, page, headers = served.ask("GET", f"/results/{job['result']}/report.html")
    assert b"<h1>" in page
    assert "sandbox allow-scripts" in headers["content-security-policy"]
    assert "allow-same-origin" not in headers["content-security-policy"]


def test_an_untrusted_result_has_no_numbers_to_copy(served: Served) -> None:
    order = {"kind": "calibrate", "logs": [log(served)], "start": 0.0, "end": 12.0}
    job = served.ended(served.ask("POST", "/api/jobs", order)[1]["key"])
    found = served.ask("GET", f"/api/results/{job['result']}")[1]
    assert found["trusted"] is False
    assert found["sentence"].startswith("✘ Do not use this calibration: ")
    assert (found["rows"], found["exports"]) == ([], [])
    assert "px4.params" not in found["files"]


def test_a_dropped_log_is_called_by_its_name(served: Served) -> None:
    """No folder of the server in what the page is told of a log that cannot be read."""
    made = served.ask("POST", "/api/logs?name=raw.txt", b"1 2 3\n" * 20)[1]
    job = served.ended(served.ask("POST", "/api/jobs", {"kind": "look", "logs": [made["key"]]})[1]["key"])
    assert job["output"]["problem"].startswith("raw.txt: ")
    assert str(served.folder) not in job["output"]["problem"]
    served.ask("DELETE", f"/api/logs/{made['key']}")


@pytest.mark.parametrize(
    "make",
    [
        fuzz_files.dataflash,
        fuzz_files.ulog,
        fuzz_files.ros_bag,
        fuzz_files.ros_database,
        fuzz_files.telemetry,
        fuzz_files.phone,
    ],
)
def test_a_dropped_log_of_any_format_is_read_as_it_was(served: Served, tmp_path: Path, make: Any) -> None:
    """Each written by its format's library or description; what the server keeps is what a job reads."""
    content, suffix = make(tmp_path, mg.read(DIVE, end=60.0))
    file = tmp_path / f"{make.__name__}{suffix}"
    file.write_bytes(content)
    key = served.ask("POST", f"/api/logs?name={file.name}", content)[1]["key"]
    (kept,) = (served.folder / ".magyc-gtsam-uploads" / key[1:]).iterdir()
    expected, found = mg.read(file), mg.read(kept)
    for name in ("magnetometer", "gyroscope"):
        np.testing.assert_array_equal(getattr(found, name).time, getattr(expected, name).time)
        np.testing.assert_array_equal(getattr(found, name).value, getattr(expected, name).value)
    served.ask("DELETE", f"/api/logs/{key}")


def test_a_dropped_log_is_looked_at_and_removed(served: Served) -> None:
    status, made, _ = served.ask("POST", "/api/logs?name=dive.mcap", DIVE.read_bytes())
    assert (status, made["name"], made["uploaded"]) == (201, "dive.mcap", True)
    _, job, _ = served.ask("POST", "/api/jobs", {"kind": "look", "logs": [made["key"]]})
    found = served.ended(job["key"])["output"]
    assert found["format"].startswith("MCAP")
    assert found["strip"]["field"]["unit"] == "µT"
    assert 200 < len(found["strip"]["rate"]["time"]) <= 400
    assert served.ask("DELETE", f"/api/logs/{made['key']}")[0] == 200
    assert served.ask("DELETE", f"/api/logs/{made['key']}")[0] == 404
    assert served.ask("DELETE", f"/api/logs/{log(served)}")[0] == 404, (
        "a log of the folder is not the page's to remove"
    )
    assert (served.folder / DIVE.name).exists()


@pytest.mark.parametrize(
    "name",
    [
        "../../../../tmp/evil.csv",
        "/etc/passwd",
        "..%2F..%2Fevil.mcap",
        "C:\\evil.csv",
        ".ssh",
        "-o.csv",
        "a\0b.csv",
        "",
    ],
)
def test_a_path_in_a_file_name(served: Served, name: str) -> None:
    from urllib.parse import quote

    before = {path for path in served.folder.parent.rglob("*") if "uploads" not in str(path)}
    status, made, _ = served.ask("POST", f"/api/logs?name={quote(name, safe='%')}", b"time,mx,my,mz\n0,1,2,3\n")
    assert status == 201
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", made["name"])
    (path,) = (served.folder / ".magyc-gtsam-uploads" / made["key"][1:]).iterdir()
    assert path.name == made["name"]
    assert served.ask("DELETE", f"/api/logs/{made['key']}")[0] == 200
    assert {path for path in served.folder.parent.rglob("*") if "uploads" not in str(path)} == before


@pytest.mark.parametrize(
    "path",
    [
        "/results/../calibration_dive.mcap",
        "/results/..%2f/calibration_dive.mcap",
        "/results/%2e%2e/calibration_dive.mcap",
        "/results//etc/passwd",
        "/results/x/%2fetc%2fpasswd",
        "/api/results/..",
        "/api/results/%2e%2e%2f",
        "/api/jobs/..",
    ],
)
def test_a_path_in_an_address(served: Served, path: str) -> None:
    assert served.ask("GET", path)[0] == 404


@pytest.mark.parametrize(
    "origin", [None, "https://evil.example", "null", "http://127.0.0.1:1", "http://localhost"]
)
def test_a_foreign_origin(served: Served, origin: str | None) -> None:
    asked = {"kind": "look", "logs": [log(served)]}
    assert served.ask("POST", "/api/jobs", asked, origin=origin)[0] == 403
    assert served.ask("POST", "/api/logs?name=a.csv", b"x", origin=origin)[0] == 403
    assert served.ask("DELETE", "/api/logs/x", origin=origin)[0] == 403
    assert upgraded(served, origin)[0].startswith(b"HTTP/1.1 403")


def test_a_foreign_name_that_points_here(served: Served) -> None:
    for name in (f"evil.example:{served.port}", "evil.example", "127.0.0.1.evil.example", "a b", ""):
        assert served.ask("GET", "/api/state", Host=name)[0] == 403, name
    assert served.ask("GET", "/api/state", Host=f"localhost:{served.port}")[0] == 200


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ([], "an object"),
        ({"kind": "rm"}, "kind"),
        ({"kind": "calibrate", "logs": ["/etc/passwd"]}, "no longer exist"),
        ({"kind": "calibrate", "logs": []}, "1 to"),
        ({"kind": "calibrate", "logs": ["x"] * 300}, "1 to"),
        ({"kind": "calibrate", "logs": ["{log}"], "start": "0; rm"}, "start"),
        ({"kind": "calibrate", "logs": ["{log}"], "start": float("nan")}, "start"),
        ({"kind": "calibrate", "logs": ["{log}"], "start": 10**400}, "start"),
        ({"kind": "calibrate", "logs": ["{log}"], "reading": {"output": "/tmp/x"}}, "reading"),
        ({"kind": "calibrate", "logs": ["{log}"], "reading": {"magnetic_unit": "--force"}}, "is unknown"),
        ({"kind": "calibrate", "logs": ["{log}"], "reading": {"magnetic_field": "a\n--force"}}, "printable text"),
    ],
)
def test_orders_that_mean_nothing(served: Served, asked: Any, says: str) -> None:
    body = json.dumps(asked).replace("{log}", log(served)).encode()
    status, answer, _ = served.ask("POST", "/api/jobs", body)
    assert status == 400
    assert says in answer["problem"]
    assert served.ask("POST", "/api/jobs", b"{" * 5000)[0] == 400
    assert served.ask("POST", "/api/jobs", b"[" * 100_000)[0] == 413


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("飛行.mcap", "log.mcap"),
        ("Übung 1.CSV", "bung_1.CSV"),
        ("..", "log"),
        ("a/b\\-.csv", "log.csv"),
        ("x" * 200 + ".ulg", "x" * 80 + ".ulg"),
    ],
)
def test_names_keep_their_suffix(name: str, kept: str) -> None:
    assert safe_name(name) == kept


def test_what_is_removed_while_it_is_listed_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As by another request, or by hand: the list was made, and what it names is gone."""
    for name in (
        "a.mcap",
        "b.mcap",
        ".magyc-gtsam-uploads/1/c.mcap",
        "results/r/live.json",
        "results/s/live.json",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("{}")
    store = Store(tmp_path, Limits())
    folders = store.result_folders()
    assert {each.name for each in store.logs().values()} == {"a.mcap", "b.mcap", "c.mcap"}
    assert set(folders) == {"r", "s"}
    listed = Path.iterdir

    def racing(folder: Path) -> Iterator[Path]:
        for path in list(listed(folder)):
            if path.name in ("b.mcap", "1", "r"):
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
            yield path

    monkeypatch.setattr(Path, "iterdir", racing)
    assert {each.name for each in store.logs().values()} == {"a.mcap"}
    assert set(store.result_folders()) == {"s"}
    assert store.described(folders["r"]) == {}


def test_uploads_that_are_too_large(served: Served) -> None:
    """What says so is refused before it comes; what does not is cut off; nothing stays."""
    with socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE) as raw:
        head = f"POST /api/logs?name=a.csv HTTP/1.1\r\nHost: {served.host}\r\nOrigin: http://{served.host}\r\n"
        raw.sendall(f"{head}Content-Length: 10000000000\r\n\r\nabc".encode())
        assert b" 413 " in raw.recv(200)
    with socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE) as raw:
        raw.sendall(f"{head}Transfer-Encoding: chunked\r\n\r\n".encode())
        answer = b""
        try:
            for _ in range(40):
                raw.sendall(b"100000\r\n" + bytes(1 << 20) + b"\r\n")
            answer = raw.recv(200)
        except OSError:  # it hung up while we were sending
            answer = b" 413 "
        assert b" 413 " in answer
    assert not any(each["uploaded"] for each in served.ask("GET", "/api/state")[1]["logs"])
    assert sum(len(list(path.iterdir())) for path in served.folder.glob(".magyc-gtsam-uploads/*")) == 0


def test_too_many_uploads(served: Served) -> None:
    made = []
    for _ in range(Limits().uploads):
        status, answer, _ = served.ask("POST", "/api/logs?name=a.csv", b"time,mx\n")
        assert status == 201
        made.append(answer["key"])
    status, answer, _ = served.ask("POST", "/api/logs?name=a.csv", b"time,mx\n")
    assert status == 507
    assert "remove one first" in answer["problem"]
    for key in made:
        served.ask("DELETE", f"/api/logs/{key}")


def test_a_bomb(served: Served, tmp_path: Path) -> None:
    """Half a gigabyte of zeros in half a megabyte, as a phone's archive."""
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in ("Magnetometer.csv", "Gyroscope.csv"):
            with archive.open(name, "w", force_zip64=True) as file:
                for _ in range(256):
                    file.write(bytes(1 << 20))
    data = (tmp_path / "bomb.zip").read_bytes()
    assert len(data) < 4 << 20
    _, made, _ = served.ask("POST", "/api/logs?name=bomb.zip", data)
    _, job, _ = served.ask("POST", "/api/jobs", {"kind": "look", "logs": [made["key"]]})
    job = served.ended(job["key"])
    assert job["state"] == "failed" or job["output"]["problem"]
    served.ask("DELETE", f"/api/logs/{made['key']}")


def upgraded(served: Served, origin: str | None = "own") -> tuple[bytes, socket.socket]:
    """The answer to a web socket's beginning, and the connection."""
    raw = socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE)
    own = f"http://{served.host}" if origin == "own" else origin
    lines = [
        "GET /api/events HTTP/1.1", f"Host: {served.host}", "Upgrade: websocket", "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13",
        *([] if own is None else [f"Origin: {own}"]),
    ]  # fmt: skip
    raw.sendall("\r\n".join([*lines, "", ""]).encode())
    return raw.recv(300), raw


def test_malformed_frames(served: Served) -> None:
    frames = [
        os.urandom(500),
        b"\xff" * 20,
        struct.pack("!BBQ", 0x81, 0xFF, 1 << 60),  # as long as nothing is
        struct.pack("!BBH", 0x81, 0xFE, 60_000) + bytes(60_004),  # longer than what is taken
        b"\x81\x05hello",  # without a mask
        b"\x89\xfe\xff\xff",  # a ping that is too long
    ]
    for frame in frames:
        answer, raw = upgraded(served)
        assert answer.startswith(b"HTTP/1.1 101")
        raw.sendall(frame)
        raw.shutdown(socket.SHUT_WR)
        while True:  # until it hangs up
            try:
                if not raw.recv(1 << 16):
                    break
            except ConnectionError:
                break
        raw.close()
    assert served.ask("GET", "/api/state")[0] == 200


def test_many_connections(served: Served) -> None:
    """Beyond the limit they are turned away, and when they are gone the server answers as before."""
    held = []
    for _ in range(min(1000, resource.getrlimit(resource.RLIMIT_NOFILE)[0] - 200)):
        raw = socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE)
        raw.sendall(b"GET / HTTP/1.1\r\nHost: ")
        held.append(raw)
    status = served.ask("GET", "/api/state")[0]
    assert status == 503
    for raw in held:
        raw.close()
    until = time.monotonic() + PATIENCE
    while served.ask("GET", "/api/state")[0] != 200:
        assert time.monotonic() < until
        time.sleep(0.1)


def test_more_pages_than_there_may_be(served: Served) -> None:
    opened = [upgraded(served) for _ in range(Limits().sockets + 2)]
    assert [answer.startswith(b"HTTP/1.1 101") for answer, _ in opened] == [True] * Limits().sockets + [False] * 2
    for _, raw in opened:
        raw.close()


def test_waiting_and_cancelling(served: Served) -> None:
    """One per core, the others wait and say so; what is cancelled leaves nothing."""
    cores = os.cpu_count() or 1
    keys = [
        served.ask("POST", "/api/jobs", {"kind": "gap", "logs": [log(served)]})[1]["key"] for _ in range(cores + 2)
    ]
    state = {job["key"]: job for job in served.ask("GET", "/api/state")[1]["jobs"]}
    assert [state[key]["ahead"] for key in keys[-2:]] == [1, 2]
    assert {state[key]["state"] for key in keys[-2:]} == {"waiting"}
    for key in keys:
        assert served.ask("DELETE", f"/api/jobs/{key}")[0] == 200
    assert {served.ended(key)["state"] for key in keys} == {"cancelled"}
    assert not list(served.folder.glob("results/*gap*"))


def test_the_token(tmp_path: Path) -> None:
    server = Served(tmp_path, "--host", "127.0.0.1")
    try:
        assert server.token
        for path in ("/", "/?token=", f"/?token={server.token[:-1]}", "/api/state", "/results/a/b"):
            assert server.ask("GET", path)[0] == 403
        assert server.ask("GET", "/api/state", Cookie=f"magyc_gtsam_{server.port}=wrong")[0] == 403
        assert upgraded(server)[0].startswith(b"HTTP/1.1 403")
        status, _, headers = server.ask("GET", f"/?token={server.token}")
        assert status == 200
        cookie = headers["set-cookie"].partition(";")[0]
        assert "HttpOnly; SameSite=Strict" in headers["set-cookie"]
        assert server.ask("GET", "/api/state", Cookie=cookie)[0] == 200
        assert server.ask("POST", "/api/jobs", {}, origin="https://evil.example", Cookie=cookie)[0] == 403
    finally:
        assert "ended" in server.stop()


def test_a_killed_server_loses_no_calibration(tmp_path: Path) -> None:
    """Its job goes on, and the next server lists what it gave."""
    shutil.copy(DIVE, tmp_path)
    server = Served(tmp_path)
    _, job, _ = server.ask("POST", "/api/jobs", {"kind": "calibrate", "logs": [log(server)]})
    uploaded = server.ask("POST", "/api/logs?name=kept.csv", b"time,mx\n")[1]["key"]
    while server.ask("GET", f"/api/jobs/{job['key']}")[1]["state"] == "waiting":
        time.sleep(0.02)
    server.stop(signal.SIGKILL)
    until = time.monotonic() + PATIENCE
    while not list(tmp_path.glob("results/*/report.html")):
        assert time.monotonic() < until
        time.sleep(0.05)
    server = Served(tmp_path)
    try:
        state = server.ask("GET", "/api/state")[1]
        assert uploaded in {each["key"] for each in state["logs"]}
        (result,) = state["results"]
        assert server.ask("GET", f"/api/results/{result['key']}")[1]["trusted"] is True
    finally:
        server.stop()
    assert not (tmp_path / ".magyc-gtsam-uploads").exists(), "uploads end with the server"


def test_what_cannot_be_served(tmp_path: Path) -> None:
    for arguments, says in (
        (["--folder", str(tmp_path / "absent")], "no such folder"),
        (["--folder", str(tmp_path), "--host", "203.0.113.7"], "cannot be listened on"),
    ):
        ran = run("serve", "--port", 0, *arguments, cwd=tmp_path)
        assert ran.returncode == 2
        assert says in ran.stderr
        assert ran.stderr.count("\n") == 1
