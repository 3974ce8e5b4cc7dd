"""Open the live source that an address names."""

from __future__ import annotations

import contextlib
from pathlib import Path
from urllib.parse import parse_qs

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.mcap_records import MAGIC
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.line_sources import BAUD, JsonLines, SerialLines, UdpLines
from magyc_gtsam.live.source import LiveSource

FORMS = (
    "an MCAP file that may grow, another log, - (JSON lines), udp://[HOST]:PORT, serial://PORT?baud=N, "
    "mavlink://udpin:HOST:PORT, ros2://"
)
_REPLAYED = {"ros_bag", "ros2_bag", "csv_log", "phone_archive"}  # formats of complete logs without an autopilot


def is_file(text: str) -> bool:
    """Return whether an address names a file, growing or complete."""
    return text != "-" and "://" not in text


def open_source(text: str, request: Request) -> LiveSource:
    """Open a source.

    Args:
        text: a file, "-" for standard input, or an address in one of the `FORMS`.
        request: topics, units, stamps, and options of complete logs.

    Raises:
        MagycError: the address is not valid, or the source cannot be opened.
    """
    if is_file(text):
        return _of_file(Path(text), request)
    if request.options:
        raise MagycError(f"--read: has no effect on {text}; it is for complete logs, such as text tables")
    if text == "-":
        return JsonLines(0, request)
    kind, _, location = text.partition("://")
    where, _, query = location.partition("?")
    options = {name: values[-1] for name, values in parse_qs(query, keep_blank_values=True).items()}
    known = {"udp": set[str](), "ros2": set(), "serial": {"baud"}, "mavlink": {"baud"}}
    if kind not in known or not options.keys() <= known[kind]:
        raise MagycError(f"{text}: unknown kind of source; use one of {FORMS}")
    if kind == "udp":
        host, _, port = where.rpartition(":")
        return UdpLines(host, _number(text, port, 65535), request)
    if kind == "serial":
        return SerialLines(where, _number(text, options.get("baud", str(BAUD)), 20_000_000), request)
    if kind == "mavlink":
        from magyc_gtsam.live import mavlink

        baud = _number(text, options.get("baud", str(mavlink.BAUD)), 20_000_000)
        return mavlink.MavlinkSource(where, request, baud)
    from magyc_gtsam.live.ros2 import Ros2Topics

    return Ros2Topics(request)


def _of_file(path: Path, request: Request) -> LiveSource:
    """Open a file, or the folder of a bag: MCAP, which may grow, is followed, and any other format is complete."""
    from magyc_gtsam.io import format_of
    from magyc_gtsam.io.ros2_bag import files_without_metadata
    from magyc_gtsam.live.logged import CompleteLog
    from magyc_gtsam.live.mcap_follow import McapFollower

    if path.is_file() and _may_grow(path):
        request.only("MCAP")
        follower = McapFollower(path, request)
        if path in (parts := files_without_metadata(path.parent)) and path != parts[-1]:
            follower.notes.append(
                f"{path.name} is followed alone; with {parts[-1].name} it is named like the files of a ROS 2 bag "
                "without metadata.yaml: `ros2 bag reindex` writes it, and its folder is one log then"
            )
        return follower
    kind = format_of(path)
    if kind not in _REPLAYED:
        raise MagycError(
            f"{path}: the log of an autopilot, whose parameters need the whole of it; use magyc-gtsam calibrate"
        )
    return CompleteLog(path, request)


def _may_grow(path: Path) -> bool:
    """Return whether a file is MCAP, or has no content yet."""
    with contextlib.suppress(OSError), open(path, "rb") as file:
        head = file.read(len(MAGIC))
        return MAGIC.startswith(head)
    return True


def _number(text: str, part: str, largest: int) -> int:
    """Return a part of an address as a whole number from 0 to `largest`."""
    if not part.isdecimal() or not 0 <= int(part[:9]) <= largest or len(part) > 9:
        raise MagycError(f"{text}: expected a whole number from 0 to {largest}, got {part[:40]!r}")
    return int(part)
