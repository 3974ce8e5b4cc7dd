"""The limits of the server."""

from __future__ import annotations

from dataclasses import dataclass

GIGABYTE = 1 << 30


@dataclass(frozen=True)
class Limits:
    """Upper bounds, each of which prevents one way to exhaust the machine.

    Attributes:
        upload: bytes of one log; the largest public flight logs have about 1 GB.
        uploads: number of uploaded logs kept.
        upload_age: s after which an upload is removed.
        stall: s without a byte after which an upload is aborted.
        spare: bytes that stay free on the disk.
        jobs: number of waiting and running jobs.
        kept: number of finished jobs that are remembered.
        job_seconds: s after which a job is stopped; `gap` takes some minutes for an hour at 400 Hz.
        output: bytes of JSON that a job may print.
        connections: number of open connections; a page uses two.
        sockets: number of open web sockets.
        message: bytes of a message on a web socket; the page sends none.
        body: bytes of a request that is not an upload.
        history: number of logs of one history.
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
