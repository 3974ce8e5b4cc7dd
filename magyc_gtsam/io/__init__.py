"""Readers of logs behind one `read`: ROS 2 and ROS 1 messages in MCAP and bags, text tables, autopilots and phones."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.lazy import attribute
from magyc_gtsam.io.log_info import LogInfo, Source, hole_remarks, turned
from magyc_gtsam.io.request import SENSORS, Request, Selection
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.axes import parse_axes
from magyc_gtsam.recording.stamps import holes
from magyc_gtsam.recording.time_zero import time_zero_of
from magyc_gtsam.recording.turned import in_magnetometer_axes
from magyc_gtsam.storage.files import expect_path

if TYPE_CHECKING:
    from magyc_gtsam.io.mcap_writer import write_mcap

__all__ = ["LogInfo", "Source", "info", "read", "same_format", "write_mcap"]

# The first bytes of a file decide its format; its suffix decides only if these are unknown.
_MAGIC = {
    b"\x89MCAP0\r\n": "mcap_log",
    b"ULog\x01\x12\x35": "ulog",
    b"\xa3\x95": "ardupilot",
    b"#ROSBAG V2.0": "ros_bag",
    b"SQLite format 3\0": "ros_bag",
    b"\x28\xb5\x2f\xfd": "ros_bag",  # zstd, in which rosbag2 can pack the whole file
    b"PK\x03\x04": "phone_archive",
    b"H Product:Blackbox": "blackbox",
}
SUFFIXES = {  # of the logs that folders are searched for
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".log"), "csv_log"),
    ".mcap": "mcap_log",
    ".ulg": "ulog",
    ".bin": "ardupilot",
    ".bag": "ros_bag",
    ".db3": "ros_bag",
    ".zstd": "ros_bag",
    ".zip": "phone_archive",
    ".tlog": "tlog",
    ".bbl": "blackbox",
    ".bfl": "blackbox",
}
_ROS = {"mcap_log", "ros_bag", "ros2_bag"}
_JSON = re.compile(rb"\s*(?:\{|\[\s*[\[{])")
_DATAFLASH_TEXT = re.compile(rb"\s*FMT\s*,\s*\d+\s*,\s*\d+\s*,\s*\w+\s*,")
_OWN_RESULT = re.compile(rb"format: magyc-gtsam |magyc_gtsam: [\d.]+\n")  # of calibrations, and configuration.yaml
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
    gyroscope_axes: str | None = None,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> Recording:
    """Read a log into a `Recording`. Time 0 is the log's first row; the notes list conversions and omissions.

    Args:
        path: MCAP, text table, PX4 .ulg, ArduPilot .BIN, ROS .bag or .db3, the folder of a ROS 2 bag (its files are one
            log), MAVLink .tlog, Blackbox (Betaflight, INAV), or the .zip of a phone app.
        magnetic_field, angular_rate, acceleration, attitude: the topic (MCAP), the columns or their common prefix
            (text), or the message (PX4, ArduPilot) of each sensor; needed only if several match.
        magnetic_unit: unit of the magnetometer, if it is neither tesla nor named in the header: "T", "mT", "uT",
            "nT", "gauss", "mgauss", a number of tesla per count, or "counts" if that is unknown.
        angular_unit: unit of the gyroscope, in the same way: "rad/s", "deg/s", "mrad/s".
        acceleration_unit: unit of the accelerometer, in the same way: "m/s^2", "g".
        start, end: interval to keep, s since the first row.
        stamps: "header" (of the sensor) or "log" (of the recorder; MCAP, bags, .tlog).
        channels: names of other data to read; None for all (MCAP, text) or the usual ones (other formats).
        gyroscope_axes: the gyroscope's axes along the magnetometer's x, y, z, if the two differ, such as "y,-x,z".
        progress: called with the fraction done, 0 to 1.
        options: options of one format: `time`, `time_unit`, `rate`, `columns` of text tables, `log` of Blackbox.

    Raises:
        MagycError: the file does not exist, is not a log, or does not hold a recording; the message has the remedy.
    """
    request = _request(
        magnetic_field=magnetic_field,
        angular_rate=angular_rate,
        acceleration=acceleration,
        attitude=attitude,
        magnetic_unit=magnetic_unit,
        angular_unit=angular_unit,
        acceleration_unit=acceleration_unit,
        start=start,
        end=end,
        stamps=stamps,
        channels=channels,
        progress=progress,
        **options,
    )
    file = expect_path("read", path)
    axes = None if gyroscope_axes is None else parse_axes(gyroscope_axes)
    reader = _reader(file)
    try:
        recording: Recording = reader.read(file, request)
    except MagycError as error:
        problem = str(error)
        if magnetic_unit is not None and problem.startswith("magnetic_field: median norm"):
            # The likely unit in the message is that of the numbers after the factor of the given one.
            problem = problem[: problem.index(")") + 1]
            problem += (
                f"; it was read in {magnetic_unit}, as requested: name another unit, or none (magnetic_unit=)"
            )
        if str(file) in problem:
            raise
        raise MagycError(f"{file}: {problem}") from None
    return recording if axes is None else in_magnetometer_axes(recording, axes)


def check_arguments(*, gyroscope_axes: str | None = None, **arguments: Any) -> None:
    """Check arguments of `read` without a log.

    Raises:
        MagycError: one of them is wrong for every log; what depends on the format or the contents is not checked.
    """
    _request(**arguments)
    if gyroscope_axes is not None:
        parse_axes(gyroscope_axes)


def _request(
    *, magnetic_unit: Any = None, angular_unit: Any = None, acceleration_unit: Any = None, **rest: Any
) -> Request:
    """Return the request for arguments of `read`; those that are not known belong to one format."""
    return Request(
        sensors={name: rest.pop(name, None) for name in (*SENSORS, "attitude")},
        units=dict(zip(SENSORS, (magnetic_unit, angular_unit, acceleration_unit), strict=True)),
        **{name: rest.pop(name) for name in ("start", "end", "stamps", "channels", "progress") if name in rest},
        options=rest,
    )


def info(path: str | PathLike[str], **arguments: Any) -> LogInfo:
    """Describe the contents of a log, and whether `read` can make a recording of it.

    Args:
        path: the log.
        arguments: arguments of `read`.

    Raises:
        MagycError: the file does not exist or is not a log.
    """
    return info_and_recording(path, **arguments)[0]


def info_and_recording(path: str | PathLike[str], **arguments: Any) -> tuple[LogInfo, Recording | None]:
    """Return the result of `info` and the recording; None if `read` cannot make one."""
    file = expect_path("info", path)
    described: LogInfo = _reader(file).info(file)
    try:
        recording = read(path, **arguments)
    except MagycError as error:
        return replace(described, problem=str(error)), None
    described = described.since(time_zero_of(recording))
    notes = tuple(n for n in recording.notes if n not in described.warnings)
    path_length = None if recording.angular_rate is None else turned(*recording.gyroscope)
    # Messages of an IMU have a place for each of these, and say in themselves whether they hold one. Beside
    # an attitude of its own theirs is used only where it is named.
    absent = {name for name in ("attitude", "acceleration") if getattr(recording, name) is None}
    elsewhere = any("attitude" in s.serves_as and "angular_rate" not in s.serves_as for s in described.sources)
    if elsewhere and arguments.get("attitude") is None:
        absent.add("attitude")
    sources = tuple(
        replace(each, serves_as=tuple(use for use in each.serves_as if use not in absent))
        if "angular_rate" in each.serves_as
        else each
        for each in described.sources
    )
    pauses = holes(recording.time)
    sources = tuple(each.with_pauses(pauses) for each in sources)
    warnings = (*described.warnings, *notes, *hole_remarks(recording))
    return replace(described, sources=sources, warnings=warnings, turned=path_length), recording


def same_format(one: str | PathLike[str], other: str | PathLike[str]) -> bool:
    """Return whether two logs have the same format, so that the options of one apply to the other.

    Raises:
        MagycError: a file does not exist or is not a log.
    """
    first, second = format_of(one), format_of(other)
    return first == second or {first, second} <= _ROS


def format_of(path: str | PathLike[str]) -> str:
    """Return the format of a log, as the name of the module that reads it.

    Raises:
        MagycError: the file does not exist or is not a log.
    """
    return _reader(Path(path)).__name__.rpartition(".")[2]


def _reader(path: Path) -> ModuleType:
    """Return the module that reads a file."""
    if path.is_dir():
        bag = importlib.import_module("magyc_gtsam.io.ros2_bag")
        if bag.is_bag(path):
            return bag
        inside = [*sorted(path.glob("*.mcap")), *sorted(path.glob("*.db3"))]
        hint = f"; read its {inside[0].name}" if inside else "; name a log in it"
        if parts := bag.files_without_metadata(path):
            hint = (
                f"; its {len(parts)} files {parts[0].name} to {parts[-1].name} are named like those of a ROS 2 bag "
                "without metadata.yaml: `ros2 bag reindex` writes it, and they are one log then"
            )
        raise MagycError(f"{path}: expected a file, got a directory{hint}")
    try:
        if path.exists() and not path.is_file():  # readers seek, and read some parts twice
            raise MagycError(f"{path}: expected a file, got a pipe or a device; write its data to a file first")
        with open(path, "rb") as file:
            head = file.read(512)
    except OSError as error:
        raise MagycError(f"{path}: cannot be read ({error.strerror})") from None
    if not head:
        raise MagycError(f"{path}: is empty")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise MagycError(f"{path}: text in UTF-16; save it as UTF-8")
    if _DATAFLASH_TEXT.match(head):
        raise MagycError(f"{path}: an ArduPilot log as text; read the .BIN from which it was converted")
    if _OWN_RESULT.match(head):
        raise MagycError(f"{path}: a result of magyc-gtsam, not a log; name the log from which it was made")
    if _JSON.match(head):
        raise MagycError(
            f"{path}: JSON is not a format of logs; write a text table, or pass JSON lines to `magyc-gtsam online -`"
        )
    by_content = next((name for magic, name in _MAGIC.items() if head.startswith(magic)), None)
    name = by_content or SUFFIXES.get(path.suffix.lower()) or ("csv_log" if b"\0" not in head else None)
    if name is None or (by_content is None and name == "csv_log" and b"\0" in head):
        raise MagycError(f"{path}: not a format that can be read ({_KNOWN})")
    if by_content is None and name not in _WITHOUT_MAGIC:
        raise MagycError(f"{path}: the content is not that of a {path.suffix} file; is it damaged?")
    return importlib.import_module(f"magyc_gtsam.io.{name}")


def __getattr__(name: str) -> Any:
    return attribute(__name__, {"write_mcap": "mcap_writer"}, name)
