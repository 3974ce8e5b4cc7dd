"""The web socket: the state of jobs and of the live run, whenever it changes."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from magyc_gtsam.serve.limits import Limits

_PAUSE = 0.15  # s between two messages, at least
_TOO_MANY = 1013  # of RFC 6455: try again later


class Events:
    """Sends a snapshot to every page that is open, when something has changed.

    Args:
        snapshot: JSON types of the present state.
        limits: of the number of sockets.
    """

    def __init__(self, snapshot: Callable[[], dict[str, Any]], limits: Limits) -> None:
        self._snapshot, self._limits = snapshot, limits
        self._open: set[asyncio.Event] = set()

    def changed(self) -> None:
        """There is something new to show."""
        for event in self._open:
            event.set()

    async def socket(self, socket: WebSocket) -> None:
        """One page, until it leaves. What it sends is not looked at."""
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
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender

    async def _send(self, socket: WebSocket, event: asyncio.Event) -> None:
        while socket.application_state is WebSocketState.CONNECTED:
            event.clear()
            await socket.send_text(json.dumps(self._snapshot()))
            await asyncio.sleep(_PAUSE)
            await event.wait()
