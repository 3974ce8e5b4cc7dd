"""Jobs: the ordinary command line in processes of its own, one per core, the others waiting."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import signal
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.serve.limits import Limits
from magyc_gtsam.serve.workers import Workers, end, ended

_PATIENCE = 10.0  # s between asking a job to end, and ending it
_LINES = 20  # of what a job said, kept
_REST = 1.0  # s after the last job, in which its page is drawn, until the next processes start
_WAITING = 2  # processes that wait for a job: a dropped log is looked at and calibrated
ACTIVE = ("waiting", "running")


@dataclass
class Job:
    """One run of a command.

    Attributes:
        key: by which the page names it.
        kind: the command.
        title: what it is about.
        arguments: of the command line.
        folder: where its results go, None for none.
        state: "waiting", "running", "done", "failed" or "cancelled".
        stage, share: what it is at, and how far that is, 0 to 1.
        begun, stage_begun, ended: s since 1970; 0 for not yet.
        code: exit code.
        said: last lines on standard error that were no progress.
        result: its JSON.
    """

    key: str
    kind: str
    title: str
    arguments: tuple[str, ...]
    folder: Path | None
    extra: dict[str, Any] = field(default_factory=dict)
    state: str = "waiting"
    stage: str = ""
    share: float = 0.0
    begun: float = 0.0
    stage_begun: float = 0.0
    ended: float = 0.0
    code: int | None = None
    said: deque[str] = field(default_factory=lambda: deque(maxlen=_LINES))
    result: Any = None
    process: asyncio.subprocess.Process | None = None
    cancelled: bool = False

    def to_dict(self, ahead: int = 0) -> dict[str, Any]:
        """For the page, without the result."""
        spent = time.time() - self.stage_begun
        left = spent * (1 - self.share) / self.share if self.share > 0.05 and spent > 0.5 else None
        return {
            "key": self.key,
            "kind": self.kind,
            "title": self.title,
            "state": self.state,
            "stage": self.stage,
            "share": self.share,
            "left_s": left if self.state == "running" else None,
            "ahead": ahead,
            "code": self.code,
            "message": self.message,
            "result": self.folder.name if self.folder is not None and self.folder.is_dir() else None,
            **self.extra,
        }

    @property
    def message(self) -> str:
        """The last line on standard error, without the program's name and the folders of the log."""
        return self.without_folders(self.said[-1].removeprefix("magyc-gtsam: ")) if self.said else ""

    def without_folders(self, text: str) -> str:
        """A text in which each log is called by its name alone, as the page knows it."""
        for argument in self.arguments:
            if os.sep in argument:
                text = text.replace(argument, Path(argument).name)
        return text


class Jobs:
    """A queue of jobs.

    Args:
        place: folder in which they run.
        limits: of number, time and output.
        changed: called whenever there is something to show.
        done: called with a job that has ended.
        at_once: jobs that run at a time.
    """

    def __init__(
        self,
        place: Path,
        limits: Limits,
        changed: Callable[[], None],
        done: Callable[[Job], None],
        at_once: int | None = None,
    ) -> None:
        self.all: dict[str, Job] = {}
        self._limits, self._changed, self._done = limits, changed, done
        count = at_once or os.cpu_count() or 1
        self._free = asyncio.Semaphore(count)
        self._workers = Workers(place, min(count, _WAITING))
        self._tasks: set[asyncio.Task[None]] = set()

    def start(self, kind: str, title: str, arguments: Sequence[str], folder: Path | None, **extra: Any) -> Job:
        """Put a job behind the others.

        Raises:
            MagycError: too many.
        """
        if sum(job.state in ACTIVE for job in self.all.values()) >= self._limits.jobs:
            raise MagycError(f"{self._limits.jobs} jobs wait or run already; wait for one, or cancel it")
        job = Job(secrets.token_hex(6), kind, title, tuple(arguments), folder, extra)
        self.all[job.key] = job
        for key in [key for key, each in self.all.items() if each.state not in ACTIVE][: -self._limits.kept]:
            del self.all[key]
        task = asyncio.create_task(self._run(job))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self._changed()
        return job

    def prepare(self) -> None:
        """Let processes do their imports for the next jobs, while nothing else is to be done."""
        if not any(job.state in ACTIVE for job in self.all.values()):
            task = asyncio.create_task(self._workers.prepare())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    def listed(self) -> list[dict[str, Any]]:
        """All jobs, the latest first, with the number of those that wait before them."""
        waiting = [key for key, job in self.all.items() if job.state == "waiting"]
        jobs = reversed(self.all.values())
        return [job.to_dict(waiting.index(job.key) + 1 if job.key in waiting else 0) for job in jobs]

    def cancel(self, job: Job) -> None:
        """Ask a job to end, as Ctrl-C does; a second time, or after ten seconds, it is ended."""
        if job.state not in ACTIVE:
            return
        again, job.cancelled = job.cancelled, True
        if job.process is not None and job.process.returncode is None:
            job.process.send_signal(signal.SIGTERM if again else signal.SIGINT)
            asyncio.get_running_loop().call_later(_PATIENCE, end, job.process)
        self._changed()

    async def close(self) -> None:
        """End all jobs."""
        await self._workers.close()
        for job in list(self.all.values()):
            self.cancel(job)
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=2 * _PATIENCE)

    async def _run(self, job: Job) -> None:
        async with self._free:
            if not job.cancelled:
                job.state, job.begun = "running", time.time()
                self._changed()
                try:
                    await asyncio.wait_for(self._process(job), self._limits.job_seconds)
                except asyncio.TimeoutError:
                    job.said.append(f"stopped after {self._limits.job_seconds:g} s")
                except OSError as error:
                    job.said.append(str(error))
                finally:
                    if job.process is not None:
                        await ended(job.process)
        job.ended = time.time()
        if job.cancelled:
            job.state = "cancelled"
        else:
            job.state = "done" if job.code in (0, 1) else "failed"
        self._done(job)
        self._changed()
        if not any(each.state in ACTIVE for each in self.all.values()):
            asyncio.get_running_loop().call_later(_REST, self.prepare)

    async def _process(self, job: Job) -> None:
        job.process = await self._workers.run(job.arguments)
        if job.cancelled:  # while it was being started
            end(job.process)
        assert job.process.stdout is not None
        assert job.process.stderr is not None
        output, _ = await asyncio.gather(
            _read(job.process.stdout, self._limits.output), self._listen(job, job.process.stderr)
        )
        job.code = await job.process.wait()
        with contextlib.suppress(ValueError):  # no JSON: it failed, and said why
            job.result = json.loads(output)

    async def _listen(self, job: Job, stream: asyncio.StreamReader) -> None:
        while True:
            try:
                line = await stream.readline()
            except ValueError:  # longer than a line is
                continue
            if not line:
                return
            try:
                said = json.loads(line)
                stage, share = str(said["stage"]), float(said["share"])
            except (ValueError, TypeError, KeyError):
                if text := line.decode("utf-8", "replace").strip():
                    job.said.append(text[:1000])
                continue
            if stage != job.stage:
                job.stage, job.stage_begun = stage, time.time()
            job.share = min(max(share, 0.0), 1.0)
            self._changed()


async def _read(stream: asyncio.StreamReader, most: int) -> bytes:
    parts, size = [], 0
    while part := await stream.read(1 << 16):
        size += len(part)
        if size <= most:
            parts.append(part)
    return b"".join(parts) if size <= most else b""
