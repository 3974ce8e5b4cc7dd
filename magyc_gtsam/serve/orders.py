"""Check what the page requests, and turn it into arguments of the command line and the SOURCE of a live run."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.units import factor
from magyc_gtsam.live.line_sources import LOOPBACK
from magyc_gtsam.live.mavlink import ADDRESS
from magyc_gtsam.serve.limits import Limits
from magyc_gtsam.serve.ports import checked_port
from magyc_gtsam.serve.store import StoredLog

KINDS = ("look", "calibrate", "gap", "compare", "history")
_TEXTS = ("magnetic_field", "angular_rate")  # options that name topics, messages or columns
_UNITS = {"magnetic_unit": "magnetic_field", "angular_unit": "angular_rate"}
_LONGEST = 200  # most characters of a topic


@dataclass(frozen=True)
class JobRequest:
    """A checked request for a job.

    Attributes:
        kind: one of `KINDS`.
        logs: one log, or several for a history.
        start, end: limits of the interval, s; None for those of the log.
        reading: options of the command line on how to read the log.
    """

    kind: str
    logs: tuple[StoredLog, ...]
    start: float | None
    end: float | None
    reading: tuple[str, ...]

    @property
    def title(self) -> str:
        """Return the log's name, or the number of logs."""
        return self.logs[0].name if len(self.logs) == 1 else f"{len(self.logs)} logs"

    def arguments(self, output: str | None) -> list[str]:
        """Return the arguments of `magyc-gtsam`; `output` is the folder of the results, None for a "look"."""
        interval = [f"--{n}={v!r}" for n, v in (("start", self.start), ("end", self.end)) if v is not None]
        logs = [str(log.path) for log in self.logs]
        if self.kind == "look":
            return ["info", *logs, "--json", "--strip", *self.reading]
        assert output is not None
        return [self.kind, *logs, "--json", f"--output={output}", *interval, *self.reading]


def order(asked: Any, logs: Mapping[str, StoredLog], limits: Limits) -> JobRequest:
    """Return the job that the page requested.

    Raises:
        MagycError: the request is malformed or names a log that does not exist.
    """
    if not isinstance(asked, dict):
        raise MagycError("the request must be an object")
    kind, keys = asked.get("kind"), asked.get("logs")
    if kind not in KINDS:
        raise MagycError(f"kind: must be one of {', '.join(KINDS)}")
    if (
        not isinstance(keys, list)
        or not 0 < len(keys) <= limits.history
        or not all(isinstance(k, str) for k in keys)
    ):
        raise MagycError(f"logs: must be a list of 1 to {limits.history} keys")
    if len(keys) > 1 and kind != "history":
        raise MagycError(f"logs: only a history takes several, {kind} takes one")
    if absent := [key for key in keys if key not in logs]:
        raise MagycError(f"logs: {len(absent)} no longer exist; reload the page")
    start, end = (_seconds(asked, name) for name in ("start", "end"))
    return JobRequest(kind, tuple(logs[key] for key in dict.fromkeys(keys)), start, end, tuple(reading(asked)))


def _seconds(asked: Mapping[str, Any], name: str) -> float | None:
    value = asked.get(name)
    if value is None:
        return None
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not abs(value) <= 1e9:  # nor NaN
        raise MagycError(f"{name}: must be a finite number of seconds")
    return float(value)


def reading(asked: Mapping[str, Any]) -> Sequence[str]:
    """Return the options of the command line for `asked["reading"]`: units and topics.

    Raises:
        MagycError: an unknown option or an invalid value.
    """
    options = asked.get("reading") or {}
    if not isinstance(options, dict) or not options.keys() <= {*_TEXTS, *_UNITS}:
        raise MagycError(f"reading: only {', '.join((*_TEXTS, *_UNITS))} can be set")
    result = []
    for name, value in options.items():
        if value in (None, ""):
            continue
        if not isinstance(value, str) or len(value) > _LONGEST or not value.isprintable():
            raise MagycError(f"{name}: must be printable text of at most {_LONGEST} characters")
        if name in _UNITS:
            factor(_UNITS[name], _number_or_text(value))
        result.append(f"--{name.replace('_', '-')}={value}")
    return result


def _number_or_text(value: str) -> str | float:
    try:
        return float(value)
    except ValueError:
        return value


SOURCES = ("udp", "mavlink", "serial", "file", "ros2")
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
    raise MagycError(f"kind: must be one of {', '.join(SOURCES)}")
