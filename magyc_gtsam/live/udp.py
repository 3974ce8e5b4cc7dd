"""Samples in UDP datagrams, each with one or more complete lines of JSON."""

from __future__ import annotations

import select
import socket

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.lines import SourceOfLines
from magyc_gtsam.live.source import NewSamples, nothing

LOOPBACK = "127.0.0.1"
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
