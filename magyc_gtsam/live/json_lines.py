"""Samples that another program pipes in as lines of JSON."""

from __future__ import annotations

import os
import select
import sys

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.lines import SourceOfLines
from magyc_gtsam.live.source import NewSamples, nothing

_LARGEST_READ = 1 << 16  # bytes


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
