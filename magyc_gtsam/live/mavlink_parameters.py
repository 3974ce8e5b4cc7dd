"""Read and write the parameters of a vehicle over MAVLink."""

from __future__ import annotations

import re
import struct
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Any

import numpy as np

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.live.mavlink import ADDRESS, BAUD

_HEARTBEAT_TIMEOUT, _ANSWER_TIMEOUT = 10.0, 1.0  # s
_TRIES = 4
_INT32, _REAL32 = 6, 9  # MAV_PARAM_TYPE
_INTEGERS = range(1, 9)  # of MAV_PARAM_TYPE
_ARMED, _GROUND_STATION = 128, 6  # MAV_MODE_FLAG_SAFETY_ARMED, MAV_TYPE_GCS
_AUTOPILOTS = {"ardupilot": 3, "px4": 12}  # MAV_AUTOPILOT
_ADDRESS = re.compile(r"mavlink://([^?]+)(?:\?baud=(\d{1,8}))?")


@dataclass(frozen=True)
class VehicleSetting:
    """A parameter to write: its name, its value, and whether it is an integer parameter."""

    name: str
    value: float
    whole: bool


def settings_of(text: str, target: str) -> list[VehicleSetting]:
    """Return the parameters in an export for "ardupilot" or "px4", in their order."""
    rows = [line for line in text.splitlines() if line and not line.startswith("#")]
    if target == "px4":
        cells = (row.split("\t") for row in rows)
        return [VehicleSetting(name, float(value), int(kind) == _INT32) for _, _, name, value, kind in cells]
    pairs = (row.split(",") for row in rows)
    return [VehicleSetting(name, float(value), "." not in value) for name, value in pairs]


class VehicleParameters:
    """The parameters of the first vehicle that sends a heartbeat.

    PX4 transfers integers as the bytes of a float, ArduPilot as their values (MAVLink, parameter protocol).

    Args:
        source: mavlink://udpin:HOST:PORT, as for `online`.
        target: "ardupilot" or "px4".

    Raises:
        MagycError: pymavlink is not installed, the connection fails, no vehicle answers, it runs another autopilot, or
            it is armed.
    """

    def __init__(self, source: str, target: str) -> None:
        self.name = source
        match = _ADDRESS.fullmatch(source)
        if not match or not ADDRESS.fullmatch(match[1]):
            raise MagycError(f"{source}: write it as mavlink://udpin:127.0.0.1:14550, or mavlink:///dev/ttyACM0")
        if target not in _AUTOPILOTS:
            raise MagycError(f"{target}: only {' and '.join(_AUTOPILOTS)} take parameters over MAVLink")
        with needs(source, "pymavlink", "ardupilot"):
            from pymavlink import mavutil
        baud = int(match[2] or BAUD)
        try:
            with redirect_stdout(sys.stderr):  # pymavlink prints its errors to standard output
                self._link: Any = mavutil.mavlink_connection(match[1], baud=baud, dialect="ardupilotmega")
        except Exception as error:  # sockets, serial ports and pymavlink raise no common class
            raise MagycError(f"{source}: cannot be opened ({shortened(error)})") from error
        self._target = target
        try:
            self._address = self._find_vehicle()
        except MagycError:
            self.close()
            raise

    def read(self, name: str) -> float | None:
        """Return the present value; None if the vehicle does not answer, as for an unknown name."""
        return self._ask(
            name, lambda: self._link.mav.param_request_read_send(*self._address, name.encode(), -1), None
        )

    def write(self, setting: VehicleSetting) -> float | None:
        """Write a parameter, and return the value that the vehicle confirms; None if it does not answer."""
        value, kind = setting.value, _INT32 if setting.whole else _REAL32
        encoded = struct.unpack("<f", struct.pack("<i", int(value)))[0] if self._as_bytes(kind) else value
        name = setting.name.encode()
        return self._ask(
            setting.name, lambda: self._link.mav.param_set_send(*self._address, name, encoded, kind), value
        )

    def close(self) -> None:
        """Close the connection."""
        self._link.close()

    def _as_bytes(self, kind: int) -> bool:
        """Return whether values of a MAV_PARAM_TYPE are transferred as the bytes of a float."""
        return self._target == "px4" and kind in _INTEGERS

    def _find_vehicle(self) -> tuple[int, int]:
        """Wait for a heartbeat, check the vehicle, and return its system and component."""
        until = time.monotonic() + _HEARTBEAT_TIMEOUT
        while time.monotonic() < until:
            heartbeat = self._link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.5)
            if heartbeat is None or heartbeat.type == _GROUND_STATION:
                continue
            if heartbeat.autopilot != _AUTOPILOTS[self._target]:
                raise MagycError(f"{self.name}: the vehicle does not run {self._target}; nothing was written")
            if heartbeat.base_mode & _ARMED:
                raise MagycError(f"{self.name}: the vehicle is armed; disarm it first. Nothing was written")
            return heartbeat.get_srcSystem(), heartbeat.get_srcComponent()
        raise MagycError(
            f"{self.name}: no heartbeat of a vehicle within {_HEARTBEAT_TIMEOUT:g} s; is it the right address?"
        )

    def _ask(self, name: str, send: Callable[[], None], expected: float | None) -> float | None:
        """Send a request until a value of the parameter arrives, the expected one if given; return the last value."""
        value: float | None = None
        for _ in range(_TRIES):
            send()
            until = time.monotonic() + _ANSWER_TIMEOUT
            while (remaining := until - time.monotonic()) > 0:
                answer = self._link.recv_match(type="PARAM_VALUE", blocking=True, timeout=remaining)
                if answer is None or answer.param_id != name or answer.get_srcSystem() != self._address[0]:
                    continue
                value = answer.param_value
                if self._as_bytes(answer.param_type):
                    value = float(struct.unpack("<i", struct.pack("<f", value))[0])
                if expected is None or is_that(value, expected):
                    return value
        return value


def is_that(value: float | None, expected: float) -> bool:
    """Return whether a value equals the expected one in the single precision of parameters."""
    return value is not None and np.float32(value) == np.float32(expected)
