"""Processes for jobs, started before there is a job."""

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
    """A module of this package in a process of its own, its progress in lines of at most `line` bytes."""
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
        count: that wait at a time.
    """

    def __init__(self, place: Path, count: int) -> None:
        self._place, self._count = place, count
        self._waiting: list[Process] = []
        self._closed = False

    async def prepare(self) -> None:
        """Let as many wait as should."""
        self._waiting = [process for process in self._waiting if process.returncode is None]
        with contextlib.suppress(OSError):  # the job that needs one says why
            while not self._closed and len(self._waiting) < self._count:
                self._waiting.append(await self._started())
        if self._closed:
            await self.close()

    async def run(self, arguments: Sequence[str]) -> Process:
        """A process that runs the command line with these arguments; its output is piped.

        Raises:
            OSError: no process can be started.
        """
        alive = [process for process in self._waiting if process.returncode is None]
        process = alive[0] if alive else await self._started()
        self._waiting = alive[1:]
        assert process.stdin is not None
        process.stdin.write(json.dumps(list(arguments)).encode() + b"\n")
        process.stdin.close()
        return process

    async def close(self) -> None:
        """End those that wait, and see that they are gone."""
        self._closed = True
        waiting, self._waiting = self._waiting, []
        await asyncio.gather(*map(ended, waiting))

    async def _started(self) -> Process:
        return await started("magyc_gtsam.cli.worker", (), self._place, stdin=asyncio.subprocess.PIPE)


def end(process: Process) -> None:
    """End a process and those it started, if they are still there."""
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)


async def ended(process: Process) -> None:
    """End a process, if it is still there, and wait until it is gone and its pipes are closed."""
    end(process)
    await process.communicate()
