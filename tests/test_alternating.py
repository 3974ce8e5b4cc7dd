"""A stream of the magnetometer's readings whose samples alternate between two values."""

from __future__ import annotations

import numpy as np
import pytest

from magyc_gtsam import OnlineCalibrator, Recording, calibrate, simulate
from magyc_gtsam.estimators.model_error.alternating import alternating


def mixed(seed, share, lost=()):
    """A recording in which every second sample lacks a share of its soft and hard iron, without some samples."""
    simulation = simulate("wide", duration=300, seed=seed)
    recording, truth = simulation.recording, simulation.truth
    field = recording.magnetic_field.copy()
    raw = field[1::2]
    clean = np.linalg.solve(truth.soft_iron, (raw - truth.hard_iron).T).T
    field[1::2] = (1 - share) * raw + share * clean
    kept = np.setdiff1d(np.arange(len(field)), lost)
    return truth, Recording.from_streams(
        (recording.time[kept], field[kept]), (recording.time, recording.angular_rate)
    )


@pytest.mark.parametrize("lost", [(), (700, 1400, 2205)])  # after a lost sample the other ones are the second
def test_an_offset_of_every_second_sample_is_in_the_sigma(lost):
    truth, recording = mixed(6200, 0.1, lost)
    found = calibrate(recording)
    named = [each["name"] for each in found.diagnostics["model_error"]["components"]]
    assert "alternation" in named
    for right in (truth.hard_iron, 0.9 * truth.hard_iron):
        away = found.hard_iron - right
        assert away @ np.linalg.solve(found.covariance[6:9, 6:9], away) < 3 * 3**2
    assert not [
        each for each in calibrate(mixed(6200, 0.0)[1]).diagnostics["model_error"]["components"]
        if each["name"] == "alternation"
    ]  # fmt: skip


def test_raw_and_calibrated_readings_in_one_stream_are_not_trusted():
    _, recording = mixed(6201, 1.0)
    found = calibrate(recording)
    assert not found.trusted
    assert "every second sample of the magnetometer differs by" in found.message
    online = OnlineCalibrator()
    for first in range(0, len(recording.time), 300):
        rows = slice(first, first + 300)
        online.update(recording.time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
    assert not online.converged


def test_an_alternation_is_found_wherever_it_is_in_a_long_log():
    """Only the first 20,000 samples were looked at."""
    time = 0.01 * np.arange(60000)
    field = 40e-6 * np.column_stack([np.cos(0.1 * time), np.sin(0.1 * time), 0.3 * np.cos(0.07 * time)])
    field += np.random.default_rng(0).normal(0, 3e-7, field.shape)
    field[25000::2, 0] += 2e-6
    recording = Recording(time, field, np.zeros_like(field))
    found = alternating(recording)
    assert 0.7e-6 < found.size < 1e-6
    assert alternating(Recording(time[:25000], field[:25000], np.zeros((25000, 3)))) is None
