"""The page: one self-contained document, assembled from scripts and styles of the reports and its own."""

from __future__ import annotations

import secrets
from functools import cache
from importlib import resources

_REPORT, _OWN = "magyc_gtsam.report", "magyc_gtsam.serve"
_STYLES = ((_REPORT, "uplot/uPlot.min.css"), (_REPORT, "style.css"), (_OWN, "page.css"))
_SCRIPTS = (
    (_REPORT, "uplot/uPlot.iife.min.js"),
    (_REPORT, "charts.js"),
    (_REPORT, "sphere.js"),
    (_OWN, "server.js"),
    (_OWN, "strip.js"),
    (_OWN, "logs.js"),
    (_OWN, "results.js"),
    (_OWN, "vehicle.js"),
    (_OWN, "live.js"),
    (_OWN, "start.js"),
)


def page(host: str) -> tuple[str, str]:
    """Return the page and its content security policy, which allows only its own script, style and server.

    Args:
        host: host and port of the request, to which the page's web socket connects.
    """
    nonce = secrets.token_urlsafe(16)
    policy = (
        f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; style-src-attr 'unsafe-inline'; "
        f"connect-src 'self' ws://{host} wss://{host}; img-src data:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )
    return _whole().replace("{{nonce}}", nonce), policy


@cache
def _whole() -> str:
    def joined(parts: tuple[tuple[str, str], ...]) -> str:
        return "\n".join((resources.files(package) / name).read_text(encoding="utf-8") for package, name in parts)

    text = (resources.files(_OWN) / "page.html").read_text(encoding="utf-8")
    return text.replace("{{style}}", joined(_STYLES)).replace("{{script}}", joined(_SCRIPTS))
