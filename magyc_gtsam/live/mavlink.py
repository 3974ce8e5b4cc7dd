"""Samples from an autopilot that speaks MAVLink: HIGHRES_IMU, RAW_IMU or SCALED_IMU, in the units of the message.

The stamps are the message's own; where an autopilot leaves them at zero, those of arrival. TIMESYNC says how long
a message is on its way.
"""

from __future__ import annotations

import re
import sys
import time
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Any

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.mavlink_messages import FILTERED, MESSAGES
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.arrival import ArrivalClock
from magyc_gtsam.live.source import SENSORS, NewSamples, none, nothing
from magyc_gtsam.recording import Samples

BAUD = 57600
ADDRESS = re.compile(r"(?:udp|udpin|udpout|tcp|tcpin):[\w.-]*:\d{1,5}|/dev/[\w./-]+|COM\d{1,3}")
_UPDATED = {"magnetic_field": 0x1C0, "angular_rate": 0x38}  # bits of HIGHRES_IMU.fields_updated
_LISTEN = 1.0  # s in which it is heard which messages there are, before one is chosen
_ASK = 1.0  # s between two TIMESYNC
_AT_ONCE = 2000  # messages of one batch

_Which = tuple[int, str, int]  # system, message, instance


@dataclass(frozen=True)
class _Row:
    """One message: its own stamp and its arrival, s; the sensors that were measured, in SI."""

    stamp: float
    arrived: float
    values: dict[str, list[float]]


