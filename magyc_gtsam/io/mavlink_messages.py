"""The MAVLink messages that carry a magnetometer (common.xml): their fields, times and units."""

from __future__ import annotations

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
