"""Samples as lines of JSON, as another program pipes them in."""

from __future__ import annotations

import os
import select

from magyc_gtsam.io.request import Request
from magyc_gtsam.live.lines import SourceOfLines
from magyc_gtsam.live.source import NewSamples, nothing

_AT_ONCE = 1 << 16  # bytes


class JsonLines(SourceOfLines):
    """Samples from a pipe, a terminal or a file of JSON lines; a `LiveSource`.

    Args:
        descriptor: of the open file, read without buffering; 0 for standard input.
        request: units.
        name: what to call it.
    """

    def __init__(self, descriptor: int, request: Request, name: str = "standard input") -> None:
        super().__init__(name, request)
        self._descriptor = descriptor

    def read(self, wait: float = 0.0) -> NewSamples:
        """As `LiveSource.read`."""
        if not select.select([self._descriptor], [], [], wait)[0]:
            return nothing()
        data = os.read(self._descriptor, _AT_ONCE)
        self.ended = not data
        self.received += len(data)
        return self._lines.take(data, last=self.ended)

    def close(self) -> None:
        """The descriptor is the caller's."""
