"""Reader of the exports of phone apps (Sensor Logger, phyphox): a ZIP with one text table per sensor."""

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
_LARGEST = 1 << 29  # bytes of an unpacked table
_LARGEST_RATIO = 25  # of unpacked to packed size; the table of a phone at rest has a ratio of 6
# The tables of each sensor, best first: the phone's calibration of the magnetometer changes at any time.
_TABLES = {
    "magnetic_field": (r"magnetometer ?uncalibrated", r"magnetometer|magnetic ?field"),
    "angular_rate": (r"gyroscope ?uncalibrated", r"gyroscope"),
    "acceleration": (r"total ?acceleration", r"accelerometer ?uncalibrated", r"accelerometer|acceleration with g"),
}
_UNIT = {"magnetic_field": "uT", "angular_rate": "rad/s", "acceleration": "m/s^2"}  # of both apps, if not named
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
    """Read an archive; see `magyc_gtsam.io.read`.

    Raises:
        MagycError: the archive has no magnetometer, or a table cannot be read.
    """
    request.only("phone archive", clock="the clock of its tables")
    notes: list[str] = []
    sensors: dict[str, Stream] = {}
    with _opened(path) as archive:
        tables = _tables(archive)
        for done, sensor in enumerate(_TABLES):
            name = request.named(sensor) or tables.get(sensor, [""])[0]
            if not name:
                notes.append(f"no {sensor}: the archive has no table for it")
                continue
            sensors[sensor] = _stream(archive, path, name, sensor, request, notes)
            if len(tables.get(sensor, [])) > 1:
                notes.append(f"{sensor} is from {name}; {listed(tables[sensor][1:])} could be named instead")
            request.report((done + 1) / len(_TABLES))
    if "magnetic_field" not in sensors:
        names = archive.namelist()
        if names and all(name.endswith(".npy") for name in names):
            raise MagycError(
                f"{path}: a file of numpy arrays, whose meaning it does not say; load them with numpy.load, and give "
                "them to Recording.from_streams((time, magnetic_field), (time, angular_rate)), in s, T and rad/s"
            )
        raise MagycError(f"{path}: no table of a magnetometer in the archive; it has {listed(names)}")
    return assemble(sensors, {}, request, name=path.stem, notes=tuple(notes))


def info(path: Path) -> LogInfo:
    """Describe an archive; see `magyc_gtsam.io.info`, which sets `problem`."""
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
    """Open an archive."""
    try:
        return zipfile.ZipFile(path)
    except _UNREADABLE as error:
        raise MagycError(f"{path}: the archive cannot be read ({shortened(error)})") from None


def _tables(archive: zipfile.ZipFile) -> Mapping[str, list[str]]:
    """Return the members with tables of each sensor, best first."""
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
    """Read the stream of a sensor from a member of the archive."""
    with tempfile.TemporaryDirectory(prefix="magyc-gtsam-") as folder:
        table = csv_table.load(_extracted(archive, path, name, Path(folder)), None)
        time, columns = _columns(table.columns, f"{path}: {name}")
        unit = time.unit or ("ns" if _is_nanoseconds(table.first[time.index]) else "s")
        stamps = StampColumn(Path(f"{path}: {name}"), unit)
        numbers, stamp, _, table_notes = table.read([c.index for c in columns], time.index, stamps, lambda _: None)
        notes.extend(f"{name}: {note}" for note in table_notes)
    scale = request.scale(sensor, factor(sensor, columns[0].unit or _UNIT[sensor]), notes)
    value = numbers.together(range(len(columns)))
    known = np.isfinite(value).any(axis=1)
    return Stream(name, stamp[known], value[known] * scale)


def _is_nanoseconds(cell: str) -> bool:
    """Return whether a stamp without a unit is in ns since 1970, as Sensor Logger writes it."""
    return cell.strip().isdigit() and len(cell.strip()) >= 17


def _columns(columns: tuple[Column, ...], where: str) -> tuple[Column, list[Column]]:
    """Return the column of time, and those of x, y and z."""
    time = next((c for c in columns if c.name in ("time", "t", "timestamp", "seconds_elapsed")), None)
    axes = {m[1]: c for c in reversed(columns) if (m := _AXIS.search(c.name))}
    if time is None or len(axes) < 3:
        present = listed([c.written for c in columns]) or "no header"
        raise MagycError(f"{where}: expected columns of time, x, y and z, got {present}")
    return time, [axes[a] for a in "xyz"]


def _extracted(archive: zipfile.ZipFile, path: Path, name: str, folder: Path) -> Path:
    """Unpack a member into a file in `folder`, up to the largest permitted size."""
    try:
        member = archive.getinfo(name)
        largest = min(_LARGEST, _LARGEST_RATIO * member.compress_size + (1 << 20))
        if member.file_size > largest:
            raise MagycError(
                f"{path}: {name} unpacks to {member.file_size} bytes, more than the limit of {largest}"
            )
        target = folder / "table.csv"
        with archive.open(member) as source, open(target, "wb") as file:
            remaining = largest + 1
            while remaining > 0 and (data := source.read(min(1 << 20, remaining))):
                file.write(data)
                remaining -= len(data)
        if remaining <= 0:
            raise MagycError(f"{path}: {name} unpacks to more than the limit of {largest} bytes")
        return target
    except MagycError:
        raise
    except KeyError:
        raise MagycError(f"{path}: no table {name!r}; it has {listed(archive.namelist())}") from None
    except _UNREADABLE as error:
        raise MagycError(f"{path}: {name} cannot be unpacked ({shortened(error)})") from None
