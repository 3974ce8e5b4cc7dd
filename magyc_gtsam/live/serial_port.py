"""Samples from a serial port: lines of JSON, or MotionCal's `Raw:` lines."""

from __future__ import annotations

import contextlib

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.arrival import ArrivalClock
from magyc_gtsam.live.lines import SourceOfLines
from magyc_gtsam.live.source import NewSamples, nothing

BAUD = 115200


class SerialLines(SourceOfLines):
    """Samples from a port; a `LiveSource`. What the port was in the middle of saying when it was opened is left out.

    Args:
        port: its name, as /dev/ttyUSB0 or COM3.
        baud: bits per second.
        request: units; of MotionCal's lines those of its counts, where none is named.

    Raises:
        MagycError: here or from `read`: pyserial is not installed, no such port, or it is gone.
    """

    def __init__(self, port: str, baud: int, request: Request) -> None:
        try:
            import serial
        except ImportError:
            raise MagycError(
                f"{port}: serial ports need pyserial; install it with: pip install 'magyc-gtsam[serial]'"
            ) from None
        self._problems = (serial.SerialException, OSError)
        try:
            self._port = serial.Serial(port, baud, timeout=0)
        except (*self._problems, ValueError) as error:
            raise MagycError(f"{port}: cannot be opened at {baud} baud ({error}); is it the right port?") from None
        super().__init__(port, request, ArrivalClock())
        self._begun = False

    def read(self, wait: float = 0.0) -> NewSamples:
        """As `LiveSource.read`."""
        try:
            self._port.timeout = wait
            data = self._port.read(1)
            if data and (more := self._port.in_waiting):
                data += self._port.read(more)
        except self._problems as error:
            raise MagycError(
                f"{self.name}: is gone ({error}); plug it in and begin again, with the same --state"
            ) from None
        if not data:
            return nothing()
        self.received += len(data)
        if not self._begun:
            line, end, rest = data.partition(b"\n")
            whole = line.lstrip().startswith((b"{", b"Raw:"))
            self._begun = bool(end) or whole
            data = data if whole else rest
        return self._lines.take(data)

    def close(self) -> None:
        """Let go of the port."""
        with contextlib.suppress(*self._problems):
            self._port.close()
