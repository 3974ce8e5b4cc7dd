"""Build the SOURCE of a live run from the page's request, after checking every part."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.live.mavlink import ADDRESS
from magyc_gtsam.live.udp import LOOPBACK
from magyc_gtsam.serve.ports import checked_port
from magyc_gtsam.serve.store import StoredLog

KINDS = ("udp", "mavlink", "serial", "file", "ros2")
_BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
_NETWORK = re.compile(r"(?:udpin|udpout|tcp):[A-Za-z0-9.-]{1,100}:\d{1,5}")


def source_of(asked: Any, logs: Mapping[str, StoredLog]) -> str:
    """Return the SOURCE of `magyc-gtsam online`.

    Args:
        asked: {"kind": "udp", "port", "everywhere"}, {"kind": "mavlink", "address"} or with a serial "port" and "baud",
            {"kind": "serial", "port", "baud"}, {"kind": "file", "log"} or {"kind": "ros2"}.
        logs: the logs of the folder by key.

    Raises:
        MagycError: the request is malformed or names something that does not exist.
    """
    kind = asked.get("kind") if isinstance(asked, dict) else None
    if kind == "udp":
        port = asked.get("port")
        if not isinstance(port, int) or not 1024 <= port <= 65535:
            raise MagycError(f"port: must be a number from 1024 to 65535, got {port!r:.20}")
        return f"udp://{'0.0.0.0' if asked.get('everywhere') is True else LOOPBACK}:{port}"
    if kind == "mavlink" and asked.get("port") is None:
        address = asked.get("address")
        if not isinstance(address, str) or not _NETWORK.fullmatch(address) or not ADDRESS.fullmatch(address):
            raise MagycError("address: must be udpin:HOST:PORT, udpout:HOST:PORT or tcp:HOST:PORT")
        return f"mavlink://{address}"
    if kind in ("serial", "mavlink"):
        port = checked_port(asked.get("port"))
        if asked.get("baud") not in _BAUDS:
            raise MagycError(f"baud: must be one of {', '.join(map(str, _BAUDS))}")
        return f"{kind}://{port}?baud={asked['baud']}"
    if kind == "file":
        log = logs.get(str(asked.get("log")))
        if log is None or log.path.suffix.lower() != ".mcap":
            raise MagycError("log: must be an MCAP file of the folder")
        return str(log.path)
    if kind == "ros2":
        return "ros2://"
    raise MagycError(f"kind: must be one of {', '.join(KINDS)}")
