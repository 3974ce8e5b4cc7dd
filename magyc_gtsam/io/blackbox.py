"""Read Blackbox logs of Betaflight and INAV (.bbl, .bfl, .txt): the sensors as the firmware logged them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Array, Recording

_GRAVITY = 9.80665  # m/s²
_FIELDS = {"magnetic_field": ("magADC",), "angular_rate": ("gyroADC",), "acceleration": ("accSmooth", "accADC")}
_HIGH_RESOLUTION = 10.0  # Betaflight's, of gyroscope and accelerometer
_UNKNOWN_UNIT = (
    "magADC is logged in counts of the compass chip; say how many tesla one is (magnetic_unit=1e-7, say, "
    "where 1000 counts are a gauss), or magnetic_unit='counts' for a method that needs the magnetometer alone"
)


@dataclass(frozen=True)
class _Flight:
    """One of the logs in a file: its headers, µs (n,), by sensor (n, 3) as logged, how many logs, whether it ends."""

    headers: Mapping[str, Any]
    time: Array
    sensors: Mapping[str, Array]
    count: int
    whole: bool


def read(path: Path, request: Request) -> Recording:
    """As `magyc_gtsam.io.read`, of a Blackbox log; the option `log` says which of several in a file, from 1.

    Raises:
        MagycError: orangebox is not installed, the log is damaged, or no magnetometer was logged.
    """
    request.only("Blackbox", "log")
    if request.stamps == "log":
        raise MagycError("stamps='log': a Blackbox log has the flight controller's clock only")
    wanted = request.options.get("log", 1)
    if not isinstance(wanted, int) or wanted < 1:
        raise MagycError(f"log: {wanted!r}, a number from 1 is expected")
    flight = _flight(path, wanted)
    if "magnetic_field" not in flight.sensors:
        raise MagycError(
            f"{path}: no magADC in the log; record again with the compass on and logged (in the Blackbox settings)"
        )
    if request.units.get("magnetic_field") is None:
        raise MagycError(f"{path}: {_UNKNOWN_UNIT}")
    notes = ["magADC is what the firmware made of the reading with its own compass calibration and alignment"]
    if flight.count > 1:
        notes.append(f"the file holds {flight.count} logs, this is number {wanted} (log=)")
    if not flight.whole:
        notes.append(f"the log is cut off; {len(flight.time)} frames could be read")
    stamp = np.round(flight.time * 1000).astype(np.int64)
    sensors = {}
    for sensor, value in flight.sensors.items():
        scale, said = request.scale(sensor, _scale(sensor, flight.headers, path))
        notes.extend(said)
        # The compass is slower than the log, which repeats it until it is new.
        new = np.r_[True, (np.diff(value, axis=0) != 0).any(axis=1)] if sensor == "magnetic_field" else slice(None)
        sensors[sensor] = Stream(_FIELDS[sensor][0], stamp[new], value[new] * scale)
    return assemble(sensors, {}, request, name=path.stem, notes=tuple(notes))


def info(path: Path) -> LogInfo:
    """As `magyc_gtsam.io.info`, of a Blackbox log; `problem` is left to the caller."""
    flight = _flight(path, 1)
    span = (0.0, float(flight.time[-1] - flight.time[0]) / 1e6)
    firmware = str(flight.headers.get("Firmware revision", flight.headers.get("Firmware type", "")))
    sources = tuple(
        Source(_FIELDS[sensor][0], "fields", len(value), span, (sensor,))
        for sensor, value in flight.sensors.items()
    )
    return LogInfo(str(path), f"Blackbox ({shortened(firmware)})" if firmware else "Blackbox", span[1], sources)


def _scale(sensor: str, headers: Mapping[str, Any], path: Path) -> float:
    """To SI: deg/s by gyro_scale, and g by acc_1G; the magnetometer's is the caller's."""
    fine = _HIGH_RESOLUTION if headers.get("blackbox_high_resolution") == 1 else 1.0
    if sensor == "angular_rate":
        logged = headers.get("gyro_scale", "0x3f800000")
        try:
            bits = int(logged, 16) if isinstance(logged, str) else int(logged)
            scale = float(np.array(bits, dtype=np.uint32).view(np.float32))
        except (OverflowError, TypeError, ValueError):
            scale = math.nan
        if not 0 < scale < 100:
            raise MagycError(
                f"{path}: gyro_scale in the header must be between 0 and 100 deg/s per count, got {shortened(logged)}"
            )
        return math.radians(scale) / fine
    if sensor == "acceleration":
        one = headers.get("acc_1G", 0)
        if not isinstance(one, int | float) or one <= 0:
            raise MagycError(f"{path}: acc_1G {one!r} in the header is no number of counts per g")
        return _GRAVITY / one
    return 1.0


def _flight(path: Path, wanted: int) -> _Flight:
    try:
        from orangebox import Parser
    except ImportError:
        raise MagycError(
            f"{path}: Blackbox logs need orangebox; install it with: pip install 'magyc-gtsam[blackbox]'"
        ) from None
    try:
        parser = Parser.load(str(path), wanted, allow_invalid_header=True)
        names = list(parser.field_names)
        places = {sensor: place for sensor in _FIELDS if (place := _places(names, sensor)) is not None}
        columns = [names.index("time"), *(i for place in places.values() for i in place)]
        rows: list[list[float]] = []
        whole = True
        try:
            rows.extend([frame.data[i] for i in columns] for frame in parser.frames())
        except (RuntimeError, IndexError):  # the power was cut: the log has no end, and what was read is good
            whole = False
        table = np.array(rows, dtype=np.float64).reshape(-1, len(columns))
        headers, count = dict(parser.headers), parser.reader.log_count
    except Exception as error:  # what the library raises at damaged bytes depends on the bytes
        raise MagycError(f"{path}: not a Blackbox log that can be read ({shortened(error)})") from error
    table = table[np.isfinite(table).all(axis=1)]
    table = table[
        np.diff(np.maximum.accumulate(table[:, 0]), prepend=-np.inf) > 0
    ]  # damaged frames go back in time
    if not len(table):
        raise MagycError(f"{path}: log {wanted} of {count} holds no frame")
    sensors = {sensor: table[:, 1 + 3 * k : 4 + 3 * k] for k, sensor in enumerate(places)}
    return _Flight(headers, table[:, 0], sensors, count, whole)


def _places(names: list[str], sensor: str) -> list[int] | None:
    for field in _FIELDS[sensor]:
        axes = [f"{field}[{axis}]" for axis in range(3)]
        if set(axes) <= set(names):
            return [names.index(axis) for axis in axes]
    return None
