"""What the server allows at most."""

from __future__ import annotations

from dataclasses import dataclass

GIGABYTE = 1 << 30


@dataclass(frozen=True)
class Limits:
    """Bounds, each against one way to exhaust the machine.

    Attributes:
        upload: bytes of one log; the largest public flight logs have about 1 GB.
        uploads: logs kept at a time.
        upload_age: s after which an upload is removed.
        stall: s without a byte after which an upload is given up.
        spare: bytes that stay free on the disk.
        jobs: waiting and running ones together.
        kept: finished jobs that are remembered.
        job_seconds: s after which a job is stopped; an hour at 400 Hz takes `gap` some minutes.
        output: bytes of JSON that a job may give.
        connections: at a time, of which one page takes two.
        sockets: web sockets at a time.
        message: bytes of a message on a web socket; the page sends none.
        body: bytes of a request that is not an upload.
        history: logs of one history.
    """

    upload: int = 2 * GIGABYTE
    uploads: int = 30
    upload_age: float = 24 * 3600.0
    stall: float = 30.0
    spare: int = GIGABYTE // 4
    jobs: int = 20
    kept: int = 50
    job_seconds: float = 3600.0
    output: int = 64 << 20
    connections: int = 64
    sockets: int = 16
    message: int = 4096
    body: int = 64 << 10
    history: int = 200
