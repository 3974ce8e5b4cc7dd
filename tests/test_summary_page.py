"""Pages over many logs, in a browser."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_report import HOSTILE, drawn_figures

import magyc_gtsam as mg
from magyc_gtsam.history import History, LogFactor
from magyc_gtsam.report.charts import Series
from magyc_gtsam.report.summary_page import PageLink, Section, _hard_iron, by_log, history_page, summary_page


@pytest.fixture(scope="module")
def history() -> History:
    """Of an instrument whose hard iron jumps before the fourth of six logs."""
    logs = []
    for k in range(6):
        iron = np.array([1e-5, -5e-6, 2e-5]) + (8e-6 if k >= 3 else 0.0)
        recording = mg.simulate("wide", 60, seed=k, hard_iron=iron).recording
        logs.append(replace(recording, name=f"log {k} {HOSTILE}"))
    return mg.calibrate_many(logs)


@pytest.mark.parametrize("dated", [False, True])
def test_history_is_drawn_by_the_browser(history: History, dated: bool, opened: Any, tmp_path: Path) -> None:
    factors = [replace(f, time=1.75e9 + k * 9 * 86400.0) for k, f in enumerate(history.factors)]
    page = opened(_written(tmp_path, history_page(History(factors) if dated else history)))
    assert page.locator("#verdict h1").inner_text() == "6 logs of one instrument"
    assert "The hard iron jumped once" in page.locator("#verdict").inner_text()
    assert drawn_figures(page) == 3
    assert page.locator("svg").count() == 0
    page.locator("figure.chart .u-over").first.hover()
    said = page.locator(".readout").first.inner_text()
    assert f"{HOSTILE} · by all logs" in said
    assert "the log alone" in said


def test_the_line_of_a_history_passes_over_what_is_not_used(
    history: History, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Series] = []
    monkeypatch.setattr("magyc_gtsam.report.summary_page.chart", lambda *given: drawn.extend(given[3]))
    broken = LogFactor("broken", None, None, None, problem="is empty")
    _hard_iron(History([*history.factors[:2], broken, *history.factors[2:]]))
    lines = [each for each in drawn if each.label == "by all logs"]
    assert len(lines) == 3
    assert all(np.isfinite(each.y).all() and len(each.y) == 7 for each in lines)
    assert "contradicts" not in {each.label for each in drawn}  # nothing is known of it


@pytest.mark.parametrize("width", [390, 1280])
def test_a_folder_is_drawn_by_the_browser(width: int, opened: Any, tmp_path: Path) -> None:
    names, iron = [f"a {HOSTILE}", "b", "c"], np.array([[1.0, 2, 3], [1.5, 2, 3], [1.2, 2, 3]])
    table = Section("Logs", ("log", "verdict"), [[PageLink(names[0], "a/report.html"), "word " * 40]])
    figures = by_log(names, iron, 0 * iron + 0.2)
    text = summary_page("Many", "1 of 3", False, ["one"], [table, Section("Hard iron", figures=figures)])
    page = opened(_written(tmp_path, text), width=width)
    assert drawn_figures(page) == 3
    assert page.locator("a").first.get_attribute("href") == "a/report.html"
    wider = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    assert page.evaluate(wider) == 0


def _written(folder: Path, text: str) -> Path:
    path = folder / "page.html"
    path.write_text(text, encoding="utf-8")
    return path
