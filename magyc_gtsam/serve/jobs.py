"""Run jobs, each the ordinary command line in its own process: one per core, the others wait."""

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

_PATIENCE = 10.0  # s between interrupting a job and killing it
_LINES = 20  # last lines of a job's standard error that are kept
_REST = 1.0  # s after the last job until the next processes start, so that its page is drawn first
_WAITING = 2  # processes that wait for a job: an uploaded log is inspected and calibrated
ACTIVE = ("waiting", "running")


@dataclass
class Job:
    """One run of a command.

    Attributes:
        key: identifier that the page uses.
        kind: the command, of `orders.KINDS`.
        title: name of the log, or number of logs.
        arguments: arguments of the command line.
        folder: folder of its results; None without results.
        extra: further values for the page.
        state: "waiting", "running", "done", "failed" or "cancelled".
        stage, share: present stage, and the share of it that is done, 0 to 1.
        stage_begun: s since 1970, of the present stage; 0 for not yet.
        code: exit code; None before the end.
        messages: last lines on standard error that are not progress.
        result: the JSON that the command printed.
        process: the running process.
        cancelled: whether the job was cancelled.
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
    stage_begun: float = 0.0
    code: int | None = None
    messages: deque[str] = field(default_factory=lambda: deque(maxlen=_LINES))
    result: Any = None
    process: asyncio.subprocess.Process | None = None
    cancelled: bool = False

    def to_dict(self, ahead: int = 0) -> dict[str, Any]:
        """Return the job as JSON types for the page, without its result; `ahead` jobs wait before it."""
        spent = time.time() - self.stage_begun
        remaining = spent * (1 - self.share) / self.share if self.share > 0.05 and spent > 0.5 else None
        return {
            "key": self.key,
            "kind": self.kind,
            "title": self.title,
            "state": self.state,
            "stage": self.stage,
            "share": self.share,
            "left_s": remaining if self.state == "running" else None,
            "ahead": ahead,
            "code": self.code,
            "message": self.message,
            "result": self.folder.name if self.folder is not None and self.folder.is_dir() else None,
            **self.extra,
        }

    @property
    def message(self) -> str:
        """Return the last line on standard error, without the program's name and the folders of the logs."""
        return self.without_folders(self.messages[-1].removeprefix("magyc-gtsam: ")) if self.messages else ""

    def without_folders(self, text: str) -> str:
        """Return the text with each path of a log replaced by the log's name, as the page shows it."""
        for argument in self.arguments:
            if os.sep in argument:
                text = text.replace(argument, Path(argument).name)
        return text


class Jobs:
    """A queue of jobs, of which one per core runs at a time.

    Args:
        place: folder in which the jobs run.
        limits: bounds on number, time and output.
        changed: called when the state of a job changes.
        done: called with each job that has ended.
    """

    def __init__(
        self,
        place: Path,
        limits: Limits,
        changed: Callable[[], None],
        done: Callable[[Job], None],
    ) -> None:
        self.all: dict[str, Job] = {}
        self._limits, self._changed, self._done = limits, changed, done
        count = os.cpu_count() or 1  # that run at a time
        self._free = asyncio.Semaphore(count)
        self._workers = Workers(place, min(count, _WAITING))
        self._tasks: set[asyncio.Task[None]] = set()

    def start(self, kind: str, title: str, arguments: Sequence[str], folder: Path | None, **extra: Any) -> Job:
        """Append a job to the queue and return it.

        Raises:
            MagycError: too many jobs wait or run.
        """
        if sum(job.state in ACTIVE for job in self.all.values()) >= self._limits.jobs:
            raise MagycError(
                f"at most {self._limits.jobs} jobs can wait or run; wait for one to end or cancel one"
            )
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
        """Start processes that do their imports for the next jobs, if no job is active."""
        if not any(job.state in ACTIVE for job in self.all.values()):
            task = asyncio.create_task(self._workers.prepare())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    def listed(self) -> list[dict[str, Any]]:
        """Return all jobs as JSON types, the latest first, with the number of jobs that wait before each."""
        waiting = [key for key, job in self.all.items() if job.state == "waiting"]
        jobs = reversed(self.all.values())
        return [job.to_dict(waiting.index(job.key) + 1 if job.key in waiting else 0) for job in jobs]

    def cancel(self, job: Job) -> None:
        """Interrupt a job as Ctrl-C does; terminate it at a second call, and kill it after ten seconds."""
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
                job.state = "running"
                self._changed()
                try:
                    await asyncio.wait_for(self._process(job), self._limits.job_seconds)
                except asyncio.TimeoutError:
                    job.messages.append(f"stopped after {self._limits.job_seconds:g} s")
                except OSError as error:
                    job.messages.append(str(error))
                finally:
                    if job.process is not None:
                        await ended(job.process)
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
        if job.cancelled:  # cancelled while the process was starting
            end(job.process)
        assert job.process.stdout is not None
        assert job.process.stderr is not None
        output, _ = await asyncio.gather(
            _read(job.process.stdout, self._limits.output), self._listen(job, job.process.stderr)
        )
        job.code = await job.process.wait()
        with contextlib.suppress(ValueError):  # no JSON: the job failed and its messages say why
            job.result = json.loads(output)

    async def _listen(self, job: Job, stream: asyncio.StreamReader) -> None:
        while True:
            try:
                line = await stream.readline()
            except ValueError:  # longer than the limit of the stream: not progress
                continue
            if not line:
                return
            try:
                progress = json.loads(line)
                stage, share = str(progress["stage"]), float(progress["share"])
            except (ValueError, TypeError, KeyError):  # not progress: a message
                if text := line.decode("utf-8", "replace").strip():
                    job.messages.append(text[:1000])
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
