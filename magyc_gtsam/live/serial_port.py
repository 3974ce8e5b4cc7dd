"""Samples from a serial port: lines of JSON, or MotionCal's `Raw:` lines."""

from __future__ import annotations

import contextlib

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.arrival import ArrivalClock
from magyc_gtsam.live.lines import SourceOfLines
from magyc_gtsam.live.source import NewSamples, nothing

BAUD = 115200


class SerialLines(SourceOfLines):
    """Samples from a serial port; a `LiveSource`. The incomplete line at the start is left out.

    Args:
        port: the port's name, such as /dev/ttyUSB0 or COM3.
        baud: bits per second.
        request: units; by default those of the counts in MotionCal's lines.

    Raises:
        MagycError: here or from `read`: pyserial is not installed, the port cannot be opened, or it is lost.
    """

    def __init__(self, port: str, baud: int, request: Request) -> None:
        with needs(port, "pyserial", "serial"):
            import serial
        self._problems = (serial.SerialException, OSError)
        try:
            self._port = serial.Serial(port, baud, timeout=0)
        except (*self._problems, ValueError) as error:
            raise MagycError(f"{port}: cannot be opened at {baud} baud ({error}); is it the right port?") from None
        super().__init__(port, request, ArrivalClock())
        self._synchronised = False  # whether the start of a line has been seen

    def read(self, wait: float = 0.0) -> NewSamples:
        """Return the new samples; see `LiveSource.read`."""
        try:
            self._port.timeout = wait
            data = self._port.read(1)
            if data and (more := self._port.in_waiting):
                data += self._port.read(more)
        except self._problems as error:
            raise MagycError(
                f"{self.name}: the port is lost ({error}); plug it in and start again with the same --state"
            ) from None
        if not data:
            return nothing()
        self.received += len(data)
        if not self._synchronised:
            line, newline, after = data.partition(b"\n")
            complete = line.lstrip().startswith((b"{", b"Raw:"))
            self._synchronised = bool(newline) or complete
            data = data if complete else after
        return self._lines.take(data)

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(*self._problems):  # closing a port that was unplugged fails, and changes nothing
            self._port.close()
