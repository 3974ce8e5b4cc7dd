"""Processes for jobs, started ahead of the jobs so that their imports are done."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
from asyncio.subprocess import Process
from collections.abc import Sequence
from pathlib import Path


async def started(
    module: str,
    arguments: Sequence[str],
    place: Path,
    stdin: int = asyncio.subprocess.DEVNULL,
    line: int = 1 << 16,
) -> Process:
    """Run a module of this package in its own process, which prints progress in lines of at most `line` bytes."""
    return await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        module,
        *arguments,
        cwd=place,
        env=os.environ | {"MAGYC_GTSAM_PROGRESS": "lines", "PYTHONIOENCODING": "utf-8"},
        stdin=stdin,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,
        limit=line,
    )


class Workers:
    """Processes that wait with their imports done; each runs one command.

    Args:
        place: folder in which they run.
        count: number of processes that wait.
    """

    def __init__(self, place: Path, count: int) -> None:
        self._place, self._count = place, count
        self._waiting: list[Process] = []
        self._closed = False
        self._preparing = asyncio.Lock()  # two pages that are opened at once do not start twice as many

    async def prepare(self) -> None:
        """Start processes until `count` of them wait."""
        async with self._preparing:
            self._waiting = [process for process in self._waiting if process.returncode is None]
            with contextlib.suppress(OSError):  # the job that needs a process reports the error
                while not self._closed and len(self._waiting) < self._count:
                    self._waiting.append(await self._started())
        if self._closed:
            await self.close()

    async def run(self, arguments: Sequence[str]) -> Process:
        """Return a process that runs the command line with these arguments; its output is piped.

        Raises:
            OSError: no process could be started.
        """
        alive = [process for process in self._waiting if process.returncode is None]
        process = alive[0] if alive else await self._started()
        self._waiting = alive[1:]
        assert process.stdin is not None
        process.stdin.write(json.dumps(list(arguments)).encode() + b"\n")
        process.stdin.close()
        return process

    async def close(self) -> None:
        """Kill the waiting processes and wait until they are gone."""
        self._closed = True
        waiting, self._waiting = self._waiting, []
        await asyncio.gather(*map(ended, waiting))

    async def _started(self) -> Process:
        return await started("magyc_gtsam.cli.worker", (), self._place, stdin=asyncio.subprocess.PIPE)


def end(process: Process) -> None:
    """Kill a process and its children, if it still runs."""
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):  # it has ended meanwhile
            os.killpg(process.pid, signal.SIGKILL)


async def ended(process: Process) -> None:
    """Kill a process, if it still runs, and wait until it is gone and its pipes are closed."""
    end(process)
    await process.communicate()