class MavlinkSource:
    """Samples from a MAVLink connection; a `LiveSource`. Of several vehicles or messages the best one is followed.

    Args:
        address: udpin:HOST:PORT, udpout:…, tcp:…, tcpin:…, or a serial port.
        request: as everywhere; `sensors` may name the message, units are the message's own unless told.
        baud: of a serial port, bits per second.

    Raises:
        MagycError: here or from `read`: pymavlink is not installed, an address that cannot be used, or a lost link.
    """

    def __init__(self, address: str, request: Request, baud: int = BAUD) -> None:
        if not ADDRESS.fullmatch(address):
            raise MagycError(
                f"mavlink://{address}: write it as mavlink://udpin:127.0.0.1:14550, or name a serial port"
            )
        try:
            from pymavlink import mavutil
        except ImportError:
            raise MagycError(
                f"mavlink://{address}: needs pymavlink; install it with: pip install 'magyc-gtsam[ardupilot]'"
            ) from None
        self.name = f"mavlink://{address}"
        self.ended = False
        self.received = 0
        self.notes: list[str] = []
        self.round_trip: float | None = None
        wanted = {name for sensor in SENSORS if (name := request.named(sensor)) is not None}
        if not wanted <= set(MESSAGES) or len(wanted) > 1:
            raise MagycError(
                f"{self.name}: name one of {', '.join(MESSAGES)} for both sensors, not {' and '.join(wanted)}"
            )
        self._wanted = next(iter(wanted), None)
        self._request, self._arrival = request, ArrivalClock()
        try:
            with redirect_stdout(sys.stderr):  # the library speaks there of its troubles
                self._link: Any = mavutil.mavlink_connection(
                    address, baud=baud, dialect="ardupilotmega", robust_parsing=True
                )
        except Exception as error:  # as sockets, serial ports and the library raise them
            raise MagycError(f"{self.name}: cannot be opened ({shortened(error)})") from error
        self._bad = 0
        self._heard: dict[_Which, list[_Row]] = {}
        self._since: float | None = None
        self._chosen: _Which | None = None
        self._by_arrival = False
        self._asked = -np.inf

    @property
    def lost(self) -> int:
        """Messages that the sequence numbers miss, and bytes that were no message."""
        return int(self._link.mav_loss) + self._bad

    @property
    def waiting_for(self) -> str:
        """As `LiveSource.waiting_for`."""
        if self._chosen is not None:
            return ""
        listed = ", ".join(sorted(self._link.messages.keys() - {"HOME", "MAV"})) or "nothing"
        return f"none of {self._wanted or ', '.join(MESSAGES)} with both sensors yet; heard so far: {listed[:200]}"

    def read(self, wait: float = 0.0) -> NewSamples:
        """As `LiveSource.read`."""
        rows: list[_Row] = []
        with redirect_stdout(sys.stderr):
            try:
                messages = self._messages(wait)
            except Exception as error:  # as above
                raise MagycError(f"{self.name}: the link is gone ({shortened(error)})") from error
            for message in messages:
                self._look(message, rows)
        if self._chosen is None:
            rows = self._choose()
        return self._batch(rows)

    def close(self) -> None:
        """Let go of the connection."""
        self._link.close()

    def _messages(self, wait: float) -> list[Any]:
        found: list[Any] = []
        while len(found) < _AT_ONCE and (message := self._link.recv_msg()) is not None:
            found.append(message)
        if not found and wait > 0:
            self._link.select(wait)
            return self._messages(0.0)
        if found and time.monotonic() - self._asked > _ASK:
            self._asked = time.monotonic()
            self._link.mav.timesync_send(0, time.monotonic_ns())
        return found

    def _look(self, message: Any, rows: list[_Row]) -> None:
        """Put a message with samples to `rows` where it is the chosen one, or to what was heard before one was."""
        kind = message.get_type()
        if kind == "BAD_DATA":
            self._bad += 1
            return
        self.received += len(message.get_msgbuf())
        if kind == "TIMESYNC" and message.tc1 > 0:
            waited = (time.monotonic_ns() - message.ts1) / 1e9
            self.round_trip = waited if 0 <= waited < 60 else self.round_trip
        if kind not in MESSAGES or (self._wanted is not None and kind != self._wanted):
            return
        which = (message.get_srcSystem(), kind, getattr(message, "id", 0))
        if self._chosen not in (None, which):
            return
        name, nanoseconds, sensors = MESSAGES[kind]
        updated = getattr(message, "fields_updated", 0)
        values = {}
        for sensor in SENSORS:
            fields, unit = sensors[sensor]
            numbers = [getattr(message, field) for field in fields]
            measured = not updated or updated & _UPDATED[sensor] == _UPDATED[sensor]
            if measured and (sensor != "magnetic_field" or any(numbers)):
                scale = self._request.scale(sensor, unit)[0]
                values[sensor] = [number * scale for number in numbers]
        row = _Row(getattr(message, name) * nanoseconds / 1e9, self._arrival.now(), values)
        if self._chosen is not None:
            rows.append(row)
            return
        self._since = row.arrived if self._since is None else self._since
        self._heard.setdefault(which, []).append(row)

    def _choose(self) -> list[_Row]:
        """The rows of the best message heard so far; none before it is time to choose."""
        if self._since is None or self._arrival.now() - self._since < _LISTEN:
            return []
        order = list(MESSAGES)
        whole = [w for w, rows in self._heard.items() if all(any(s in r.values for r in rows) for s in SENSORS)]
        if not whole:
            self._heard = {which: rows[-100:] for which, rows in self._heard.items()}
            return []
        self._chosen = min(whole, key=lambda w: (order.index(w[1]), w[0], w[2]))
        rows, self._heard = self._heard[self._chosen], {}
        self._by_arrival = len(rows) > 1 and all(row.stamp == rows[0].stamp for row in rows)
        others = sorted({which[0] for which in whole} - {self._chosen[0]})
        self.notes.append(FILTERED)
        if self._by_arrival:
            self.notes.append(f"{self.name}: {self._chosen[1]} brings no time; the times of arrival are taken")
        if others:
            self.notes.append(f"{self.name}: vehicle {self._chosen[0]} is listened to, and not {others}")
        return rows

    def _batch(self, rows: list[_Row]) -> NewSamples:
        if not rows:
            return nothing()
        stamps = [self._arrival(row.arrived) if self._by_arrival else row.stamp for row in rows]
        parts = []
        for sensor in SENSORS:
            table = np.array(
                [[t, *row.values[sensor]] for t, row in zip(stamps, rows, strict=True) if sensor in row.values]
            )
            parts.append(Samples(table[:, 0], table[:, 1:]) if len(table) else none())
        return NewSamples(*parts)
