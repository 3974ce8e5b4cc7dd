"""Samples in lines of text from a pipe, from datagrams or from a serial port."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import sys

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.arrival import ArrivalClock
from magyc_gtsam.live.lines import SourceOfLines
from magyc_gtsam.live.source import NewSamples, nothing

LOOPBACK = "127.0.0.1"
BAUD = 115200
_LARGEST_READ = 1 << 16  # bytes
_LARGEST_BATCH = 1000  # datagrams
_RECEIVE_BUFFER = 4 << 20  # bytes that the system keeps while nobody reads
_LARGEST_DATAGRAM = 65535  # bytes
_MOST_STRANGERS = 10  # other senders that are noted


class UdpLines(SourceOfLines):
    """Samples from UDP datagrams; a `LiveSource`. Only datagrams of the first sender are read.

    Args:
        host: address to listen on; "" for this machine only (127.0.0.1), "0.0.0.0" for every network.
        port: port number; 0 takes a free one, which the attribute `port` holds.
        request: units.

    Raises:
        MagycError: the address cannot be listened on.
    """

    def __init__(self, host: str, port: int, request: Request) -> None:
        self._sender: str | None = None
        self._strangers: set[str] = set()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        try:
            self._socket.bind((host or LOOPBACK, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise MagycError(
                f"udp://{host}:{port}: cannot be listened on ({error}); name a free port and an address of this machine"
            ) from None
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]
        super().__init__(f"udp://{host or LOOPBACK}:{self.port}", request)

    def read(self, wait: float = 0.0) -> NewSamples:
        """Return the new samples; see `LiveSource.read`."""
        if not select.select([self._socket], [], [], wait)[0]:
            return nothing()
        parts = []
        for _ in range(_LARGEST_BATCH):
            try:
                data, (sender, _port) = self._socket.recvfrom(_LARGEST_DATAGRAM)
            except BlockingIOError:  # all that has arrived is read
                break
            except ConnectionResetError:  # Windows reports an earlier datagram that was not delivered
                continue
            self._sender = self._sender or sender
            if sender != self._sender:
                if sender not in self._strangers and len(self._strangers) < _MOST_STRANGERS:
                    self._strangers.add(sender)
                    self.notes.append(f"{self.name}: {self._sender} is read; datagrams from {sender} are ignored")
                continue
            self.received += len(data)
            parts.append(data if data.endswith(b"\n") else data + b"\n")
        return self._lines.take(b"".join(parts))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class JsonLines(SourceOfLines):
    """Samples from a pipe, a terminal or a file of JSON lines; a `LiveSource`.

    Args:
        descriptor: file descriptor, read without buffering; 0 for standard input.
        request: units.
        name: the source's name in messages.

    Raises:
        MagycError: standard input is closed; another file may have its number then.
    """

    def __init__(self, descriptor: int, request: Request, name: str = "standard input") -> None:
        if descriptor == 0 and sys.stdin is None:
            raise MagycError(f"{name}: is closed; pipe lines of JSON into it")
        super().__init__(name, request)
        self._descriptor = descriptor

    def read(self, wait: float = 0.0) -> NewSamples:
        """Return the new samples; see `LiveSource.read`."""
        if not select.select([self._descriptor], [], [], wait)[0]:
            return nothing()
        data = os.read(self._descriptor, _LARGEST_READ)
        self.ended = not data
        self.received += len(data)
        return self._lines.take(data, last=self.ended)

    def close(self) -> None:
        """Do nothing: the descriptor belongs to the caller."""


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
