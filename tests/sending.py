"""What sends samples to sources of `magyc-gtsam online`, and does not send faster than they are taken."""

from __future__ import annotations

import contextlib
import json
import random
import socket
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import magyc_gtsam as mg

EPOCH = 1_620_000_000.0


def rows(recording: mg.Recording) -> list[dict[str, Any]]:
    assert recording.angular_rate is not None
    return [
        {"time": EPOCH + t, "magnetic_field": m.tolist(), "angular_rate": w.tolist()}
        for t, m, w in zip(recording.time.tolist(), recording.magnetic_field, recording.angular_rate, strict=True)
    ]


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    """Return a free port below those that the system gives to sockets of other tests, which name none."""
    for port in random.sample(range(20_000, 32_000), 100):
        with socket.socket(socket.AF_INET, kind) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
    raise AssertionError("no port is free")


def _waiting(port: int) -> list[int] | None:
    """Return the bytes that wait at each UDP socket on the port; None where the system does not list its sockets."""
    sockets = Path("/proc/net/udp")
    if not sockets.exists():
        return None
    lines = (line.split() for line in sockets.read_text().splitlines()[1:])
    return [int(line[4].split(":")[1], 16) for line in lines if line[1].endswith(f":{port:04X}")]


def _taken(port: int) -> bool:
    waiting = _waiting(port)
    if waiting is not None:
        return bool(waiting)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:  # it has the port for a moment
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return True
    return False


def listened_to(port: int, by: bool = True) -> None:
    """Wait until somebody has the port; or, where `by` is False, until nobody has."""
    until = time.monotonic() + 60
    while time.monotonic() < until:
        if _taken(port) == by:
            return
        time.sleep(0.02)
    raise AssertionError(f"port {port} is {'free' if by else 'taken'} still")


def taken_in(port: int) -> None:
    """Wait until the system keeps little that the port's owner has not read: loopback, too, drops what is too much."""
    until = time.monotonic() + 60
    while time.monotonic() < until:
        waiting = _waiting(port)
        if waiting is None:
            time.sleep(0.05)
            return
        if all(count < 50_000 for count in waiting):
            return
        time.sleep(0.01)


def send_lines(port: int, lines: Sequence[dict[str, Any]]) -> None:
    """As datagrams of one line each."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for number, line in enumerate(lines):
            sender.sendto(json.dumps(line).encode(), ("127.0.0.1", port))
            if number % 50 == 0:
                taken_in(port)
