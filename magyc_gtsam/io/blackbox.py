"""Reader of Blackbox logs of Betaflight and INAV (.bbl, .bfl, .txt)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.autopilot import without_parameters

_GRAVITY = 9.80665  # m/s²
_FIELDS = {"magnetic_field": ("magADC",), "angular_rate": ("gyroADC",), "acceleration": ("accSmooth", "accADC")}
_HIGH_RESOLUTION = 10.0  # factor of Betaflight's high resolution, of gyroscope and accelerometer
_UNKNOWN_UNIT = (
    "magADC is logged in counts of the compass chip; give the tesla per count (magnetic_unit=1e-7 if 1000 counts are "
    "a gauss), or magnetic_unit='counts' for a method that needs only the magnetometer"
)

_FILTERED = "magADC includes the firmware's compass calibration and alignment"
_AUTOPILOT = without_parameters(
    f"the log is of Betaflight or INAV, and its {_FILTERED}; `magyc-gtsam apply` corrects it"
)


@dataclass(frozen=True)
class _Flight:
    """One log of a file.

    Attributes:
        headers: the header lines.
        time: (n,) µs.
        sensors: {sensor: (n, 3)} as logged.
        count: number of logs in the file.
        whole: whether the log has an end.
    """

    headers: Mapping[str, Any]
    time: Array
    sensors: Mapping[str, Array]
    count: int
    whole: bool


def read(path: Path, request: Request) -> Recording:
    """Read a Blackbox log; see `magyc_gtsam.io.read`. The option `log` selects one of several in a file, from 1.

    Raises:
        MagycError: orangebox is not installed, the log is damaged, or no magnetometer was logged.
    """
    request.only("Blackbox", "log", clock="the flight controller's clock")
    wanted = request.options.get("log", 1)
    if not isinstance(wanted, int) or wanted < 1:
        raise MagycError(f"log: must be a whole number from 1, got {wanted!r}")
    flight = _flight(path, wanted)
    if "magnetic_field" not in flight.sensors:
        raise MagycError(
            f"{path}: no magADC in the log; record again with the compass on and logged (in the Blackbox settings)"
        )
    if request.units.get("magnetic_field") is None:
        raise MagycError(f"{path}: {_UNKNOWN_UNIT}")
    notes = [_FILTERED]
    if flight.count > 1:
        notes.append(f"the file holds {flight.count} logs, this is number {wanted} (log=)")
    if not flight.whole:
        notes.append(f"the log is cut off; {len(flight.time)} frames were read")
    stamp = np.round(flight.time * 1000).astype(np.int64)
    sensors = {}
    for sensor, value in flight.sensors.items():
        scale = request.scale(sensor, _scale(sensor, flight.headers, path), notes)
        # The compass is slower than the log, which repeats the last reading.
        new = np.r_[True, (np.diff(value, axis=0) != 0).any(axis=1)] if sensor == "magnetic_field" else slice(None)
        sensors[sensor] = Stream(_FIELDS[sensor][0], stamp[new], value[new] * scale)
    return assemble(sensors, {}, request, name=path.stem, notes=tuple(notes), autopilot=_AUTOPILOT)


def info(path: Path) -> LogInfo:
    """Describe a Blackbox log; see `magyc_gtsam.io.info`, which sets `problem`."""
    flight = _flight(path, 1)
    span = (0.0, float(flight.time[-1] - flight.time[0]) / 1e6)
    firmware = str(flight.headers.get("Firmware revision", flight.headers.get("Firmware type", "")))
    sources = tuple(
        Source(_FIELDS[sensor][0], "fields", len(value), span, (sensor,))
        for sensor, value in flight.sensors.items()
    )
    return LogInfo(str(path), f"Blackbox ({shortened(firmware)})" if firmware else "Blackbox", span[1], sources)


def _scale(sensor: str, headers: Mapping[str, Any], path: Path) -> float:
    """Return the factor to SI units by gyro_scale and acc_1G of the header; 1 for the magnetometer."""
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
            raise MagycError(
                f"{path}: acc_1G in the header must be a positive number of counts per g, got {one!r}"
            )
        return _GRAVITY / one
    return 1.0


def _flight(path: Path, wanted: int) -> _Flight:
    """Load log number `wanted` of a file."""
    with needs(f"{path}", "orangebox", "blackbox"):
        from orangebox import Parser
    try:
        parser = Parser.load(str(path), wanted, allow_invalid_header=True)
        names = list(parser.field_names)
        places = {sensor: place for sensor in _FIELDS if (place := _places(names, sensor)) is not None}
        columns = [names.index("time"), *(i for place in places.values() for i in place)]
        rows: list[list[float]] = []
        whole = True
        try:
            rows.extend([frame.data[i] for i in columns] for frame in parser.frames())
        except (RuntimeError, IndexError):  # power was cut: the log has no end, but the frames so far are valid
            whole = False
        table = np.array(rows, dtype=np.float64).reshape(-1, len(columns))
        headers, count = dict(parser.headers), parser.reader.log_count
    except Exception as error:  # the exceptions of orangebox on damaged bytes have no common class
        raise MagycError(f"{path}: the Blackbox log cannot be read ({shortened(error)})") from error
    table = table[np.isfinite(table).all(axis=1)]
    ascending = np.diff(np.maximum.accumulate(table[:, 0]), prepend=-np.inf) > 0
    table = table[ascending]  # damaged frames go back in time
    if not len(table):
        raise MagycError(f"{path}: log {wanted} of {count} holds no frame")
    sensors = {sensor: table[:, 1 + 3 * k : 4 + 3 * k] for k, sensor in enumerate(places)}
    return _Flight(headers, table[:, 0], sensors, count, whole)


def _places(names: list[str], sensor: str) -> list[int] | None:
    """Return the places of a sensor's three fields; None if the log has none."""
    for field in _FIELDS[sensor]:
        axes = [f"{field}[{axis}]" for axis in range(3)]
        if set(axes) <= set(names):
            return [names.index(axis) for axis in axes]
    return None
