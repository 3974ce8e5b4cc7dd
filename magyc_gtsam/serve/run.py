"""Listen, and serve until somebody has enough."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable
from pathlib import Path

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.serve.limits import Limits

LOOPBACK = "127.0.0.1"


def serve(folder: Path, port: int, host: str | None, limits: Limits, ready: Callable[[str], None]) -> None:
    """Serve a folder of logs.

    Args:
        folder: of logs; `results/` is made in it.
        port: 0 takes one that is free.
        host: address to listen on; None for this machine alone, without a token.
        limits: what is allowed at most.
        ready: called with the address to open, once it can be.

    Raises:
        MagycError: the extra is not installed, no such folder, or the address cannot be listened on.
    """
    try:
        import uvicorn

        from magyc_gtsam.serve.application import Server, guarded
    except ImportError as error:
        raise MagycError(
            f"the server needs {error.name}; install it with: pip install 'magyc-gtsam[serve]'"
        ) from None
    if not folder.is_dir():
        raise MagycError(f"--folder {folder}: no such folder")
    family = socket.AF_INET6 if host is not None and ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host or LOOPBACK, port), family=family, backlog=128)
    except (OSError, OverflowError) as error:
        raise MagycError(
            f"{host or LOOPBACK}:{port}: cannot be listened on ({error}); name another --port"
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
