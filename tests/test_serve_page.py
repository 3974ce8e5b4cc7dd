"""The page of `magyc-gtsam serve` in a browser: a log dropped, an interval dragged, the command line's numbers."""

from __future__ import annotations

import base64
import re
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run
from served import DIVE, PATIENCE, Served

import magyc_gtsam as mg
from magyc_gtsam.io import write_mcap

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import fuzz_files

pytest.importorskip("starlette", reason="pip install 'magyc-gtsam[serve]'")
pytest.importorskip("uvicorn", reason="pip install 'magyc-gtsam[serve]'")

SECONDS = 1e3 * PATIENCE  # in the browser's unit
DROP = """([name, content]) => {
  const bytes = Uint8Array.from(atob(content), (c) => c.charCodeAt(0));
  const carried = new DataTransfer();
  carried.items.add(new File([bytes], name));
  const options = { dataTransfer: carried, bubbles: true, cancelable: true };
  document.querySelector("#drop").dispatchEvent(new DragEvent("drop", options));
}"""


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory, browser: Any) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("served")
    shutil.copy(DIVE, folder)
    server = Served(folder)
    yield server
    assert "Traceback" not in server.stop()


@pytest.fixture
def visit(new_page: Callable[..., Any]) -> Callable[..., Any]:
    """A function that opens the page of a server at a width; fails on errors of the page."""

    def opened(server: Served, width: int = 400, scheme: str = "light") -> Any:
        page = new_page(width, scheme=scheme)
        page.set_default_timeout(SECONDS)
        page.goto(server.address)
        page.locator("#link").wait_for(state="hidden")
        return page

    return opened


def table(path: Path) -> Path:
    """The dive as a text table."""
    recording = mg.read(DIVE)
    assert recording.angular_rate is not None
    rows = np.column_stack([recording.time, recording.magnetic_field * 1e6, recording.angular_rate])
    header = "time_s,mag_x_uT,mag_y_uT,mag_z_uT,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s"
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


def result(page: Any, server: Served, words: str) -> Path:
    """The folder of the result that the page shows, when its origin has these words."""
    page.locator("#result .origin", has_text=words).wait_for()
    key = page.evaluate("new URLSearchParams(location.hash.slice(1)).get('result')")
    return server.folder / "results" / key


