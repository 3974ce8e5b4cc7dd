"""The web application: the request handlers of every address of the server."""

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
from magyc_gtsam.serve.orders import order, reading, source_of
from magyc_gtsam.serve.page import page
from magyc_gtsam.serve.ports import serial_ports
from magyc_gtsam.serve.results import details
from magyc_gtsam.serve.safety import Guard
from magyc_gtsam.serve.store import Store, StoreFull

# A report's own script may run, but cannot reach this server, the network or the page beside it.
_REPORT = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:; form-action 'none'; "
    "base-uri 'none'; frame-ancestors 'none'; sandbox allow-scripts allow-modals allow-popups"
)


class Server:
    """The state of a server, and the handlers of its requests.

    Args:
        folder: folder of logs; `results/` is created in it.
        limits: bounds on requests, jobs and uploads.
    """

    def __init__(self, folder: Path, limits: Limits) -> None:
        self.limits = limits
        self.store = Store(folder, limits)
        self.events = Events(self.snapshot, limits)
        self.jobs = Jobs(self.store.folder, limits, self.events.changed, self._done)
        self.live = Live(self.store.folder, self.events.changed, self._frozen)
        interrupted = next(
            (each for each in self.store.result_folders().values() if (each / STATE).exists()), None
        )
        if interrupted is not None:
            self.live.adopt(interrupted)

    def snapshot(self) -> dict[str, Any]:
        """Return the state that changes while the page is open, as JSON types."""
        return {"jobs": self.jobs.listed(), "live": self.live.snapshot()}

    def _frozen(self, folder: Path, last: dict[str, Any] | None) -> None:
        """Record the outcome of a live run for the page."""
        last = last or {}
        trusted = bool(last.get("converged")) and last.get("exit_code") == 0
        sentence = None if trusted else f"✘ Not yet: {last.get('sentence', 'no samples came')}"
        record = {"logs": self.live.source, "sentence": sentence, "trusted": trusted}
        self.store.keep(folder, record)

    def _done(self, job: Job) -> None:
        """Record the outcome of a job for the page."""
        if job.folder is None:
            return
        verdict = _verdict(job.result)
        record = {"logs": job.title, "interval": job.extra.get("interval"), **verdict}
        self.store.keep(job.folder, record)
        self.store.discard_empty(job.folder)

    async def page(self, request: Request) -> Response:
        """Return the page, and prepare the processes of its first jobs."""
        self.jobs.prepare()
        text, policy = page(request.headers["host"])
        return HTMLResponse(text, headers={"Content-Security-Policy": policy})

    async def state(self, request: Request) -> Response:
        """Return the state that the page starts from."""
        logs = await run_in_threadpool(self.store.logs)
        folders = await run_in_threadpool(self.store.result_folders)
        results = [found for folder in folders.values() if (found := self.store.described(folder))]
        state = {
            "version": __version__,
            "folder": self.store.folder.name,
            "logs": [log.to_dict() for log in logs.values()],
            "results": results,
            "most": self.limits.upload,
        }
        return JSONResponse(state | self.snapshot())

    async def upload(self, request: Request) -> Response:
        """Store an uploaded log, streaming it to the disk."""
        length = request.headers.get("content-length")
        size = int(length) if length is not None and length.isdecimal() else None
        most = self.limits.upload
        if size is not None and size > most:
            raise HTTPException(
                413, f"the log has {size} bytes, at most {most} are accepted; put it into the folder instead"
            )
        with self.store.arriving(request.query_params.get("name", "log"), size) as (key, path):
            with open(path, "wb") as file:
                received = 0
                stream = aiter(request.stream())
                while True:
                    try:
                        part = await asyncio.wait_for(anext(stream), self.limits.stall)
                    except StopAsyncIteration:
                        break
                    except (ClientDisconnect, asyncio.TimeoutError):
                        raise HTTPException(408, "the upload broke off; drop the log again") from None
                    received += len(part)
                    if received > most:
                        raise HTTPException(
                            413, f"at most {most} bytes are accepted; put the log into the folder instead"
                        )
                    if received % (64 << 20) < len(part):  # once per 64 MiB
                        self.store.room_for(0)
                    await run_in_threadpool(file.write, part)
            if not received:
                raise HTTPException(400, "the log is empty")
        return JSONResponse(self.store.logs()[key].to_dict(), 201)

    async def remove(self, request: Request) -> Response:
        """Remove an uploaded log."""
        if not await run_in_threadpool(self.store.remove, request.path_params["key"]):
            raise HTTPException(404, "no uploaded log has this key; reload the page")
        return JSONResponse({})

    async def start(self, request: Request) -> Response:
        """Start a job."""
        ordered = order(await self._body(request), await run_in_threadpool(self.store.logs), self.limits)
        folder = None if ordered.kind == "look" else self.store.new_result(ordered.title, ordered.kind)
        interval = None if ordered.start is None and ordered.end is None else [ordered.start, ordered.end]
        try:
            job = self.jobs.start(
                ordered.kind,
                ordered.title,
                ordered.arguments(None if folder is None else str(folder)),
                folder,
                logs=[log.key for log in ordered.logs],
                interval=interval,
            )
        except MagycError:
            if folder is not None:
                self.store.discard_empty(folder)
            raise
        return JSONResponse(job.to_dict(), 201)

    async def live_run(self, request: Request) -> Response:
        """Start, freeze or resume a live run."""
        asked = await self._body(request)
        action = asked.get("do") if isinstance(asked, dict) else None
        if action == "start":
            source = source_of(asked.get("source"), await run_in_threadpool(self.store.logs))
            arguments = reading(asked)
            self.live.expect_none()  # before the folder of a result is made
            await self.live.start(self.store.new_result(asked["source"]["kind"], "live"), source, arguments)
        elif action == "freeze":
            await self.live.freeze()
        elif action == "go on":
            await self.live.resume()
        else:
            raise MagycError('do: must be "start", "freeze" or "go on"')
        return JSONResponse(self.live.snapshot())

    async def ports(self, request: Request) -> Response:
        """Return the serial ports that can be chosen."""
        return JSONResponse({"ports": await run_in_threadpool(serial_ports)})

    async def _body(self, request: Request) -> Any:
        data = b""
        async for part in request.stream():
            data += part
            if len(data) > self.limits.body:
                raise HTTPException(413, f"the request is longer than {self.limits.body} bytes")
        try:
            return json.loads(data)
        except (ValueError, RecursionError):
            raise HTTPException(400, "the request is not JSON") from None

    def _job(self, request: Request) -> Job:
        job = self.jobs.all.get(request.path_params["key"])
        if job is None:
            raise HTTPException(404, "no such job")
        return job

    async def job(self, request: Request) -> Response:
        """Return the state of a job, with the output of a "look"."""
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
        folder = self.store.result_folders().get(request.path_params["key"])
        if folder is None:
            raise HTTPException(404, "no such result")
        return folder

    async def result(self, request: Request) -> Response:
        """Return the numbers and texts of a result."""
        folder = self._folder(request)
        described = self.store.described(folder) | {"details": self.store.record(folder).get("details")}
        known = {name: value for name, value in described.items() if value is not None}
        return JSONResponse(await run_in_threadpool(details, folder, known.get("trusted")) | known)

    async def file(self, request: Request) -> Response:
        """Return a file of a result: an HTML page to display, any other file as a download."""
        folder = self._folder(request)
        path = {path.name: path for path in folder.iterdir() if path.is_file()}.get(request.path_params["name"])
        if path is None or path.name.startswith("."):
            raise HTTPException(404, "no such file")
        if path.suffix == ".html":
            headers = {"Content-Security-Policy": _REPORT, "Cross-Origin-Opener-Policy": "unsafe-none"}
            return FileResponse(path, media_type="text/html", headers=headers)
        return FileResponse(path, media_type="application/octet-stream", filename=path.name)

    def application(self) -> Starlette:
        """Return the application with all its routes, without the guard."""

        @asynccontextmanager
        async def lifespan(_: Starlette) -> AsyncIterator[None]:
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
        handlers: Any = {HTTPException: _http_problem, MagycError: _refused, StoreFull: _full}
        application = Starlette(routes=routes, lifespan=lifespan, exception_handlers=handlers)
        application.router.redirect_slashes = False
        return application


def guarded(server: Server, token: str | None, port: int) -> Guard:
    """Return the application behind its guard, as it is served."""
    return Guard(server.application(), token, f"magyc_gtsam_{port}")


async def _http_problem(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"problem": error.detail}, error.status_code, headers={"Connection": "close"})


async def _refused(request: Request, error: Exception) -> Response:
    return JSONResponse({"problem": str(error)}, 400)


async def _full(request: Request, error: Exception) -> Response:
    return JSONResponse({"problem": str(error)}, 507, headers={"Connection": "close"})


def _verdict(result: Any) -> dict[str, Any]:
    """Return "sentence", "trusted" and "details" from a command's JSON; None for each that it lacks."""
    names = ("sentence", "trusted", "details")
    if not isinstance(result, dict):
        return dict.fromkeys(names)
    for name in ("judgement", "verdict"):  # a gap has a verdict of one word beside its judgement
        judgement = result.get(name)
        if isinstance(judgement, dict):
            return {name: judgement.get(name) for name in names}
    return dict.fromkeys(names) | {"sentence": result.get("sentence")}
