"""The application: what stands behind every address of the server."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute

from magyc_gtsam import __version__
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.serve.events import Events
from magyc_gtsam.serve.jobs import Job, Jobs
from magyc_gtsam.serve.limits import Limits
from magyc_gtsam.serve.live import STATE, Live
from magyc_gtsam.serve.orders import order, reading
from magyc_gtsam.serve.page import page
from magyc_gtsam.serve.ports import serial_ports
from magyc_gtsam.serve.results import details
from magyc_gtsam.serve.safety import Guard
from magyc_gtsam.serve.sources import source_of
from magyc_gtsam.serve.store import Full, Store

# A report's own script may run, and reach nothing: not this server, not the network, not the page beside it.
_REPORT = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:; form-action 'none'; "
    "base-uri 'none'; frame-ancestors 'none'; sandbox allow-scripts allow-modals allow-popups"
)


class Server:
    """The state of a server, and the answers to its requests.

    Args:
        folder: of logs; `results/` is made in it.
        limits: what is allowed at most.
    """

    def __init__(self, folder: Path, limits: Limits) -> None:
        self.limits = limits
        self.store = Store(folder, limits)
        self.events = Events(self.snapshot, limits)
        self.jobs = Jobs(self.store.folder, limits, self.events.changed, self._done)
        self.live = Live(self.store.folder, self.events.changed, self._frozen)
        left = next((folder for folder in self.store.found().values() if (folder / STATE).exists()), None)
        if left is not None:
            self.live.found(left)

    def snapshot(self) -> dict[str, Any]:
        """What changes while the page is open."""
        return {"jobs": self.jobs.listed(), "live": self.live.snapshot()}

    def _frozen(self, folder: Path, last: dict[str, Any] | None) -> None:
        """Keep what the page will want to know of a live run."""
        last = last or {}
        trusted = bool(last.get("converged")) and last.get("exit_code") == 0
        sentence = None if trusted else f"✘ Not yet: {last.get('sentence', 'no samples came')}"
        record = {"logs": self.live.source, "sentence": sentence, "trusted": trusted}
        self.store.keep(folder, record)

    def _done(self, job: Job) -> None:
        """Keep what the page will want to know of a result."""
        if job.folder is None:
            return
        verdict = _verdict(job.result)
        record = {"logs": job.title, "interval": job.extra.get("interval"), **verdict}
        self.store.keep(job.folder, record)
        self.store.discard_empty(job.folder)

    async def page(self, request: Request) -> Response:
        """The page."""
        text, policy = page(request.headers["host"])
        return HTMLResponse(text, headers={"Content-Security-Policy": policy})

    async def state(self, request: Request) -> Response:
        """Everything that the page begins with."""
        logs = await run_in_threadpool(self.store.logs)
        found = await run_in_threadpool(self.store.found)
        results = [self.store.described(folder) for folder in found.values()]
        state = {
            "version": __version__,
            "folder": self.store.folder.name,
            "logs": [log.to_dict() for log in logs.values()],
            "results": results,
            "most": self.limits.upload,
        }
        return JSONResponse(state | self.snapshot())

    async def upload(self, request: Request) -> Response:
        """A log, streamed to the disk."""
        length = request.headers.get("content-length")
        size = int(length) if length is not None and length.isdecimal() else None
        most = self.limits.upload
        if size is not None and size > most:
            raise HTTPException(
                413, f"{size} bytes, at most {most} are taken; put the log into the folder instead"
            )
        with self.store.arriving(request.query_params.get("name", "log"), size) as (key, path):
            with open(path, "wb") as file:
                came = 0
                stream = aiter(request.stream())
                while True:
                    try:
                        part = await asyncio.wait_for(anext(stream), self.limits.stall)
                    except StopAsyncIteration:
                        break
                    except (ClientDisconnect, asyncio.TimeoutError):
                        raise HTTPException(408, "the upload broke off; drop the log again") from None
                    came += len(part)
                    if came > most:
                        raise HTTPException(
                            413, f"at most {most} bytes are taken; put the log into the folder instead"
                        )
                    if came % (64 << 20) < len(part):
                        self.store.room_for(0)
                    await run_in_threadpool(file.write, part)
            if not came:
                raise HTTPException(400, "the log is empty")
        return JSONResponse(self.store.logs()[key].to_dict(), 201)

    async def remove(self, request: Request) -> Response:
        """Remove a log that was dropped."""
        if not await run_in_threadpool(self.store.remove, request.path_params["key"]):
            raise HTTPException(404, "no such log was dropped")
        return JSONResponse({})

    async def start(self, request: Request) -> Response:
        """Start a job."""
        asked = order(await self._body(request), await run_in_threadpool(self.store.logs), self.limits)
        folder = None if asked.kind == "look" else self.store.new_result(asked.title, asked.kind)
        interval = None if asked.start is None and asked.end is None else [asked.start, asked.end]
        try:
            job = self.jobs.start(
                asked.kind,
                asked.title,
                asked.arguments(None if folder is None else str(folder)),
                folder,
                logs=[log.key for log in asked.logs],
                interval=interval,
            )
        except MagycError:
            if folder is not None:
                self.store.discard_empty(folder)
            raise
        return JSONResponse(job.to_dict(), 201)

    async def live_run(self, request: Request) -> Response:
        """Start a live run, freeze it, or go on with it."""
        asked = await self._body(request)
        what = asked.get("do") if isinstance(asked, dict) else None
        if what == "start":
            source = source_of(asked.get("source"), await run_in_threadpool(self.store.logs))
            arguments = reading(asked)
            if self.live.state == "running":
                raise MagycError("a live run is going on; freeze it first")
            await self.live.start(self.store.new_result(asked["source"]["kind"], "live"), source, arguments)
        elif what == "freeze":
            await self.live.freeze()
        elif what == "go on":
            await self.live.go_on()
        else:
            raise MagycError('do: one of "start", "freeze", "go on" is expected')
        return JSONResponse(self.live.snapshot())

    async def ports(self, request: Request) -> Response:
        """The serial ports that can be chosen."""
        return JSONResponse({"ports": await run_in_threadpool(serial_ports)})

    async def _body(self, request: Request) -> Any:
        data = b""
        async for part in request.stream():
            data += part
            if len(data) > self.limits.body:
                raise HTTPException(413, "this request is too long")
        try:
            return json.loads(data)
        except (ValueError, RecursionError):
            raise HTTPException(400, "this request is not JSON") from None

    def _job(self, request: Request) -> Job:
        job = self.jobs.all.get(request.path_params["key"])
        if job is None:
            raise HTTPException(404, "no such job")
        return job

    async def job(self, request: Request) -> Response:
        """A job, with what it gave."""
        job = self._job(request)
        output = job.result if job.kind == "look" else None
        if isinstance(output, dict) and output.get("problem"):
            output = output | {"problem": job.without_folders(output["problem"])}
        return JSONResponse(job.to_dict() | {"output": output})

    async def cancel(self, request: Request) -> Response:
        """Cancel a job."""
        self.jobs.cancel(self._job(request))
        return JSONResponse({})

    def _folder(self, request: Request) -> Path:
        folder = self.store.found().get(request.path_params["key"])
        if folder is None:
            raise HTTPException(404, "no such result")
        return folder

    async def result(self, request: Request) -> Response:
        """A result in numbers and texts."""
        folder = self._folder(request)
        known = {name: value for name, value in self.store.described(folder).items() if value is not None}
        return JSONResponse(await run_in_threadpool(details, folder, known.get("trusted")) | known)

    async def file(self, request: Request) -> Response:
        """A file of a result: a page to look at, anything else to keep."""
        folder = self._folder(request)
        path = {path.name: path for path in folder.iterdir() if path.is_file()}.get(request.path_params["name"])
        if path is None or path.name.startswith("."):
            raise HTTPException(404, "no such file")
        if path.suffix == ".html":
            headers = {"Content-Security-Policy": _REPORT, "Cross-Origin-Opener-Policy": "unsafe-none"}
            return FileResponse(path, media_type="text/html", headers=headers)
        return FileResponse(path, media_type="application/octet-stream", filename=path.name)

    def application(self) -> Starlette:
        """All of it under its addresses, without the guard."""

        @asynccontextmanager
        async def lifespan(_: Starlette) -> AsyncIterator[None]:
            self.jobs.prepare()
            yield
            await self.live.freeze()
            await self.jobs.close()
            self.store.remove_old(age=0.0)

        routes = [
            Route("/", self.page),
            Route("/api/state", self.state),
            Route("/api/logs", self.upload, methods=["POST"]),
            Route("/api/logs/{key}", self.remove, methods=["DELETE"]),
            Route("/api/jobs", self.start, methods=["POST"]),
            Route("/api/jobs/{key}", self.job, methods=["GET"]),
            Route("/api/jobs/{key}", self.cancel, methods=["DELETE"]),
            Route("/api/live", self.live_run, methods=["POST"]),
            Route("/api/ports", self.ports),
            Route("/api/results/{key}", self.result),
            Route("/results/{key}/{name}", self.file),
            WebSocketRoute("/api/events", self.events.socket),
        ]
        handlers: Any = {HTTPException: _said, MagycError: _refused, Full: _full}
        made = Starlette(routes=routes, lifespan=lifespan, exception_handlers=handlers)
        made.router.redirect_slashes = False
        return made


def guarded(server: Server, token: str | None, port: int) -> Guard:
    """The application as it is served."""
    return Guard(server.application(), token, f"magyc_gtsam_{port}")


async def _said(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"problem": error.detail}, error.status_code, headers={"Connection": "close"})


async def _refused(request: Request, error: Exception) -> Response:
    return JSONResponse({"problem": str(error)}, 400)


async def _full(request: Request, error: Exception) -> Response:
    return JSONResponse({"problem": str(error)}, 507, headers={"Connection": "close"})


def _verdict(result: Any) -> dict[str, Any]:
    """{"sentence", "trusted"} of a command's JSON; None where it has neither."""
    if not isinstance(result, dict):
        return {"sentence": None, "trusted": None}
    for name in ("judgement", "verdict"):  # a gap has a verdict of one word beside its judgement
        judgement = result.get(name)
        if isinstance(judgement, dict):
            return {"sentence": judgement.get("sentence"), "trusted": judgement.get("trusted")}
    return {"sentence": result.get("sentence"), "trusted": None}
