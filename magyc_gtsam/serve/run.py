"""Run the server until it is interrupted."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable
from pathlib import Path

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.live.line_sources import LOOPBACK
from magyc_gtsam.serve.limits import Limits


def serve(folder: Path, port: int, host: str | None, limits: Limits, ready: Callable[[str], None]) -> None:
    """Serve a folder of logs.

    Args:
        folder: folder of logs; `results/` is created in it.
        port: port to listen on; 0 chooses a free one.
        host: address to listen on; None for loopback only, without a token.
        limits: bounds on requests, jobs and uploads.
        ready: called with the address to open, once the server listens.

    Raises:
        MagycError: the extra is not installed, the folder does not exist, or the address cannot be listened on.
    """
    with needs("the server", "starlette, uvicorn and websockets", "serve"):
        import uvicorn

        from magyc_gtsam.serve.application import Server, guarded
    if not folder.is_dir():
        raise MagycError(f"--folder {folder}: no such folder")
    family = socket.AF_INET6 if host is not None and ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host or LOOPBACK, port), family=family, backlog=128)
    except (OSError, OverflowError) as error:
        raise MagycError(
            f"{host or LOOPBACK}:{port}: cannot be listened on ({error}); choose another --port, or as --host an "
            "address of this machine"
        ) from None
    port = listening.getsockname()[1]
    token = None if host is None else secrets.token_urlsafe(24)
    config = uvicorn.Config(
        guarded(Server(folder, limits), token, port),
        log_level="warning",
        access_log=False,
        proxy_headers=False,
        server_header=False,
        limit_concurrency=limits.connections,
        ws_max_size=limits.message,
        ws_per_message_deflate=False,
        timeout_keep_alive=10,
        timeout_graceful_shutdown=5,
    )
    name = f"[{host}]" if host is not None and ":" in host else host or LOOPBACK
    if name in ("0.0.0.0", "[::]"):
        name = socket.gethostname()
    ready(f"http://{name}:{port}/" + ("" if token is None else f"?token={token}"))
    uvicorn.Server(config).run(sockets=[listening])
