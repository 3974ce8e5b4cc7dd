"""Access control, checked before every request: host, token, and origin of requests that change something."""

from __future__ import annotations

import re
import secrets
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_OF_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
_READING = ("GET", "HEAD")
_HOST = re.compile(r"(?:[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(?::\d{1,5})?")
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}


class Guard:
    """Refuse requests that do not come from the page itself, and add security headers to every response.

    - Without a token, only requests to a loopback name are answered, which prevents DNS rebinding.
    - With a token, a request must carry it, in the URL once and in a cookie from then on.
    - Requests that change something, and the web socket, must come from a page of this server (`Origin`).

    Args:
        application: the guarded application.
        token: the required token; None if the server listens on loopback only.
        cookie: name of the cookie, unique to this server on the machine.
    """

    def __init__(self, application: ASGIApp, token: str | None, cookie: str) -> None:
        self._application, self._token, self._cookie = application, token, cookie

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._application(scope, receive, send)
            return
        headers = Headers(scope=scope)
        by_url = self._token is not None and self._is_token(_query_token(scope))
        problem = self._problem(scope, headers, by_url)
        if problem:
            await _refuse(scope, receive, send, problem)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                out = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    out.setdefault(name, value)
                if by_url and scope["path"] == "/":
                    cookie = f"{self._cookie}={self._token}; Path=/; HttpOnly; SameSite=Strict"
                    out.append("Set-Cookie", cookie)
            await send(message)

        await self._application(scope, receive, with_headers)

    def _problem(self, scope: Scope, headers: Headers, by_url: bool) -> str:
        """Return why the request is refused; "" if it is allowed."""
        host = headers.get("host", "")
        if not _HOST.fullmatch(host):
            return "the Host header of this request is not a host name"
        name = host.rpartition(":")[0] if host.rpartition(":")[2].isdecimal() else host
        if self._token is None and name not in _OF_LOOPBACK:
            return "this server answers to 127.0.0.1 and localhost only"
        if self._token is not None and not by_url and not self._is_token(self._cookie_token(headers)):
            return "the token is missing or wrong: open the address that `magyc-gtsam serve` has shown"
        if scope["type"] == "http" and scope["method"] in _READING:
            return ""
        if len(headers.getlist("origin")) != 1 or headers["origin"] not in (f"http://{host}", f"https://{host}"):
            return "this request does not come from the server's own page"
        return ""

    def _is_token(self, text: str) -> bool:
        return self._token is not None and secrets.compare_digest(text.encode(), self._token.encode())

    def _cookie_token(self, headers: Headers) -> str:
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            return ""
        return cookie.value if cookie is not None else ""


def _query_token(scope: Scope) -> str:
    tokens = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])
    return tokens[0] if len(tokens) == 1 else ""


async def _refuse(scope: Scope, receive: Receive, send: Send, problem: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    await PlainTextResponse(problem, status_code=403, headers=_HEADERS)(scope, receive, send)
