"""The channels of a PX4 log beside its sensors, and which of them PX4 can correct a compass by."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.px4_messages import Array, Message
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


def channels_of(messages: list[Message], request: Request) -> dict[str, Stream]:
    """Return the channels that the log has."""
    result = {}
    for name in request.channels if request.channels is not None else CHANNELS:
        found = _channel(messages, name)
        if found is not None:
            message, value = found
            result[name] = Stream(name, np.asarray(message.data["timestamp"]).astype(np.int64) * 1000, value)
        elif request.channels is not None:
            raise MagycError(f"channels: the log has no {name!r}; write them as message.field")
    return result


def _channel(messages: list[Message], name: str) -> tuple[Message, Array] | None:
    """Return the message of a channel and its values (n,); None if the log does not have it."""
    label, _, member = name.partition(".")
    for message in messages:
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
