"""Samples in MAVLink messages: the messages of magnetometers, the sensor that sent one, and what it measured anew."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

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
FILTERED = "telemetry: the readings include the autopilot's calibration"
_UPDATED = {"magnetic_field": 0x1C0, "angular_rate": 0x38, "acceleration": 0x7}  # of HIGHRES_IMU.fields_updated


class Sender(NamedTuple):
    """The sensor that sends a message: the MAVLink system and component, and the `id` of messages that have one."""

    system: int
    component: int
    instance: int

    def __str__(self) -> str:
        return f"system {self.system}, component {self.component}, id {self.instance}"


def sender_of(message: Any) -> Sender:
    """Return the sensor that sent one of `MESSAGES`."""
    return Sender(message.get_srcSystem(), message.get_srcComponent(), getattr(message, "id", 0))


def stamp_of(message: Any) -> int:
    """Return the stamp of one of `MESSAGES` in ns."""
    name, nanoseconds, _ = MESSAGES[message.get_type()]
    return int(getattr(message, name)) * nanoseconds


def values_of(message: Any) -> dict[str, list[float]]:
    """Return {sensor: x, y, z} in the message's units; without sensors that it repeats or lacks.

    HIGHRES_IMU says in `fields_updated` what is new (0 if the autopilot does not fill it in), and a magnetometer that
    is absent reads zero.
    """
    updated = getattr(message, "fields_updated", 0)
    values = {}
    for sensor, (fields, _) in MESSAGES[message.get_type()][2].items():
        numbers = [getattr(message, field) for field in fields]
        measured = not updated or updated & _UPDATED[sensor] == _UPDATED[sensor]
        if measured and (sensor != "magnetic_field" or any(numbers)):
            values[sensor] = numbers
    return values


def note_of_senders(read: Sender, heard: Iterable[Sender]) -> tuple[str, ...]:
    """Return the note that one of several sensors is read; () if it is the only one."""
    others = sorted(set(heard) - {read})
    return (f"{read} is read; ignored: {'; '.join(map(str, others))}",) if others else ()
