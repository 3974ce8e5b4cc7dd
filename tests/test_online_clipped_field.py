"""A magnetometer that is cut off at its full scale while a vehicle calibrates: said, and never converged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sensor_fault_findings import find_clipped_field
from test_clipped_field import STEPS, coarse, cut
from test_online_full_scale import fed
from test_online_standstill import ways

import magyc_gtsam as mg
from magyc_gtsam.sensor_faults.full_scale import FullScale
from magyc_gtsam.simulation import AMPLITUDES


@pytest.mark.parametrize(("motion", "share"), [("wide", 0.1), ("moderate", 0.6), ("low", 0.1), ("tiny", 0.6)])
def test_it_does_not_converge(motion: str, share: float) -> None:
    recording = cut(mg.simulate(motion, 200, seed=1).recording, share)
    online, found = fed(recording), find_clipped_field(recording)
    assert not online.converged
    assert not online.progress.converged
    said = online.progress.clipped_field
    assert (said.axes, said.shown) == (found.axes, found.shown)
    assert said.share == pytest.approx(found.share, abs=0.01)
    assert online.progress.sentence.startswith(said.sentence)
    assert [stuck for stuck in online.progress.stuck if stuck.axes == said.axes] == []
    if online.calibration is not None:
        assert not online.calibration.trusted
        assert online.calibration.message == online.progress.sentence


def test_from_the_middle_on() -> None:
    """A hard iron that comes near: trusted before, no more after."""
    simulation = mg.simulate("wide", seed=3)
    recording = cut(simulation.recording, 0.3)
    field = np.where(recording.time[:, None] < 300, simulation.recording.magnetic_field, recording.magnetic_field)
    before = fed(mg.Recording(recording.time[:3000], field[:3000], recording.angular_rate[:3000]))
    assert before.converged
    assert before.progress.clipped_field is None
    watch = FullScale()
    watch.observe(np.clip(field[:3000], -1, 1))
    assert watch.finding() is None
    low = recording.magnetic_field * 0.999  # a level below what was read before is none of the whole recording's
    watch = FullScale()
    watch.observe(low)
    assert watch.finding() is not None
    watch.observe(simulation.recording.magnetic_field)
    assert watch.finding() is None


def test_how_the_samples_are_cut_does_not_matter() -> None:
    log = cut(mg.simulate("low", 100, seed=2).recording, 0.2)
    results = []
    for way in ways(log):
        online = mg.OnlineCalibrator()
        way(online)
        assert online.progress.clipped_field is not None
        results.append((online.progress.clipped_field, online.progress.sentence))
    assert results[0] == results[1] == results[2]


def test_a_run_resumed_anywhere(tmp_path: Path) -> None:
    log = cut(mg.simulate("wide", 120, seed=1).recording, 0.2)
    expected, online = mg.OnlineCalibrator(), mg.OnlineCalibrator()
    expected.update(log.time, log.magnetic_field, log.angular_rate)
    for i in range(0, len(log.time), 197):
        online.update(*(column[i : i + 197] for column in (log.time, log.magnetic_field, log.angular_rate)))
        online.save(tmp_path / "state.npz")
        online = mg.OnlineCalibrator.load(tmp_path / "state.npz")
    assert online.progress == expected.progress
    assert online.progress.clipped_field is not None


@pytest.mark.parametrize("motion", [*AMPLITUDES, "multi", "dive", "survey"])
def test_clean_and_coarse_sensors_are_not_cut_off(motion: str) -> None:
    """At no time on the way."""
    for seed in range(2):
        field = mg.simulate(motion, seed=seed).recording.magnetic_field
        for step in STEPS:
            watch, value = FullScale(), coarse(field, step)
            for block in np.split(value, 20):
                watch.observe(block)
                assert watch.finding() is None, (seed, step)
