"""Reader of MAVLink telemetry logs (.tlog), which hold the messages that a ground station received."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Recording

_GRAVITY = 9.80665  # m/s²

Fields = dict[str, tuple[tuple[str, ...], float]]
_MILLI: Fields = {
    "magnetic_field": (("xmag", "ymag", "zmag"), 1e-7),
    "angular_rate": (("xgyro", "ygyro", "zgyro"), 1e-3),
    "acceleration": (("xacc", "yacc", "zacc"), _GRAVITY * 1e-3),
}
_HIGHRES: Fields = {
    "magnetic_field": (("xmag", "ymag", "zmag"), 1e-4),
    "angular_rate": (("xgyro", "ygyro", "zgyro"), 1.0),
    "acceleration": (("xacc", "yacc", "zacc"), 1.0),
}
# {message: (its field of time, ns per unit of it, {sensor: (fields, their unit in SI)})}, best first. Autopilots fill
# RAW_IMU in the units of SCALED_IMU.
MESSAGES: dict[str, tuple[str, int, Fields]] = {
    "HIGHRES_IMU": ("time_usec", 1_000, _HIGHRES),
    "RAW_IMU": ("time_usec", 1_000, _MILLI),
    **{f"SCALED_IMU{k}": ("time_boot_ms", 1_000_000, _MILLI) for k in ("", "2", "3")},
}
FILTERED = "telemetry: the field includes the autopilot's calibration"


def read(path: Path, request: Request) -> Recording:
    """Read a telemetry log; see `magyc_gtsam.io.read`.

    Raises:
        MagycError: pymavlink is not installed, or the log has no magnetometer.
    """
    request.only("MAVLink", clock="the vehicle's stamps")
    rows = _rows(path, request)
    listed = ", ".join(f"{k} ({len(v)} messages)" for k, v in rows.items()) or "none"
    sensors = {}
    notes = [FILTERED]
    for sensor in ("magnetic_field", "angular_rate", "acceleration"):
        named = request.named(sensor)
        usable = [k for k in MESSAGES if k in rows and (rows[k][:, _column(sensor)] != 0).any()]
        if named is not None and named not in rows:
            raise MagycError(f"{sensor}: no message {named!r}; the log has {listed}")
        if named is None and not usable:
            continue
        kind = named or max(usable, key=lambda k: len(rows[k]))
        scale = request.scale(sensor, MESSAGES[kind][2][sensor][1], notes)
        stamp = rows[kind][:, 0].astype(np.int64) * MESSAGES[kind][1]
        sensors[sensor] = Stream(kind, stamp, rows[kind][:, _column(sensor)].astype(np.float64) * scale)
    if "magnetic_field" not in sensors:
        raise MagycError(f"{path}: no magnetometer in the log; readable messages: {listed}")
    return assemble(sensors, {}, request, name=path.stem, notes=tuple(notes))


def info(path: Path) -> LogInfo:
    """Describe a telemetry log; see `magyc_gtsam.io.info`, which sets `problem`."""
    rows = _rows(path, Request())
    sources = []
    for kind, values in rows.items():
        span = (0.0, float(values[-1, 0] - values[0, 0]) * MESSAGES[kind][1] / 1e9)
        serves = tuple(s for s in MESSAGES[kind][2] if (values[:, _column(s)] != 0).any())
        sources.append(Source(kind, kind, len(values), span, serves))
    return LogInfo(
        str(path), "MAVLink telemetry", max((s.span[1] for s in sources if s.span), default=0), tuple(sources)
    )


def _column(sensor: str) -> slice:
    """Return the columns of a sensor in the rows of `_rows`."""
    first = 1 + 3 * ("magnetic_field", "angular_rate", "acceleration").index(sensor)
    return slice(first, first + 3)


def _rows(path: Path, request: Request) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Return {message: (n, 10)}, stamp and three sensors in the message's units, of the vehicle with most messages."""
    with needs(f"{path}", "pymavlink", "ardupilot"):
        from pymavlink import mavutil
    vehicles: dict[int, dict[str, list[tuple[float, ...]]]] = {}
    try:
        log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega", notimestamps=False)
        while (message := log.recv_match(type=list(MESSAGES))) is not None:
            kind = message.get_type()
            time, _, sensors = MESSAGES[kind]
            values = [getattr(message, f) for fields, _ in sensors.values() for f in fields]
            rows = vehicles.setdefault(message.get_srcSystem(), {}).setdefault(kind, [])
            rows.append((getattr(message, time), *values))
            request.report(log.percent / 100)
        log.close()
    except Exception as error:  # the exceptions of pymavlink on damaged bytes have no common class
        raise MagycError(f"{path}: the telemetry log cannot be read ({shortened(error)})") from error
    if not vehicles:
        raise MagycError(f"{path}: holds none of {', '.join(MESSAGES)}, which have a magnetometer")
    vehicle = max(vehicles.values(), key=lambda kinds: sum(map(len, kinds.values())))
    return {kind: np.array(rows, dtype=np.float64) for kind, rows in vehicle.items()}
