"""The verdict of a gap that is judged on another recording: the correction and the noise are two statements."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.gap.result import Gap, GapMap, Metrics, OpenLoop
from magyc_gtsam.report.gap_words import Validation, judged_gap

CALIBRATION = Calibration(np.eye(3), np.zeros(3), np.zeros(3), np.eye(12) * 1e-14, field_strength=50e-6)


def metrics(held_out: float, rms: float, level: float = 1.0) -> Metrics:
    """Of a prediction off by `rms` T, with innovations of `level` sigmas over time."""
    loop = OpenLoop(20.0, np.arange(9.0), np.full((9, 3), rms), np.full((9, 3), 1e-7), rms, 1e-7)
    over = GapMap("time", "s", np.arange(9.0), np.full(9, level), np.ones((9, 2)), np.full(9, 1 / 9))
    return Metrics(held_out, loop, 1.0, (), None, {}, (over,))


def closed() -> Gap:
    before, after = metrics(10.0, 2e-6), metrics(12.0, 5e-7)
    return Gap("closed", "the magnetometer is late", (), (), (), (), before, after, (), CALIBRATION, CALIBRATION)


def test_a_correction_that_helps_on_a_noisier_log_holds() -> None:
    """The likelihood falls by the noise alone; the prediction gets better."""
    validation = Validation("other.mcap", 60e-6, metrics(9.0, 2e-6), metrics(8.0, 6e-7, level=2.0))
    verdict = judged_gap(closed(), validation)
    assert verdict.trusted
    assert verdict.title == "Gap found and closed"
    assert "The noise level differs on other.mcap: 2.0 times that of this log." in verdict.details


def test_a_correction_that_does_not_help_is_the_banner() -> None:
    validation = Validation("other.mcap", 60e-6, metrics(9.0, 2e-6), metrics(8.0, 2.1e-6))
    verdict = judged_gap(closed(), validation)
    assert not verdict.trusted
    assert verdict.title == "The result does not hold on other.mcap"
    assert verdict.sentence.startswith("✘ The result does not hold on other.mcap: ")
    assert not [detail for detail in verdict.details if "noise level" in detail]
    assert any("Gap found and closed" in detail for detail in verdict.details)


def test_without_another_log_the_gap_speaks_for_itself() -> None:
    verdict = judged_gap(closed())
    assert verdict.sentence == "✔ Gap found and closed: the magnetometer is late"
    unjudged = judged_gap(closed(), None, ["the result could not be judged on brief.mcap: 2 windows"])
    assert not unjudged.trusted
    assert unjudged.title == "The result could not be judged on the other log"
