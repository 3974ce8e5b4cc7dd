"""Samples as UDP datagrams, each of one or more whole lines of JSON."""

from __future__ import annotations

import select
import socket

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.lines import SourceOfLines
from magyc_gtsam.live.source import NewSamples, nothing

LOOPBACK = "127.0.0.1"
_AT_ONCE = 1000  # datagrams of one batch
_ROOM = 4 << 20  # bytes that the system is asked to keep while nobody reads
_LARGEST = 65535  # bytes


class UdpLines(SourceOfLines):
    """Samples from datagrams; a `LiveSource`. The first sender is listened to, others are not.

    Args:
        host: address to listen on; "" is this machine alone (127.0.0.1), "0.0.0.0" every network.
        port: number; 0 takes one that is free (`port` says which).
        request: units.

    Raises:
        MagycError: the address cannot be listened on.
    """

    def __init__(self, host: str, port: int, request: Request) -> None:
        self._sender: str | None = None
        self._strange: set[str] = set()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _ROOM)
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
        """As `LiveSource.read`."""
        if not select.select([self._socket], [], [], wait)[0]:
            return nothing()
        parts = []
        for _ in range(_AT_ONCE):
            try:
                data, (sender, _port) = self._socket.recvfrom(_LARGEST)
            except BlockingIOError:
                break
            except ConnectionResetError:  # Windows says so of an answer that nobody took
                continue
            self._sender = self._sender or sender
            if sender != self._sender:
                if sender not in self._strange and len(self._strange) < 10:
                    self._strange.add(sender)
                    self.notes.append(
                        f"{self.name}: {self._sender} is listened to; what {sender} sends is left out"
                    )
                continue
            self.received += len(data)
            parts.append(data if data.endswith(b"\n") else data + b"\n")
        return self._lines.take(b"".join(parts))

    def close(self) -> None:
        """Let go of the port."""
        self._socket.close()
