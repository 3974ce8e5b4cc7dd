"""A server of `magyc-gtsam serve` in a process of its own, for the tests of it."""

from __future__ import annotations

import http.client
import json
import re
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

from commands import COMMAND

DIVE = Path(__file__).parents[1] / "datasets" / "calibration_dive.mcap"
PATIENCE = 120.0  # s


class Served:
    """A server in a process of its own, and a client that is not a browser."""

    def __init__(self, folder: Path, *arguments: str, port: int = 0) -> None:
        self.folder = folder
        self.process = subprocess.Popen(
            [COMMAND, "serve", "--folder", str(folder), "--port", str(port), *arguments],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().removeprefix("open ").strip()
        found = re.fullmatch(r"http://([\w.-]+):(\d+)/(?:\?token=([\w-]+))?", self.address)
        assert found, self.address + self.process.stdout.read()
        self.port, self.token = int(found[2]), found[3]
        self.host = f"127.0.0.1:{self.port}"

    def ask(
        self, method: str, path: str, body: Any = None, origin: str | None = "own", **headers: str
    ) -> tuple[int, Any, dict[str, str]]:
        """Status, content and headers; the origin is the page's own unless it is said."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        own = {"Host": self.host}
        if origin is not None:
            own["Origin"] = f"http://{self.host}" if origin == "own" else origin
        data = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
        connection.request(method, path, data, own | headers)
        answer = connection.getresponse()
        content: Any = answer.read()
        connection.close()
        if answer.headers.get_content_type() == "application/json":
            content = json.loads(content)
        return answer.status, content, dict(answer.headers)

    def ended(self, key: str) -> dict[str, Any]:
        """A job, when it is over."""
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            _, job, _ = self.ask("GET", f"/api/jobs/{key}")
            if job["state"] not in ("waiting", "running"):
                return dict(job)
            time.sleep(0.05)
        raise AssertionError(f"still {job}")

    def stop(self, number: signal.Signals = signal.SIGINT) -> str:
        self.process.send_signal(number)
        output, _ = self.process.communicate(timeout=PATIENCE)
        return output
