"""An axis that is stuck but for its last bit is said before anything is tested."""

from __future__ import annotations

from pathlib import Path

import pytest

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.estimators.model_error.samples import flickers
from magyc_gtsam.gap.evidence import answer
from magyc_gtsam.io import write_mcap
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.signals import record


def flickering(name: str, strength: str = "strong") -> mg.Recording:
    fault = FAULTS[name]
    return record("moderate", 1, fault, getattr(fault, strength), name).recording(name)


@pytest.mark.parametrize("name", ["flickering-axis", "flickering-gyroscope-axis"])
@pytest.mark.parametrize("strength", ["weak", "strong"])
def test_it_is_said_and_nothing_is_tested(name: str, strength: str, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = flickering(name, strength)
    monkeypatch.setattr(answer, "Tree", None)  # no set of effects is fitted
    gap = mg.find_gap(recording)
    assert gap.verdict == "not enough information"
    assert gap.sentence.startswith(f"not enough information: {flickers(recording)}: choose an interval without it")
    assert gap.doubt is not None
    assert "repaired" in gap.doubt.action
    assert gap.names == ()
    assert not gap.calibration.converged


def test_the_command_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "log.mcap"
    write_mcap(log, flickering("flickering-axis", "weak"))
    assert main(["gap", str(log), "-o", str(tmp_path / "out")]) == 1
    assert "axis z of the magnetometer has only two values in 19% of the recording" in capsys.readouterr().out