def test_drop_a_log_drag_an_interval_and_calibrate(
    served: Served, visit: Callable[..., Any], tmp_path: Path
) -> None:
    """To the last byte what the command line gives, in the file and on the clipboard; nothing wider than the page."""
    file = table(tmp_path / "dive.csv")
    page = visit(served, 400, "dark")
    page.evaluate(DROP, [file.name, base64.b64encode(file.read_bytes()).decode()])
    page.locator("#result header.good").wait_for()
    whole = result(page, served, f"{file.name} · calibration")
    page.locator("#layer").wait_for()
    assert "10.0 min · turned by" in page.locator("#holds").text_content()

    page.locator("#layer").scroll_into_view_if_needed()
    box = page.locator("#layer").bounding_box()
    y = box["y"] + 0.3 * box["height"]
    page.mouse.move(box["x"] + 0.2 * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"], y)
    page.mouse.move(box["x"] + 0.8 * box["width"], y)
    page.mouse.up()
    start, end = page.locator("#start").input_value(), page.locator("#end").input_value()
    assert abs(float(start) - 120) < 5
    assert abs(float(end) - 480) < 5
    page.locator("[data-run=calibrate]").click()
    part = result(page, served, f"{start.removesuffix('.0')} to {end.removesuffix('.0')} s")
    for folder, interval in ((whole, []), (part, ["--start", start, "--end", end])):
        assert run("calibrate", file, "-q", "-o", "own", *interval, cwd=tmp_path).returncode == 0
        for name in ("calibration.yaml", "px4.params"):
            assert (folder / name).read_bytes() == (tmp_path / "own" / name).read_bytes()

    page.locator(".export", has_text="PX4").locator("button").click()
    page.locator(".export button", has_text="Copied").wait_for()
    assert page.evaluate("navigator.clipboard.readText()") == (part / "px4.params").read_text(encoding="utf-8")
    for width in (400, 1400):
        page.set_viewport_size({"width": width, "height": 850})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    with page.context.expect_page() as opened:
        page.locator("text=Open the report").click()
    report = opened.value
    report.locator("figure canvas").first.wait_for()
    assert report.evaluate("origin") == "null", "a report's script is nobody's"
    page.locator("#remove").click()
    page.locator("#log").wait_for(state="hidden")


def test_a_log_of_another_format(served: Served, visit: Callable[..., Any], tmp_path: Path) -> None:
    """A phone's archive, dropped and calibrated as on the command line; of all formats see `test_serve`."""
    page = visit(served)
    content, suffix = fuzz_files.phone(tmp_path, mg.read(DIVE, end=240.0))
    file = tmp_path / f"phone{suffix}"
    file.write_bytes(content)
    page.set_input_files("#files", str(file))
    folder = result(page, served, f"{file.name} · calibration")
    expected = mg.calibrate(mg.read(file))
    found = mg.Calibration.load(folder / "calibration.yaml")
    for name in ("soft_iron", "hard_iron", "gyro_bias", "covariance"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_log_that_cannot_be_read_says_why(served: Served, visit: Callable[..., Any]) -> None:
    """And, where only the command line can read it, so."""
    page = visit(served)
    rows = "\n".join(f"{t / 10},1,2,{t},0.1,0.2,0.3" for t in range(100))
    page.set_input_files("#files", {"name": "bare.csv", "mimeType": "text/plain", "buffer": rows.encode()})
    text = page.locator("#holds", has_text="cannot be read")
    text.wait_for()
    assert "--read columns=" in text.text_content()
    assert text.text_content().endswith("; not all of these options are on this page, use the command line")
    page.locator("#problem p").filter(has_text="bare.csv").wait_for()
    page.locator("#problem button").click()
    page.locator("#problem").wait_for(state="hidden")
    page.locator("#remove").click()


def test_an_option_that_the_page_has_is_called_by_its_label(served: Served, visit: Callable[..., Any]) -> None:
    page = visit(served)
    recording = mg.read(DIVE, end=60.0)
    table = np.column_stack([recording.time, recording.magnetic_field * 1e6, recording.angular_rate])
    rows = "\n".join(["time,mag_x,mag_y,mag_z,gyro_x,gyro_y,gyro_z", *(",".join(map(str, row)) for row in table)])
    page.set_input_files("#files", {"name": "micro.csv", "mimeType": "text/plain", "buffer": rows.encode()})
    wanted = "or read it in its unit (“Field is in”)"
    page.locator("#holds", has_text=wanted).wait_for()
    page.locator("#problem p", has_text=wanted).wait_for()
    page.locator("#problem button").click()
    page.locator("#remove").click()


def shown(page: Any) -> dict[str, str]:
    """What the page's address says is looked at."""
    return dict(page.evaluate("Object.fromEntries(new URLSearchParams(location.hash.slice(1)))"))


def test_only_the_page_that_started_a_job_opens_its_result(
    served: Served, visit: Callable[..., Any], tmp_path: Path
) -> None:
    """The result is closed where another log is opened, and Back leads to it again."""
    page, other = visit(served), visit(served)
    file = table(tmp_path / "own.csv")
    page.set_input_files("#files", str(file))
    page.locator("#result header.good").wait_for()
    key = shown(page)["result"]
    other.wait_for_function("key => listed.some((job) => job.result === key && job.state === 'done')", arg=key)
    assert other.locator("#result").is_hidden()
    assert "result" not in shown(other)

    page.locator("#logs button", has_text=DIVE.name).click()
    page.locator("#log h2", has_text=DIVE.name).wait_for()
    page.set_input_files("#files", {"name": "void.txt", "mimeType": "text/plain", "buffer": b""})
    page.locator("#problem", has_text="void.txt: the log is empty").wait_for()
    assert page.locator("#result").is_hidden()
    assert "result" not in shown(page)
    while "result" not in shown(page):
        page.go_back()
    page.locator("#result .origin", has_text=file.name).wait_for()
    page.locator("#log h2", has_text=file.name).wait_for()


def test_the_end_of_a_job_is_shown_that_is_told_before_its_key(served: Served, visit: Callable[..., Any]) -> None:
    """The events of a server and its answers to requests are not in order."""
    page = visit(served)

    def late(route: Any) -> None:
        answer = route.fetch()
        served.ended(answer.json()["key"])
        page.wait_for_timeout(300)  # until the page has been told
        route.fulfill(response=answer)

    page.route("**/api/jobs", late)
    page.locator("#logs button", has_text=DIVE.name).click()
    page.locator("#holds", has_text="turned by").wait_for()
    page.unroute_all(behavior="wait")


def test_notes_are_on_the_card_and_a_unit_that_is_taken_back_leaves_no_trace(
    served: Served, visit: Callable[..., Any]
) -> None:
    page = visit(served)
    cut = {"name": "cut.mcap", "mimeType": "", "buffer": DIVE.read_bytes()[:300_000]}
    page.set_input_files("#files", cut)
    page.locator("#result li", has_text="the file is cut off after 300000 bytes").wait_for()
    page.locator("#layer").wait_for()
    page.locator("#start").fill("30")
    page.locator("#start").blur()
    page.locator("#reading summary").click()
    page.locator("#holds", has_text="turned by").wait_for()
    before = page.locator("#holds").text_content()
    page.locator("[name=angular_unit]").select_option("deg/s")
    page.locator("#holds", has_text="turned by").filter(has_not_text=before).wait_for()
    page.wait_for_function("document.querySelector('#start').value === '30.0'")
    page.locator("[name=magnetic_unit]").select_option("gauss")
    page.locator("#holds.caution", has_text="cannot be read").wait_for()
    page.locator("[name=magnetic_unit]").select_option("")
    page.locator("#holds.soft", has_text="turned by").wait_for()
    page.locator("#remove").click()


def test_the_layer_for_dragging_fits_the_charts_after_a_rotation(
    served: Served, visit: Callable[..., Any]
) -> None:
    page = visit(served, 1300)
    page.locator("#logs button", has_text=DIVE.name).click()
    page.locator("#layer").wait_for()
    before = None
    for width in (1300, 700, 400, 900):
        page.set_viewport_size({"width": width, "height": 850})
        plot = "strip.charts[0].figure.plot"
        page.wait_for_function(f"width => {plot} && {plot}.width !== width", arg=before)
        before = page.evaluate(f"{plot}.width")
        page.wait_for_timeout(200)  # the layer follows by itself
        layer, chart = page.evaluate(
            f"[$('#layer'), {plot}.over].map((each) => each.getBoundingClientRect()).map((b) => [b.left, b.right])"
        )
        np.testing.assert_allclose(layer, chart, atol=1.0)
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_reload_and_a_killed_server_in_the_middle(tmp_path: Path, visit: Callable[..., Any]) -> None:
    """The job is there after a reload; where the server is killed, the page finds the next one, and what was made."""
    shutil.copy(DIVE, tmp_path)
    server = Served(tmp_path)
    page = visit(server)
    page.locator("#logs button").click()
    page.locator("#layer").wait_for()
    page.locator("[data-run=gap]").click()
    page.locator(".job progress").wait_for()
    page.reload()
    page.locator(".job", has_text="Gap of").wait_for()
    assert page.locator("#log h2").text_content() == DIVE.name
    page.locator(".job button").click()
    page.locator("#jobs").wait_for(state="hidden")

    page.locator("[data-run=calibrate]").click()
    page.locator(".job", has_text="Calibrating from").wait_for()
    begun = page.locator(".job .soft").filter(has_not_text=re.compile("waiting|starting"))
    begun.or_(page.locator("#result header.good")).first.wait_for()
    server.stop(signal.SIGKILL)
    page.locator("#link").wait_for()
    page.locator("#log [data-run=compare]").click()
    page.locator("#problem", has_text="does not answer").wait_for()
    server = Served(tmp_path, port=server.port)
    try:
        page.locator("#link").wait_for(state="hidden")
        until = time.monotonic() + PATIENCE
        while not list(tmp_path.glob("results/*/report.html")):
            assert time.monotonic() < until
            time.sleep(0.05)
        page.locator("[data-tab=results]").click()
        page.reload()
        page.locator("#results button").first.click()
        page.locator("#result header.good").wait_for()
    finally:
        server.stop()


def test_a_history_of_ticked_logs(served: Served, tmp_path: Path, visit: Callable[..., Any]) -> None:
    """The same log of an instrument in two parts; the calibration for the next one is what the command line gives."""
    recording = mg.read(DIVE)
    parts = {"first.mcap": recording.between(0.0, 300.0), "second.mcap": recording.between(300.0, 600.0)}
    for name, part in parts.items():
        write_mcap(served.folder / name, part, epoch=10**18)
    page = visit(served, 1400)
    for name in parts:
        page.get_by_label(f"{name} for a history").check()
    page.locator("#several button", has_text="History of these 2 logs").click()
    folder = result(page, served, "2 logs · history")
    page.locator("#result header.good").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= 1400
    files = [served.folder / name for name in parts]
    assert run("history", *files, "-q", "-o", "own", cwd=tmp_path).returncode == 0
    for name in ("next.yaml", "px4.params"):
        assert (folder / name).read_bytes() == (tmp_path / "own" / name).read_bytes()
