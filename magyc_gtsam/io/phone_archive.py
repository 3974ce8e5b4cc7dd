"""Read what phone apps export (Sensor Logger, phyphox): a ZIP with one text table a sensor."""

from __future__ import annotations

import lzma
import re
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed, shortened
from magyc_gtsam.io import csv_table
from magyc_gtsam.io.csv_columns import Column
from magyc_gtsam.io.csv_stamps import StampColumn
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.io.units import factor
from magyc_gtsam.recording import Recording

MAGIC = b"PK\x03\x04"
_LARGEST = 1 << 29  # bytes of a table, unpacked
_PACKED = (
    25  # times its packed size, the most that is unpacked; a table of a phone that lies still packs to a sixth
)
# The tables of each sensor, best first: the phone's own calibration of the magnetometer comes and goes.
_TABLES = {
    "magnetic_field": (r"magnetometer ?uncalibrated", r"magnetometer|magnetic ?field"),
    "angular_rate": (r"gyroscope ?uncalibrated", r"gyroscope"),
    "acceleration": (r"total ?acceleration", r"accelerometer ?uncalibrated", r"accelerometer|acceleration with g"),
}
_UNIT = {"magnetic_field": "uT", "angular_rate": "rad/s", "acceleration": "m/s^2"}  # both apps', where unnamed
# What zipfile and its decompressors raise on damaged archives; RuntimeError is that of an encrypted member.
_UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    NotImplementedError,
    OSError,
    RuntimeError,
    ValueError,
)
_AXIS = re.compile(r"(?:^|[ _.])([xyz])$")


def read(path: Path, request: Request) -> Recording:
    """As `magyc_gtsam.io.read`, of an archive.

    Raises:
        MagycError: there is no magnetometer in it, or a table cannot be read.
    """
    request.only("phone archive")
    if request.stamps == "log":
        raise MagycError("stamps='log': the tables of an archive have one clock only")
    notes: list[str] = []
    sensors: dict[str, Stream] = {}
    with _opened(path) as archive:
        found = _tables(archive)
        for done, sensor in enumerate(_TABLES):
            name = request.named(sensor) or found.get(sensor, [""])[0]
            if not name:
                notes.append(f"no {sensor}: the archive has no table for it")
                continue
            sensors[sensor] = _stream(archive, path, name, sensor, request, notes)
            if len(found.get(sensor, [])) > 1:
                notes.append(f"{sensor} is from {name}; {listed(found[sensor][1:])} could be named instead")
            request.report((done + 1) / len(_TABLES))
    if "magnetic_field" not in sensors:
        raise MagycError(f"{path}: no magnetometer's table in the archive; it has {listed(archive.namelist())}")
    return assemble(sensors, {}, request, name=path.stem, notes=tuple(notes))


def info(path: Path) -> LogInfo:
    """As `magyc_gtsam.io.info`, of an archive; `problem` is left to the caller."""
    sources = []
    with _opened(path) as archive:
        for sensor, names in _tables(archive).items():
            for name in names:
                stamp = _stream(archive, path, name, sensor, Request(), []).stamp
                span = (0.0, float(stamp[-1] - stamp[0]) / 1e9) if len(stamp) else None
                sources.append(Source(name, "table", len(stamp), span, (sensor,)))
    duration = max((s.span[1] for s in sources if s.span), default=0.0)
    return LogInfo(str(path), "phone archive", duration, tuple(sources))


def _opened(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except _UNREADABLE as error:
        raise MagycError(f"{path}: not an archive that can be read ({shortened(error)})") from None


def _tables(archive: zipfile.ZipFile) -> Mapping[str, list[str]]:
    """The members that can be each sensor's, best first."""
    names = [n for n in archive.namelist() if n.lower().endswith((".csv", ".txt", ".tsv"))]
    result = {}
    for sensor, patterns in _TABLES.items():
        ranked = [n for p in patterns for n in names if re.fullmatch(p, Path(n).stem.strip().lower())]
        if ranked:
            result[sensor] = ranked
    return result


def _stream(
    archive: zipfile.ZipFile, path: Path, name: str, sensor: str, request: Request, notes: list[str]
) -> Stream:
    with tempfile.TemporaryDirectory(prefix="magyc-gtsam-") as folder:
        table = csv_table.load(_extracted(archive, path, name, Path(folder)), None)
        time, columns = _columns(table.columns, f"{path}: {name}")
        unit = time.unit or ("ns" if _is_nanoseconds(table.first[time.index]) else "s")
        stamps = StampColumn(Path(f"{path}: {name}"), unit)
        numbers, stamp, _, said = table.read([c.index for c in columns], time.index, stamps, lambda _: None)
        notes.extend(f"{name}: {note}" for note in said)
    scale, asked = request.scale(sensor, factor(sensor, columns[0].unit or _UNIT[sensor]))
    notes.extend(asked)
    value = numbers.together(range(len(columns)))
    known = np.isfinite(value).any(axis=1)
    return Stream(name, stamp[known], value[known] * scale)


def _is_nanoseconds(cell: str) -> bool:
    """Sensor Logger's stamps since 1970, without a unit."""
    return cell.strip().isdigit() and len(cell.strip()) >= 17


def _columns(columns: tuple[Column, ...], where: str) -> tuple[Column, list[Column]]:
    """Time, and x, y, z."""
    time = next((c for c in columns if c.name in ("time", "t", "timestamp", "seconds_elapsed")), None)
    axes = {m[1]: c for c in reversed(columns) if (m := _AXIS.search(c.name))}
    if time is None or len(axes) < 3:
        found = listed([c.written for c in columns]) or "no header"
        raise MagycError(f"{where}: columns of time, x, y and z are needed; it has {found}")
    return time, [axes[a] for a in "xyz"]


def _extracted(archive: zipfile.ZipFile, path: Path, name: str, folder: Path) -> Path:
    """The member as a file of its own, within what is granted."""
    try:
        member = archive.getinfo(name)
        granted = min(_LARGEST, _PACKED * member.compress_size + (1 << 20))
        if member.file_size > granted:
            raise MagycError(f"{path}: {name} unpacks to {member.file_size} bytes, {granted} are granted")
        target = folder / "table.csv"
        with archive.open(member) as source, open(target, "wb") as file:
            left = granted + 1
            while left > 0 and (data := source.read(min(1 << 20, left))):
                file.write(data)
                left -= len(data)
        if left <= 0:
            raise MagycError(f"{path}: {name} unpacks to more than {granted} bytes")
        return target
    except MagycError:
        raise
    except KeyError:
        raise MagycError(f"{path}: no table {name!r}; it has {listed(archive.namelist())}") from None
    except _UNREADABLE as error:
        raise MagycError(f"{path}: {name} cannot be unpacked ({shortened(error)})") from None
