"""The channels of a PX4 log beside its sensors, and which of them PX4 can correct a compass by."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Literal

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.px4_messages import Array, Message, device_of
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream

CHANNELS = (
    "battery_status.current_a",
    "battery_status.voltage_v",
    "actuator_controls_0.control[3]",
    "vehicle_thrust_setpoint.xyz",
    "sensor_mag.temperature",
    "sensor_combined.baro_temp_celcius",
    "vehicle_air_data.baro_temp_celcius",
)
_THRUST = "vehicle_thrust_setpoint.xyz"  # its length, by which PX4 corrects a compass since 1.14


def channels_of(messages: list[Message], request: Request, own: Collection[Message]) -> dict[str, Stream]:
    """Return the channels that the log has.

    Args:
        messages: of the log.
        request: with the names of other channels.
        own: raw messages of the sensors that are read, whose thermometers are taken before those of others.
    """
    result = {}
    for name in request.channels if request.channels is not None else CHANNELS:
        found = _channel(messages, name, own)
        if found is not None:
            message, value = found
            result[name] = Stream(name, np.asarray(message.data["timestamp"]).astype(np.int64) * 1000, value)
        elif request.channels is not None:
            raise MagycError(f"channels: the log has no {name!r}; write them as message.field")
    return result


def own_of(messages: list[Message], kind: Literal["mag", "gyro"], label: str) -> Message | None:
    """Return the raw message of the sensor from which a message comes; None if the log does not tell.

    Args:
        messages: of the log.
        kind: of the sensor.
        label: of the message that is read.
    """
    source = next((m for m in messages if m.label == label), None)
    if source is None or source.name == f"sensor_{kind}":
        return source
    try:
        device = device_of(source, messages, kind)
    except MagycError:  # of several sensors
        return None
    of_kind = (m for m in messages if m.name == f"sensor_{kind}" and m.count and "device_id" in m.data)
    return next((m for m in of_kind if device is not None and int(m.data["device_id"][0]) == device), None)


def thermometers_of(
    messages: list[Message], channels: Collection[str], own: Mapping[str, Message | None]
) -> dict[str, str]:
    """Return `Autopilot.thermometers` of the channels, by the raw message of each sensor; "" of another's."""
    result: dict[str, str] = {}
    for name in channels:
        found = _channel(messages, name, [m for m in own.values() if m is not None])
        if name.partition(".")[2] == "temperature" and found is not None:
            result[name] = next((sensor for sensor, message in own.items() if message is found[0]), "")
    return result


def _channel(messages: list[Message], name: str, own: Collection[Message] = ()) -> tuple[Message, Array] | None:
    """Return the message of a channel and its values (n,); None if the log does not have it."""
    label, _, member = name.partition(".")
    for message in sorted(messages, key=lambda m: not any(m is one for one in own)):
        if label in (message.name, message.label) and message.count > 1:
            thrust = message.vector("xyz[{}]") if f"{message.name}.{member}" == _THRUST else None
            if thrust is not None:
                return message, np.linalg.norm(thrust, axis=1)
            if member in message.data:
                return message, np.asarray(message.data[member], dtype=np.float64)
    return None


def powers_of(messages: list[Message], channels: Collection[str]) -> dict[str, tuple[int, float]]:
    """Return `Autopilot.powers` of the channels: the currents of two batteries, and the throttle."""
    result = {}
    for name in channels:
        found = _channel(messages, name)
        if found is None:
            continue
        message, member = found[0], name.partition(".")[2]
        if message.name == "battery_status" and member == "current_a" and message.instance < 2:
            result[name] = (2 + message.instance, 1.0)
        elif f"{message.name}.{member}" in ("actuator_controls_0.control[3]", _THRUST):
            result[name] = (1, 1.0)
    return result
