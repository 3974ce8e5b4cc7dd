"""What `magyc-gtsam serve` costs: from a dropped log to its verdict, and an hour of live samples with the page open.

    python benchmarks/serve.py drop LOG…         # processor time of the server's processes, main thread of the page
    python benchmarks/serve.py live 3600 100     # s and Hz: memory of server, run and page as the samples come

The samples are sent as fast as they are taken in, with their own stamps. Chromium is asked for its own figures, after
a collection of garbage.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from sending import free_port, listened_to, rows, send_lines

import magyc_gtsam as mg

LOOKS = 12  # at the memory
TICKS = os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def opened() -> Iterator[tuple[int, Any, Any]]:
    """The server's process number, its page at a phone's width, and what asks Chromium."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        command = [sys.executable, "-m", "magyc_gtsam", "serve", "--folder", folder, "--port", "0"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        address = re.search(r"http\S+", server.stdout.readline())
        assert address is not None
        found = os.environ.get("MAGYC_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
        arguments = ["--no-sandbox", "--disable-gpu"]
        browser = playwright.chromium.launch(executable_path=found, args=arguments)
        page = browser.new_page(viewport={"width": 400, "height": 850})
        page.set_default_timeout(600e3)
        page.goto(address[0])
        asked = page.context.new_cdp_session(page)
        asked.send("Performance.enable")
        try:
            yield server.pid, page, asked
        finally:
            browser.close()
            server.terminate()
            server.wait()


def processes(first: int) -> dict[int, list[str]]:
    """{number: fields of /proc/N/stat behind the name} of a process and all that it started."""
    fields = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended
            fields[int(path.parent.name)] = path.read_text().rpartition(")")[2].split()
    found = {first}
    while more := {number for number, values in fields.items() if int(values[1]) in found} - found:
        found |= more
    return {number: fields[number] for number in found if number in fields}


def processor(first: int) -> float:
    """s that a process and all that it started have taken, those that have ended included."""
    return sum(sum(map(int, values[11:15])) for values in processes(first).values()) / TICKS


def metrics(asked: Any) -> dict[str, float]:
    """Chromium's figures of the page."""
    return {each["name"]: each["value"] for each in asked.send("Performance.getMetrics")["metrics"]}


def drop(log: Path) -> None:
    """From the drop of a log to its verdict."""
    with opened() as (server, page, asked):
        for number in range(4):
            page.wait_for_timeout(4000)  # as long as somebody needs to find the log
            before, task, clock = processor(server), metrics(asked)["TaskDuration"], time.perf_counter()
            page.set_input_files("#files", log)
            page.locator("#result header h1").wait_for()
            seen = time.perf_counter() - clock
            spent, busy = processor(server) - before, metrics(asked)["TaskDuration"] - task
            if number:  # the first draws the page for the first time
                print(
                    f"{log.name}: server {spent:.2f} s, page {busy:.2f} s of processor; seen after {seen:.2f} s, "
                    f"load {os.getloadavg()[0]:.1f}",
                    flush=True,
                )
            page.locator("#result button", has_text="Close").click()


def live(duration: float, rate: float) -> None:
    """Memory while samples come."""
    lines = rows(mg.simulate("dive", duration, seed=1, rate=rate).recording)
    port = free_port()
    with opened() as (server, page, asked):
        page.locator("[data-tab=live]").click()
        page.locator("#udp-port").fill(str(port))
        page.locator("#begin").click()
        listened_to(port)
        every = -(-len(lines) // LOOKS)
        for first in range(0, len(lines), every):
            part = lines[first : first + every]
            for place in range(0, len(part), 500):
                send_lines(port, part[place : place + 500])
            page.wait_for_timeout(1500)
            asked.send("HeapProfiler.collectGarbage")
            pages = {number: int(values[21]) for number, values in processes(server).items()}
            sizes = {number: count * os.sysconf("SC_PAGE_SIZE") / 1e6 for number, count in pages.items()}
            own, run = sizes.pop(server), max(sizes.values())
            heap = metrics(asked)
            print(
                f"{part[-1]['time'] - lines[0]['time']:7.0f} s: server {own:.0f} MB, run {run:.0f} MB, page "
                f"{heap['JSHeapUsedSize'] / 1e6:.1f} MB in {heap['Nodes']:.0f} nodes; "
                f"{page.locator('#live-verdict .origin').text_content()}",
                flush=True,
            )


if __name__ == "__main__":
    if sys.argv[1] == "drop":
        for name in sys.argv[2:]:
            drop(Path(name))
    else:
        live(*map(float, sys.argv[2:4]))
