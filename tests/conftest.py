"""Fixtures that tests of all parts share."""

from __future__ import annotations

import gc
import os
import shutil
import signal
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# The matrices are small: threads of the linear algebra beside those of the tests only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# How long an example takes is the machine's affair.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")


# The files that take longest, by their processor time or because they wait for other processes. They are begun first:
# the last file that is begun leaves the other processes idle for as long as it takes.
LONGEST = (
    "test_gap_real.py",
    "test_gap_rates.py",
    "test_serve_page.py",
    "test_serve.py",
    "test_serve_live.py",
    "test_many.py",
    "test_blindtest.py",
    "test_cli_online.py",
    "test_magyc_ifg.py",
    "test_gap_find.py",
    "test_gap_honest.py",
    "test_online_changes.py",
    "test_gap_values.py",
    "test_gap_channels.py",
    "test_gap_isolability.py",
    "test_smoother.py",
    "test_study_faults.py",
    "test_summary_page.py",
    "test_without_gtsam.py",
)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "real: reads the real recordings (../shared/data)")
    # What a shell starts in the background ignores interrupts, and so would the commands that tests interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    order = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.name, len(LONGEST)))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What the collection makes stays to the end; to look through it for garbage takes a quarter of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The directory of real recordings beside the repository; tests that need it are skipped without it."""
    path = Path(__file__).parents[2] / "shared" / "data"
    if not path.is_dir():
        pytest.skip("the real recordings (../shared/data) are not here")
    return path


@pytest.fixture
def mistaken(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[[str, str], None]:
    """Runs a command line, in this process to spare the time of starting one: refused in one line, leaving nothing."""
    from magyc_gtsam import cli

    def refused(arguments: str, says: str) -> None:
        monkeypatch.chdir(tmp_path)
        assert cli.main(arguments.split()) == 2
        output, errors = capsys.readouterr()
        assert output == ""
        assert errors.count("\n") == 1
        assert says in errors
        assert list(tmp_path.iterdir()) == []

    return refused


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Headless Chromium."""
    api = pytest.importorskip("playwright.sync_api")
    found = [os.environ.get("MAGYC_CHROMIUM")]
    found += [shutil.which(name) for name in ("chromium", "chromium-browser", "google-chrome")]
    path = next((candidate for candidate in found if candidate), None)
    if path is None:
        pytest.skip("no Chromium found; name one in MAGYC_CHROMIUM")
    with api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=path,
            # One process for all pages, as to start one costs more than what a page does.
            args=["--no-sandbox", "--disable-gpu", "--disable-software-rasterizer"]
            + ["--renderer-process-limit=1", "--disable-site-isolation-trials"],
        )
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def context(browser: Any) -> Any:
    """The browser profile that all pages share, so that one process draws them; an empty page keeps it running."""
    made = browser.new_context(permissions=["clipboard-read", "clipboard-write"])
    made.new_page()
    return made


@pytest.fixture
def new_page(context: Any) -> Iterator[Callable[..., Any]]:
    """A function that gives an empty page; fails on errors of the pages."""
    wrong: list[str] = []

    def made(width: int, height: int = 850, scheme: str = "light") -> Any:
        page = context.new_page()
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme=scheme)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        return page

    yield made
    for page in context.pages[1:]:  # those too that pages have opened
        page.close()
    assert wrong == []


@pytest.fixture
def opened(new_page: Callable[..., Any]) -> Iterator[Callable[..., Any]]:
    """A function that opens a file and gives the page; fails on requests beyond it and on errors."""
    wrong: list[str] = []

    def open_page(path: Path, width: int = 1280, scheme: str = "light") -> Any:
        page = new_page(width, 900, scheme)
        page.on("request", lambda r: r.url.startswith(("file://", "data:")) or wrong.append(f"request {r.url}"))
        page.on("console", lambda m: m.type in ("error", "warning") and wrong.append(f"console {m.text}"))
        page.goto(path.as_uri())
        return page

    yield open_page
    assert wrong == []
