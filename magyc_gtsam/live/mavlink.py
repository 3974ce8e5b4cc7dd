"""Samples from an autopilot over MAVLink: messages HIGHRES_IMU, RAW_IMU or SCALED_IMU.

The stamps are those of the messages, or the times of arrival if the autopilot leaves the stamps at zero. TIMESYNC
measures the delay of the link.
"""

from __future__ import annotations

import re
import sys
import time
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Any

import numpy as np

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.mavlink_samples import (
    FILTERED,
    MESSAGES,
    Sender,
    note_of_senders,
    sender_of,
    stamp_of,
    values_of,
)
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.arrival import ArrivalClock
from magyc_gtsam.live.source import SENSORS, NewSamples, samples_of

BAUD = 57600
ADDRESS = re.compile(r"(?:udp|udpin|udpout|tcp|tcpin):[\w.-]*:\d{1,5}|/dev/[\w./-]+|COM\d{1,3}")
_LISTEN = 1.0  # s during which messages are collected before one kind is chosen
_TIMESYNC_PERIOD = 1.0  # s
_LARGEST_BATCH = 2000  # messages

_Stream = tuple[Sender, str]  # and the message


@dataclass(frozen=True)
class _Row:
    """One message: its stamp and time of arrival in s, and the values of the sensors that it holds, in SI units."""

    stamp: float
    arrived: float
    values: dict[str, list[float]]


class MavlinkSource:
    """Samples from a MAVLink connection; a `LiveSource`. It follows one message of one sender.

    Args:
        address: udpin:HOST:PORT, udpout:…, tcp:…, tcpin:…, or a serial port.
        request: its `sensors` may name the message; its units replace those of the message.
        baud: of a serial port, bits per second.

    Raises:
        MagycError: here or from `read`: pymavlink is not installed, the address cannot be used, or the link is lost.
    """

    def __init__(self, address: str, request: Request, baud: int = BAUD) -> None:
        if not ADDRESS.fullmatch(address):
            raise MagycError(
                f"mavlink://{address}: write it as mavlink://udpin:127.0.0.1:14550, or name a serial port"
            )
        with needs(f"mavlink://{address}", "pymavlink", "ardupilot"):
            from pymavlink import mavutil
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
            with redirect_stdout(sys.stderr):  # pymavlink prints its errors to standard output
                self._link: Any = mavutil.mavlink_connection(
                    address, baud=baud, dialect="ardupilotmega", robust_parsing=True
                )
        except Exception as error:  # sockets, serial ports and pymavlink raise no common class
            raise MagycError(f"{self.name}: cannot be opened ({shortened(error)})") from error
        self._bad = 0
        self._kinds: set[str] = set()  # of all messages
        self._heard: dict[_Stream, list[_Row]] = {}  # before one stream is chosen
        self._since: float | None = None
        self._chosen: _Stream | None = None
        self._by_arrival = False
        self._last_timesync = -np.inf

    @property
    def lost(self) -> int:
        """Number of messages lost by their sequence numbers, and of invalid ones."""
        return int(self._link.mav_loss) + self._bad

    @property
    def waiting_for(self) -> str:
        """The messages that are awaited and those that came instead; see `LiveSource`."""
        if self._chosen is not None:
            return ""
        listed = ", ".join(sorted(self._kinds)) or "nothing"
        return f"none of {self._wanted or ', '.join(MESSAGES)} with both sensors yet; heard so far: {listed[:200]}"

    def read(self, wait: float = 0.0) -> NewSamples:
        """Return the new samples; see `LiveSource.read`."""
        rows: list[_Row] = []
        with redirect_stdout(sys.stderr):
            try:
                messages = self._messages(wait)
            except Exception as error:  # see the constructor
                raise MagycError(
                    f"{self.name}: the link is lost ({shortened(error)}); check it and start again"
                ) from error
            for message in messages:
                self._take(message, rows)
        if self._chosen is None:
            rows = self._choose()
        return self._batch(rows)

    def close(self) -> None:
        """Close the connection."""
        self._link.close()

    def _messages(self, wait: float) -> list[Any]:
        """Return the messages that have arrived, waiting up to `wait` s if there are none; send TIMESYNC if due."""
        messages: list[Any] = []
        while len(messages) < _LARGEST_BATCH and (message := self._link.recv_msg()) is not None:
            messages.append(message)
        if not messages and wait > 0:
            self._link.select(wait)
            return self._messages(0.0)
        if messages and time.monotonic() - self._last_timesync > _TIMESYNC_PERIOD:
            self._last_timesync = time.monotonic()
            self._link.mav.timesync_send(0, time.monotonic_ns())
        return messages

    def _take(self, message: Any, rows: list[_Row]) -> None:
        """Append a message of the chosen stream to `rows`; before one is chosen, keep every message with samples."""
        kind = message.get_type()
        if kind == "BAD_DATA":
            self._bad += 1
            return
        self._kinds.add(kind)
        self.received += len(message.get_msgbuf())
        if kind == "TIMESYNC" and message.tc1 > 0:
            round_trip = (time.monotonic_ns() - message.ts1) / 1e9
            self.round_trip = round_trip if 0 <= round_trip < 60 else self.round_trip
        if kind not in MESSAGES or (self._wanted is not None and kind != self._wanted):
            return
        stream = (sender_of(message), kind)
        if self._chosen not in (None, stream):
            return
        values = {
            sensor: [number * self._request.scale(sensor, MESSAGES[kind][2][sensor][1]) for number in numbers]
            for sensor, numbers in values_of(message).items()
        }
        row = _Row(stamp_of(message) / 1e9, self._arrival.now(), values)
        if self._chosen is not None:
            rows.append(row)
            return
        self._since = row.arrived if self._since is None else self._since
        self._heard.setdefault(stream, []).append(row)

    def _choose(self) -> list[_Row]:
        """Choose the stream to follow, and return its rows so far; empty before it is time to choose."""
        if self._since is None or self._arrival.now() - self._since < _LISTEN:
            return []
        order = list(MESSAGES)
        complete = [
            stream
            for stream, rows in self._heard.items()
            if all(any(s in r.values for r in rows) for s in SENSORS)
        ]
        if not complete:
            self._heard = {stream: rows[-100:] for stream, rows in self._heard.items()}
            return []
        self._chosen = min(complete, key=lambda stream: (order.index(stream[1]), stream[0]))
        rows, self._heard = self._heard[self._chosen], {}
        self._by_arrival = len(rows) > 1 and all(row.stamp == rows[0].stamp for row in rows)
        self.notes.append(FILTERED)
        if self._by_arrival:
            self.notes.append(f"{self.name}: {self._chosen[1]} has no stamps; times of arrival are used instead")
        senders = note_of_senders(self._chosen[0], (sender for sender, _ in complete))
        self.notes += [f"{self.name}: {note}" for note in senders]
        return rows

    def _batch(self, rows: list[_Row]) -> NewSamples:
        stamps = [self._arrival(row.arrived) if self._by_arrival else row.stamp for row in rows]
        return NewSamples(
            *(
                samples_of(
                    [[t, *row.values[sensor]] for t, row in zip(stamps, rows, strict=True) if sensor in row.values]
                )
                for sensor in SENSORS
            )
        )
