"""The study of minutes and amplitudes: more of both is better, and its rows are kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.study import duration


def test_amplitudes_are_a_motion() -> None:
    recording = mg.simulate((5.0, 10.0, 90.0), 120, 10, seed=1).recording
    assert np.array_equal(
        mg.simulate("low", 20, seed=3).recording.magnetic_field,
        mg.simulate((5.0, 45.0, 90.0), 20, seed=3).recording.magnetic_field,
    )
    assert recording.name == "5° 10° 90°-1"
    with pytest.raises(mg.MagycError, match="above 0 and at most 360 degrees"):
        mg.simulate((0.0, 10.0, 90.0))


def test_longer_and_larger_is_better(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(duration, "MINUTES", (0.5, 4.0))
    monkeypatch.setattr(duration, "PITCHES", (3.0, 30.0))
    monkeypatch.setattr(duration, "HEADINGS", (90.0, 360.0))
    assert cli.main(["study", "duration", "--runs", "3", "--workers", "1", "-o", str(tmp_path)]) == 0
    assert "heading ±90°" in capsys.readouterr().out
    rows = parquet.read_table(tmp_path / "duration.parquet").to_pylist()
    assert len(rows) == 3 * 2 * 2 * 2
    found = duration.cells(rows, 90.0)
    assert found[30.0, 4.0].error < found[3.0, 0.5].error
    assert found[30.0, 4.0].error < 3 * found[30.0, 4.0].stated
    assert found[30.0, 4.0].refused == 0
    assert "<svg" in (tmp_path / "duration.svg").read_text(encoding="utf-8")
