"""Logs in: one `read` for ROS 2 and ROS 1 messages in MCAP and bags, text tables, autopilots' and phones' logs."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.lazy import attribute
from magyc_gtsam.io.log_info import LogInfo, Source, turned
from magyc_gtsam.io.request import Request, Selection
from magyc_gtsam.recording import Recording

if TYPE_CHECKING:
    from magyc_gtsam.io.mcap_writer import write_mcap

__all__ = ["LogInfo", "Source", "info", "read", "same_format", "write_mcap"]

# What a file begins with says more than its name; the name decides where the beginning says nothing.
_MAGIC = {
    b"\x89MCAP0\r\n": "mcap_log",
    b"ULog\x01\x12\x35": "ulog",
    b"\xa3\x95": "ardupilot",
    b"#ROSBAG V2.0": "ros_bag",
    b"SQLite format 3\0": "ros_bag",
    b"PK\x03\x04": "phone_archive",
    b"H Product:Blackbox": "blackbox",
}
_SUFFIXES = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".log"), "csv_log"),
    ".mcap": "mcap_log",
    ".ulg": "ulog",
    ".bin": "ardupilot",
    ".bag": "ros_bag",
    ".db3": "ros_bag",
    ".zip": "phone_archive",
    ".tlog": "tlog",
    ".bbl": "blackbox",
    ".bfl": "blackbox",
}
_WITHOUT_MAGIC = ("csv_log", "tlog")
_KNOWN = (
    "MCAP, text table, PX4 .ulg, ArduPilot .BIN, ROS .bag and .db3, MAVLink .tlog, Blackbox, a phone app's .zip"
)


def read(
    path: str | PathLike[str],
    *,
    magnetic_field: Selection = None,
    angular_rate: Selection = None,
    acceleration: Selection = None,
    attitude: Selection = None,
    magnetic_unit: str | float | None = None,
    angular_unit: str | float | None = None,
    acceleration_unit: str | float | None = None,
    start: float | None = None,
    end: float | None = None,
    stamps: Literal["header", "log"] = "header",
    channels: Sequence[str] | None = None,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> Recording:
    """A `Recording` from a log. Time 0 is the log's first row; the notes say what had to be done.

    Args:
        path: MCAP, text table, PX4 .ulg, ArduPilot .BIN, ROS .bag or .db3, MAVLink .tlog, Blackbox
            (Betaflight, INAV), or the .zip of a phone app.
        magnetic_field, angular_rate, acceleration, attitude: the topic (MCAP), the columns or the beginning
            they share (text), or the message (PX4, ArduPilot) of each sensor; not needed where one only
            could be meant.
        magnetic_unit: what the log's magnetometer is in, where that is not tesla or the header does not say:
            "T", "mT", "uT", "nT", "gauss", "mgauss", tesla per count, or "counts" where that is not known.
        angular_unit: likewise, "rad/s", "deg/s", "mrad/s".
        acceleration_unit: likewise, "m/s^2", "g".
        start, end: s since the first row.
        stamps: "header" (of the sensor) or "log" (of the recorder; MCAP only).
        channels: which of the other numbers in the log to read; None for all (MCAP, text) or the usual ones.
        progress: called with the fraction done, 0 to 1.
        options: of one format only: `time`, `time_unit`, `rate`, `columns` of text tables, `log` of Blackbox.

    Raises:
        MagycError: no such file, not a log, or nothing that makes a recording; the message says what to do.
    """
    request = Request(
        sensors={
            "magnetic_field": magnetic_field,
            "angular_rate": angular_rate,
            "acceleration": acceleration,
            "attitude": attitude,
        },
        units={
            "magnetic_field": magnetic_unit,
            "angular_rate": angular_unit,
            "acceleration": acceleration_unit,
        },
        start=start,
        end=end,
        stamps=stamps,
        channels=channels,
        progress=progress,
        options=options,
    )
    recording: Recording = _reader(Path(path)).read(Path(path), request)
    return recording


def info(path: str | PathLike[str], **arguments: Any) -> LogInfo:
    """What a log holds, and whether `read` makes a recording of it; nothing is calibrated.

    Args:
        path: of the log.
        arguments: of `read`.

    Raises:
        MagycError: no such file, or not a log.
    """
    return info_and_recording(path, **arguments)[0]


def info_and_recording(path: str | PathLike[str], **arguments: Any) -> tuple[LogInfo, Recording | None]:
    """As `info`, with the recording where there is one."""
    described: LogInfo = _reader(Path(path)).info(Path(path))
    try:
        recording = read(path, **arguments)
    except MagycError as error:
        return replace(described, problem=str(error)), None
    notes = tuple(n for n in recording.notes if n not in described.warnings)
    way = None if recording.angular_rate is None else turned(*recording.gyroscope)
    return replace(described, warnings=(*described.warnings, *notes), turned=way), recording


def same_format(one: str | PathLike[str], other: str | PathLike[str]) -> bool:
    """Whether two logs are of one format, so that the options of one can hold for the other.

    Raises:
        MagycError: no such file, or not a log.
    """
    return _reader(Path(one)) is _reader(Path(other))


def _reader(path: Path) -> ModuleType:
    """The module that reads this file."""
    if path.is_dir():
        inside = sorted(path.glob("*.mcap"))
        hint = f"; read its {inside[0].name}" if inside else ""
        raise MagycError(f"{path}: is a directory, a file is expected{hint}")
    try:
        if path.exists() and not path.is_file():  # which is read more than once, and at any place
            raise MagycError(f"{path}: is a pipe or a device, a file is expected; write it to one first")
        with open(path, "rb") as file:
            head = file.read(512)
    except OSError as error:
        raise MagycError(f"{path}: cannot be read ({error.strerror})") from None
    if not head:
        raise MagycError(f"{path}: is empty")
    by_content = next((name for magic, name in _MAGIC.items() if head.startswith(magic)), None)
    name = by_content or _SUFFIXES.get(path.suffix.lower()) or ("csv_log" if b"\0" not in head else None)
    if name is None or (by_content is None and name == "csv_log" and b"\0" in head):
        raise MagycError(f"{path}: not a format that can be read ({_KNOWN})")
    if by_content is None and name not in _WITHOUT_MAGIC:
        raise MagycError(f"{path}: is called {path.suffix} but does not begin like one; is the file damaged?")
    return importlib.import_module(f"magyc_gtsam.io.{name}")


def __getattr__(name: str) -> Any:
    return attribute(__name__, {"write_mcap": "mcap_writer"}, name)
