"""Jumps of the field are found without a calibration, and nothing else is taken for one."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.estimators.field_jumps import beyond_turning, field_jumps
from magyc_gtsam.foreign_text import MOST_WORDS
from magyc_gtsam.report.verdict import judged


@pytest.mark.parametrize("motion", ["wide", "moderate", "low", "tiny"])
def test_a_magnet_put_on_and_taken_off_is_dated(motion: str) -> None:
    """Ten of ten, each to half a second and a fifth of its size."""
    for seed in range(10):
        recording = mg.simulate(motion, 180, seed=seed).recording
        magnet = np.random.default_rng(seed).normal(size=3)
        magnet *= 30e-6 / np.linalg.norm(magnet)
        on = (recording.time >= 50) & (recording.time < 120)
        field = recording.magnetic_field + np.where(on[:, None], magnet, 0.0)
        jumps = field_jumps(replace(recording, magnetic_field=field))
        assert [jump.time for jump in jumps] == pytest.approx([50, 120], abs=0.5), seed
        assert [jump.size for jump in jumps] == pytest.approx([30e-6, 30e-6], rel=0.2), seed


@pytest.mark.parametrize("motion", ["wide", "moderate", "low", "tiny", "dive"])
def test_clean_motion_holds_none(motion: str) -> None:
    assert not [seed for seed in range(20) if field_jumps(mg.simulate(motion, 120, seed=seed).recording)]


def test_without_a_gyroscope_or_samples_nothing_is_said() -> None:
    recording = mg.simulate("wide", 60).recording
    assert field_jumps(replace(recording, angular_rate=None)) == ()
    assert field_jumps(recording.rows(slice(0, 6))) == ()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert field_jumps(mg.simulate("wide", 120, 1, seed=0).recording) == ()  # too slowly sampled


@pytest.mark.real
def test_the_attached_magnet_is_the_cause_that_is_named(shared_data: Path) -> None:
    recording = mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap")
    assert [round(jump.time) for jump in field_jumps(recording)] == [38, 95]
    failed = mg.Calibration(np.eye(3), np.zeros(3), converged=False, message="too little motion (…): hard iron")
    verdict = judged(failed, recording)
    assert verdict.reason.startswith("the field jumped at 38 s and 95 s: run `mg.find_gap`, or ")
    assert len(verdict.reason.split()) <= MOST_WORDS


@pytest.mark.parametrize(
    "message",
    [
        "the model leaves 12.3 µT unexplained (at most 10% of the field): the field or the instrument changed during "
        "the recording; choose an interval (start=, end=); 76% of the recording is disturbed, at most 50%",
        "no convergence within 81 iterations",
        "word " * 80,
        "",
    ],
)
def test_a_cause_and_an_action_are_few_words(message: str) -> None:
    verdict = judged(mg.Calibration(np.eye(3), np.zeros(3), converged=False, message=message))
    assert not verdict.trusted
    assert 1 <= len(verdict.reason.split()) <= MOST_WORDS
    assert verdict.sentence.startswith("✘ Do not use this calibration: ")


def test_sensor_noise_is_told_from_what_the_model_does_not_explain() -> None:
    """Where a calibration states both: variances add."""
    whole, noise = (np.diag(np.full(12, sigma**2)) for sigma in (0.5e-6, 0.3e-6))
    calibration = mg.Calibration(np.eye(3), np.zeros(3), np.zeros(3), whole, noise_covariance=noise)
    assert (
        "hard iron ±1σ: sensor noise 0.3 µT, what the model does not explain 0.4 µT" in judged(calibration).details
    )


@pytest.mark.parametrize(("size", "expected"), [(3e-4, True), (0.0, False)])
def test_a_field_that_sweeps_more_than_turning_is_no_lack_of_motion(size: float, expected: bool) -> None:
    """A magnet that is carried past slowly, so that nothing jumps."""
    made = mg.simulate("tiny", 180, seed=1).recording
    passing = size * np.exp(-(((made.time - 90) / 40) ** 2))
    recording = replace(made, magnetic_field=made.magnetic_field + passing[:, None] * [0.6, 0.0, 0.8])
    swept = beyond_turning(recording)
    assert (swept is not None) is expected
    failed = mg.Calibration(np.eye(3), np.zeros(3), converged=False, message="too little motion: turn")
    reason = judged(failed, recording).reason
    assert ("a magnet came near" in reason) is expected
    assert len(reason.split()) <= MOST_WORDS


@pytest.mark.parametrize("seed", range(3, 6))
def test_a_jump_too_small_to_be_dated_is_not_called_too_little_motion(seed: int) -> None:
    """The motion is wide; the misfit makes the sigmas seven times as large, and `find_gap` dates the jump."""
    recording = mg.simulate("wide", 300, seed=seed).recording
    step = np.where(recording.time[:, None] >= 150.0, [5e-6, 0.0, -8e-6], 0.0)
    found = mg.calibrate(replace(recording, magnetic_field=recording.magnetic_field + step))
    assert not found.trusted
    verdict = judged(found, recording)
    assert verdict.cause == "the field or the instrument changed, or something else is missing in the model"
    assert verdict.action == "run `mg.find_gap`, or choose an interval (start=, end=)"
    still = judged(mg.calibrate(mg.simulate((3, 3, 20), 60, seed=seed).recording))
    assert still.cause.startswith("too little motion")
