"""The live run: `magyc-gtsam online` in a process of its own, its state in a file that outlives page and server."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.serve.workers import end, started
from magyc_gtsam.storage.whole_file import write_text

CALIBRATION, STATE, RUN = "online-calibration.yaml", "online.state", "live.json"
_PICTURE, _EVERY = 0.4, 5.0  # s between two pictures, and two writings of calibration and state
_LINE = 1 << 20  # bytes of a line
_PATIENCE = 15.0  # s in which a run writes its files and ends


class Live:
    """At most one run at a time; it begins at once, whatever jobs there are.

    Args:
        place: folder in which it runs.
        changed: called whenever there is something to show.
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
        self._said: deque[str] = deque(maxlen=5)
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None

    def snapshot(self) -> dict[str, Any]:
        """For the page."""
        return {
            "state": self.state,
            "source": self.source,
            "result": None if self.folder is None else self.folder.name,
            "said": list(self._said),
            "latest": self.latest,
        }

    def found(self, folder: Path) -> None:
        """Take up a run that an earlier server left, without going on with it."""
        try:
            run = json.loads((folder / RUN).read_text(encoding="utf-8"))
            self.source, self._arguments = str(run["source"]), tuple(map(str, run["arguments"]))
        except (OSError, ValueError, KeyError, TypeError):
            return  # not ours
        self.folder, self.state = folder, "frozen"

    async def start(self, folder: Path, source: str, arguments: Sequence[str]) -> None:
        """Begin a run.

        Args:
            folder: for its files; there.
            source: of `magyc-gtsam online`.
            arguments: units and topics.

        Raises:
            MagycError: there is one already.
        """
        self._refuse_two()
        self.folder, self.source, self._arguments = folder, source, tuple(arguments)
        self.latest = None
        run = {"source": source, "arguments": list(arguments), "begun": time.time()}
        write_text(folder / RUN, json.dumps(run))
        await self._begin()

    async def go_on(self) -> None:
        """Go on with the run that was frozen, from its state, bit for bit.

        Raises:
            MagycError: there is none, or it runs.
        """
        self._refuse_two()
        if self.folder is None or not self.folder.is_dir():
            raise MagycError("there is no run to go on with; start a new one")
        await self._begin()

    async def freeze(self) -> None:
        """End the run; calibration and state are written."""
        if self._process is None or self._task is None or self._task.done():
            return
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGINT)
        await asyncio.wait([self._task], timeout=_PATIENCE)
        if not self._task.done():
            end(self._process)
            await self._task

    def _refuse_two(self) -> None:
        if self.state == "running":
            raise MagycError("a live run is going on; freeze it first")

    async def _begin(self) -> None:
        assert self.folder is not None
        self.state = "running"
        self._said.clear()
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
            self._process = await started("magyc_gtsam.cli", arguments, self._place, line=_LINE)
        except OSError as error:
            self._said.append(str(error))
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
            with contextlib.suppress(ValueError):
                self.latest = json.loads(line)
                self._changed()

    async def _listen(self, stream: asyncio.StreamReader) -> None:
        while line := await _line(stream):
            self._said.append(line.decode("utf-8", "replace").strip().removeprefix("magyc-gtsam: ")[:500])
            self._changed()


async def _line(stream: asyncio.StreamReader) -> bytes:
    """The next line, b"" at the end; one that is too long is a line without content."""
    try:
        return await stream.readline()
    except ValueError:
        return b"\n"
