"""Open the live source that an address names."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import parse_qs

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.line_sources import BAUD, JsonLines, SerialLines, UdpLines
from magyc_gtsam.live.source import LiveSource

FORMS = "a growing MCAP file, - (JSON lines), udp://[HOST]:PORT, serial://PORT?baud=N, mavlink://udpin:HOST:PORT, ros2://"


def is_file(text: str) -> bool:
    """Return whether an address names a file, growing or complete."""
    return text != "-" and "://" not in text


def open_source(text: str, request: Request) -> LiveSource:
    """Open a source.

    Args:
        text: a file, "-" for standard input, or an address in one of the `FORMS`.
        request: topics, units and stamps.

    Raises:
        MagycError: the address is not valid, or the source cannot be opened.
    """
    if text == "-":
        return JsonLines(0, request)
    if is_file(text):
        from magyc_gtsam.live.mcap_follow import McapFollower

        path = Path(text)
        if path.is_dir():
            raise MagycError(
                f"{path}: is a directory; name the MCAP file in it that is being written, or calibrate a complete bag "
                "(`mg.calibrate`)"
            )
        return McapFollower(path, request)
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


def _number(text: str, part: str, largest: int) -> int:
    """Return a part of an address as a whole number from 0 to `largest`."""
    if not part.isdecimal() or not 0 <= int(part[:9]) <= largest or len(part) > 9:
        raise MagycError(f"{text}: expected a whole number from 0 to {largest}, got {part[:40]!r}")
    return int(part)
