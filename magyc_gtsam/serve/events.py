"""Send the state of the jobs and of the live run to open pages over a web socket, whenever it changes."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from magyc_gtsam.serve.limits import Limits

_PAUSE = 0.15  # s, shortest interval between two messages
_TOO_MANY = 1013  # of RFC 6455: try again later


class Events:
    """Send a snapshot to every open page when something has changed.

    Args:
        snapshot: returns the present state as JSON types.
        limits: bound on the number of sockets.
    """

    def __init__(self, snapshot: Callable[[], dict[str, Any]], limits: Limits) -> None:
        self._snapshot, self._limits = snapshot, limits
        self._open: set[asyncio.Event] = set()

    def changed(self) -> None:
        """Announce that the state has changed."""
        for event in self._open:
            event.set()

    async def socket(self, socket: WebSocket) -> None:
        """Serve one page until it disconnects; messages from it are ignored."""
        if len(self._open) >= self._limits.sockets:
            await socket.close(_TOO_MANY)
            return
        await socket.accept()
        event = asyncio.Event()
        self._open.add(event)
        sender = asyncio.create_task(self._send(socket, event))
        try:
            while True:
                if (await socket.receive())["type"] == "websocket.disconnect":
                    break
        finally:
            self._open.discard(event)
            sender.cancel()
            # The sender was cancelled just above, or its page has left, for which Starlette raises either error.
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender

    async def _send(self, socket: WebSocket, event: asyncio.Event) -> None:
        while socket.application_state is WebSocketState.CONNECTED:
            event.clear()
            await socket.send_text(json.dumps(self._snapshot()))
            await asyncio.sleep(_PAUSE)
            await event.wait()
