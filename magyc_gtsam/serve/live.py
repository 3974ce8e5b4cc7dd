"""Run `magyc-gtsam online` in its own process, with its state in a file that outlives page and server."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.serve.workers import end, started
from magyc_gtsam.storage.files import write_text

CALIBRATION, STATE, RUN = "online-calibration.yaml", "online.state", "live.json"
_PICTURE, _EVERY = 0.4, 5.0  # s between two pictures, and between two writes of calibration and state
_LINE = 1 << 20  # most bytes of a line
_PATIENCE = 15.0  # s in which an interrupted run writes its files and ends


class Live:
    """The live run, at most one at a time; it starts at once, however many jobs run.

    Args:
        place: folder in which it runs.
        changed: called when the state changes.
        ended: called with the folder and the last line of a run that has ended.
    """

    def __init__(
        self, place: Path, changed: Callable[[], None], ended: Callable[[Path, dict[str, Any] | None], None]
    ) -> None:
        self.state = "none"  # "running", "frozen" or "failed" otherwise
        self.source = ""
        self.folder: Path | None = None
        self.latest: dict[str, Any] | None = None
        self._arguments: tuple[str, ...] = ()
        self._place, self._changed, self._ended = place, changed, ended
        self._messages: deque[str] = deque(maxlen=5)
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None

    def snapshot(self) -> dict[str, Any]:
        """Return the state as JSON types for the page."""
        return {
            "state": self.state,
            "source": self.source,
            "result": None if self.folder is None else self.folder.name,
            "messages": list(self._messages),
            "latest": self.latest,
        }

    def adopt(self, folder: Path) -> None:
        """Take over a run that an earlier server left, as frozen."""
        try:
            run = json.loads((folder / RUN).read_text(encoding="utf-8"))
            self.source, self._arguments = str(run["source"]), tuple(map(str, run["arguments"]))
        except (OSError, ValueError, KeyError, TypeError):
            return  # no run of this server
        self.folder, self.state = folder, "frozen"

    async def start(self, folder: Path, source: str, arguments: Sequence[str]) -> None:
        """Start a run.

        Args:
            folder: existing folder for its files.
            source: SOURCE of `magyc-gtsam online`.
            arguments: options that give units and topics.

        Raises:
            MagycError: a run is going on.
        """
        self.expect_none()
        self.folder, self.source, self._arguments = folder, source, tuple(arguments)
        self.latest = None
        run = {"source": source, "arguments": list(arguments)}
        write_text(folder / RUN, json.dumps(run))
        await self._begin()

    async def resume(self) -> None:
        """Resume the frozen run from its state, bit for bit.

        Raises:
            MagycError: there is no frozen run, or a run is going on.
        """
        self.expect_none()
        if self.folder is None or not self.folder.is_dir():
            raise MagycError("there is no live run to resume; start a new one")
        await self._begin()

    async def freeze(self) -> None:
        """End the run, which writes calibration and state."""
        if self._process is None or self._task is None or self._task.done():
            return
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            self._process.send_signal(signal.SIGINT)
        await asyncio.wait([self._task], timeout=_PATIENCE)
        if not self._task.done():
            end(self._process)
            await self._task

    def expect_none(self) -> None:
        """Check that no run is going on.

        Raises:
            MagycError: one is.
        """
        if self.state == "running":
            raise MagycError("a live run is going on; freeze it first")

    async def _begin(self) -> None:
        assert self.folder is not None
        self.state = "running"
        self._messages.clear()
        arguments = [
            "online",
            self.source,
            "--json",
            f"--picture={_PICTURE}",
            f"--every={_EVERY}",
            f"--output={self.folder / CALIBRATION}",
            f"--state={self.folder / STATE}",
            *self._arguments,
        ]
        try:
            self._process = await started("magyc_gtsam", arguments, self._place, line=_LINE)
        except OSError as error:
            self._messages.append(str(error))
            self.state = "failed"
        else:
            self._task = asyncio.create_task(self._follow(self._process, self.folder))
        self._changed()

    async def _follow(self, process: asyncio.subprocess.Process, folder: Path) -> None:
        assert process.stdout is not None
        assert process.stderr is not None
        await asyncio.gather(self._show(process.stdout), self._listen(process.stderr))
        code = await process.wait()
        self.state = "frozen" if code in (0, 1, 130) else "failed"
        self._ended(folder, self.latest)
        self._changed()

    async def _show(self, stream: asyncio.StreamReader) -> None:
        while line := await _line(stream):
            with contextlib.suppress(ValueError):  # a line that was cut off
                self.latest = json.loads(line)
                self._changed()

    async def _listen(self, stream: asyncio.StreamReader) -> None:
        while line := await _line(stream):
            self._messages.append(line.decode("utf-8", "replace").strip().removeprefix("magyc-gtsam: ")[:500])
            self._changed()


async def _line(stream: asyncio.StreamReader) -> bytes:
    """Return the next line, b"" at the end of the stream, or an empty line in place of one that is too long."""
    try:
        return await stream.readline()
    except ValueError:
        return b"\n"
