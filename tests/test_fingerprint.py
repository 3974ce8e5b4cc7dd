"""Recordings that share samples share fingerprints; others do not, also where readings are coarse and at rest."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.recording.fingerprint import fingerprint, first_shared


def shares(one: mg.Recording, other: mg.Recording) -> bool:
    return first_shared(fingerprint(one), ["", "0123456789abcdef", fingerprint(other)]) is not None


def test_parts_copies_and_merged_rows_are_recognised() -> None:
    whole = mg.simulate("wide", seed=1).recording
    merged = mg.Recording.from_streams(whole.magnetometer, (whole.time + 0.03, whole.angular_rate))
    for part in (
        whole.between(400, 520),
        whole.between(0, 150),
        merged,
        mg.Recording(whole.time + 99, whole.magnetic_field),
    ):
        assert shares(part, whole)
    assert not shares(whole.between(0, 290), whole.between(300, 600))
    assert not any(shares(mg.simulate("wide", seed=seed).recording, whole) for seed in range(2, 12))


def test_copies_in_another_precision_are_recognised() -> None:
    """Of single precision, and of text with digits down to 10 nT."""
    for seed in range(5):
        whole = mg.simulate("wide", 300, seed=seed).recording
        field = whole.magnetic_field
        for copy in (
            field.astype(np.float32),
            np.round(field * 1e4, 6) / 1e4,
            np.round(field, 9),
            np.round(field, 8),
        ):
            assert shares(mg.Recording(whole.time, copy), whole)
        assert shares(mg.Recording(whole.time[:500], field[:500].astype(np.float32)), whole)


@pytest.mark.parametrize(("noise", "step"), [(0.1, 0.15), (0.1, 1e-6), (0.02, 0.013), (0.01, 1e-6)])
def test_readings_at_rest_are_not_taken_for_each_other(noise: float, step: float) -> None:
    """Coarse or quiet, alone or before a motion."""
    random, time = np.random.default_rng(0), np.arange(3000) / 50
    recordings = []
    for _ in range(10):
        turn = np.cumsum(random.normal(0, 0.02, (1000, 3)), axis=0)
        rest = np.array([20.0, 5.0, 40.0]) + random.normal(0, noise, (3000, 3))
        rest[2000:] += 20 * np.sin(turn)
        field = np.round(rest / step) * step * 1e-6
        recordings += [mg.Recording(time, field), mg.Recording(time[:2000], field[:2000])]
    assert not any(shares(*pair) for pair in zip(recordings, recordings[2:], strict=False))


def test_no_simulation_of_the_recording_itself() -> None:
    recording = mg.simulate("wide", 60, seed=1).recording
    with pytest.raises(mg.MagycError, match="simulated: it holds samples of the recording"):
        mg.find_gap(recording, simulated=recording.between(0, 40))


def test_a_run_has_the_fingerprint_of_its_recording_in_blocks_and_after_a_restart(tmp_path: Path) -> None:
    recording = mg.simulate("wide", 60, seed=1).recording
    assert recording.angular_rate is not None
    online = mg.OnlineCalibrator()
    for first, last in pairwise([0, 1, 4, 30, 300, 600]):
        rows = slice(first, last)
        online.update(recording.time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
        online.save(tmp_path / "state.npz")
        online = mg.OnlineCalibrator.load(tmp_path / "state.npz")
    calibration = online.calibration
    assert calibration is not None
    assert calibration.fitted_to == (fingerprint(recording),)
    with pytest.raises(mg.MagycError, match="would count twice"):
        mg.calibrate(recording, prior=calibration)
    for source, twice in ((recording, True), (mg.simulate("wide", 60, seed=2).recording, False)):
        again = mg.OnlineCalibrator(prior=calibration)
        again.update(source.time, source.magnetic_field, source.angular_rate)
        assert again.calibration is not None
        assert ("count twice" in again.calibration.message) == ("count twice" in again.progress.sentence) == twice
        assert not (twice and (again.converged or again.calibration.trusted or again.progress.converged))
