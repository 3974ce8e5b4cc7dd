"""Parameters of a vehicle over MAVLink: read, written, and read back."""

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

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.live.mavlink import ADDRESS, BAUD

_HEARTBEAT, _ANSWER = 10.0, 1.0  # s in which a vehicle is heard, and one answer comes
_TRIES = 4
_WHOLE, _REAL = 6, 9  # MAV_PARAM_TYPE_INT32 and REAL32
_INTEGERS = range(1, 9)  # of MAV_PARAM_TYPE
_ARMED, _STATION = 128, 6  # MAV_MODE_FLAG_SAFETY_ARMED, MAV_TYPE_GCS
_AUTOPILOTS = {"ardupilot": 3, "px4": 12}  # MAV_AUTOPILOT
_ADDRESS = re.compile(r"mavlink://([^?]+)(?:\?baud=(\d{1,8}))?")


@dataclass(frozen=True)
class VehicleSetting:
    """A parameter as it shall be: its name, its value, and whether it is a whole number."""

    name: str
    value: float
    whole: bool


def settings_of(text: str, target: str) -> list[VehicleSetting]:
    """The parameters of an export for "ardupilot" or "px4", in their order."""
    rows = [line for line in text.splitlines() if line and not line.startswith("#")]
    if target == "px4":
        cells = (row.split("\t") for row in rows)
        return [VehicleSetting(name, float(value), int(kind) == _WHOLE) for _, _, name, value, kind in cells]
    pairs = (row.split(",") for row in rows)
    return [VehicleSetting(name, float(value), "." not in value) for name, value in pairs]


class VehicleParameters:
    """The parameters of the first vehicle that is heard.

    PX4 sends whole numbers as the bytes of a float, ArduPilot as their values (MAVLink, parameter protocol).

    Args:
        source: mavlink://udpin:HOST:PORT, as of `online`.
        target: "ardupilot" or "px4".

    Raises:
        MagycError: pymavlink is not installed, no connection, nobody is heard, another autopilot, or it is armed.
    """

    def __init__(self, source: str, target: str) -> None:
        self.name = source
        found = _ADDRESS.fullmatch(source)
        if not found or not ADDRESS.fullmatch(found[1]):
            raise MagycError(f"{source}: write it as mavlink://udpin:127.0.0.1:14550, or mavlink:///dev/ttyACM0")
        if target not in _AUTOPILOTS:
            raise MagycError(f"{target}: only {' and '.join(_AUTOPILOTS)} take parameters over MAVLink")
        try:
            from pymavlink import mavutil
        except ImportError:
            raise MagycError(
                f"{source}: needs pymavlink; install it with: pip install 'magyc-gtsam[ardupilot]'"
            ) from None
        baud = int(found[2] or BAUD)
        try:
            with redirect_stdout(sys.stderr):  # the library speaks there of its troubles
                self._link: Any = mavutil.mavlink_connection(found[1], baud=baud, dialect="ardupilotmega")
        except Exception as error:  # as sockets, serial ports and the library raise them
            raise MagycError(f"{source}: cannot be opened ({shortened(error)})") from error
        self._target = target
        try:
            self._meet()
        except MagycError:
            self.close()
            raise

    def read(self, name: str) -> float | None:
        """The value now; None where the vehicle does not answer, as for a name that it does not have."""
        return self._asked(
            name, lambda: self._link.mav.param_request_read_send(*self._address, name.encode(), -1), None
        )

    def write(self, setting: VehicleSetting) -> float | None:
        """Set a parameter; the value that the vehicle then says that it has, None where it does not answer."""
        asked, kind = setting.value, _WHOLE if setting.whole else _REAL
        sent = struct.unpack("<f", struct.pack("<i", int(asked)))[0] if self._as_bytes(kind) else asked
        name = setting.name.encode()
        return self._asked(
            setting.name, lambda: self._link.mav.param_set_send(*self._address, name, sent, kind), asked
        )

    def close(self) -> None:
        """Let go of the connection."""
        self._link.close()

    def _as_bytes(self, kind: int) -> bool:
        return self._target == "px4" and kind in _INTEGERS

    def _meet(self) -> None:
        until = time.monotonic() + _HEARTBEAT
        while time.monotonic() < until:
            heard = self._link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.5)
            if heard is None or heard.type == _STATION:
                continue
            if heard.autopilot != _AUTOPILOTS[self._target]:
                raise MagycError(f"{self.name}: the vehicle there is no {self._target}; nothing was written")
            if heard.base_mode & _ARMED:
                raise MagycError(f"{self.name}: the vehicle is armed; disarm it first. Nothing was written")
            self._address = heard.get_srcSystem(), heard.get_srcComponent()
            return
        raise MagycError(f"{self.name}: no vehicle was heard within {_HEARTBEAT:g} s; is it the right address?")

    def _asked(self, name: str, ask: Callable[[], None], expected: float | None) -> float | None:
        """The last value that comes for a name; asked again where none comes, or another one than is expected."""
        value: float | None = None
        for _ in range(_TRIES):
            ask()
            until = time.monotonic() + _ANSWER
            while (left := until - time.monotonic()) > 0:
                heard = self._link.recv_match(type="PARAM_VALUE", blocking=True, timeout=left)
                if heard is None or heard.param_id != name or heard.get_srcSystem() != self._address[0]:
                    continue
                value = heard.param_value
                if self._as_bytes(heard.param_type):
                    value = float(struct.unpack("<i", struct.pack("<f", value))[0])
                if expected is None or is_that(value, expected):
                    return value
        return value


def is_that(value: float | None, expected: float) -> bool:
    """Whether a parameter, which is held in single precision, has a value."""
    return value is not None and np.float32(value) == np.float32(expected)
