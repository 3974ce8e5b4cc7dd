"""What results show in a notebook: one line, a table, a figure, a page."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import pytest

import magyc_gtsam as mg


@pytest.fixture(scope="module")
def recording() -> mg.Recording:
    return mg.simulate("wide", 300, seed=2).recording


@pytest.fixture(scope="module")
def calibration(recording: mg.Recording) -> mg.Calibration:
    return mg.calibrate(recording)


def test_a_calibration_in_a_notebook(calibration: mg.Calibration, recording: mg.Recording, tmp_path: Path) -> None:
    assert len(repr(calibration)) < 120
    assert "smoother" in repr(calibration)
    shown = calibration._repr_html_()
    assert "✔ Calibrated: systematic heading error at most" in shown
    assert shown.count("<tr>") > 6
    figure = calibration.plot()
    figure.savefig(tmp_path / "figure.png")
    assert len(figure.axes) >= 5
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["raw", "calibrated"]
    page = calibration.report(tmp_path / "page.html")
    assert "systematic heading error at most" in page.read_text(encoding="utf-8").lower()
    assert calibration.report(tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")


def test_a_calibration_that_was_loaded_is_told_its_recording(
    calibration: mg.Calibration, recording: mg.Recording, tmp_path: Path
) -> None:
    calibration.save(tmp_path / "cal.yaml")
    loaded = mg.Calibration.load(tmp_path / "cal.yaml")
    for forgotten in (loaded, replace(calibration, message=""), pickle.loads(pickle.dumps(calibration))):
        assert forgotten.recording is None
        with pytest.raises(mg.MagycError, match="pass recording="):
            forgotten.plot()
    assert loaded.report(tmp_path / "page.html", recording).exists()
    assert "✔ Calibrated" in loaded._repr_html_()


def test_a_gap_in_a_notebook(tmp_path: Path) -> None:
    gap = mg.find_gap(mg.simulate("wide", 400, seed=2, effects=("timing",)).recording, candidates=["timing"])
    assert len(repr(gap)) < 200
    assert gap.verdict in repr(gap)
    assert gap.names == ("timing",)
    assert "magnetometer delay" in gap._repr_html_()
    figure = gap.plot()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["before", "after"]
    figure.savefig(tmp_path / "gap.png")
    assert (tmp_path / "gap.png").stat().st_size > 10_000


def test_a_comparison_in_a_notebook(recording: mg.Recording) -> None:
    comparison = mg.compare(recording, ("smoother", "sar-ls"))
    assert repr(comparison).startswith("Comparison(use='smoother'")
    assert "Use smoother" in comparison._repr_html_()
