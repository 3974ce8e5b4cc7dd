"""Turns beyond the gyroscope's full scale, noticed while the samples come in: left out and said as the batch does."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_fault_findings import cut_off, find_clipped, watched
from test_online_standstill import ways

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.io import write_mcap
from magyc_gtsam.recording import Samples
from magyc_gtsam.sensor_faults.cut_off import CutOff
from magyc_gtsam.sensor_faults.gate import SampleGate
from magyc_gtsam.simulation import AMPLITUDES, Simulation
from magyc_gtsam.study.efficiency import error, nees

CHI2_11 = 31.3  # 99.9 % point of χ² of 11 degrees of freedom


def clipped(recording: mg.Recording, share: float) -> mg.Recording:
    """The same with a full scale at a share of the largest rate."""
    full = share * np.abs(recording.angular_rate).max()
    return replace(recording, angular_rate=np.clip(recording.angular_rate, -full, full))


def fed(recording: mg.Recording, **options: Any) -> mg.OnlineCalibrator:
    """Every row, 20 s at a time."""
    online, time = mg.OnlineCalibrator(**options), recording.time
    for edge in np.arange(0.0, time[-1] + 20, 20.0):
        rows = slice(*np.searchsorted(time, [edge, edge + 20]))
        online.update(time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
    return online


@pytest.fixture(scope="module")
def wide() -> Simulation:
    return mg.simulate("wide", 300, rate=50.0, seed=1)


@pytest.mark.parametrize(
    ("motion", "seed", "share"),
    [("wide", 1, 0.9), ("wide", 2, 0.7), ("moderate", 2, 0.9), ("low", 1, 0.9), ("tiny", 2, 0.9)],
)
def test_they_are_left_out_as_by_the_batch(motion: str, seed: int, share: float) -> None:
    """Unnoticed, wide at 0.9 was 3 of its sigmas off and trusted, NEES 28; at 0.6 35 sigmas, NEES 1932."""
    simulation = mg.simulate(motion, 400, seed=seed)
    recording = clipped(simulation.recording, share)
    online, found = fed(recording), find_clipped(recording)
    calibration, progress = online.calibration, online.progress
    assert online.converged
    assert calibration.trusted
    assert online.changes == ()
    assert nees(error(calibration, simulation.truth), calibration.covariance) < CHI2_11
    said = progress.clipped
    assert said.axes == found.axes
    assert said.level == found.level
    assert said.count == pytest.approx(found.count, abs=12)  # the first ones, before it could be known
    assert said.share == pytest.approx(found.share, abs=0.03)
    assert progress.left_out == round(said.share * 4000)
    assert calibration.message.endswith(f"left out: {said.where}")
    assert calibration.diagnostics["left_out"] == [said.where]


@pytest.mark.parametrize(("motion", "seed"), [("wide", 1), ("moderate", 2), ("tiny", 1)])
def test_more_than_half_is_refused_in_the_words_of_the_batch(motion: str, seed: int) -> None:
    recording = clipped(mg.simulate(motion, 200, seed=seed).recording, 0.5)
    with pytest.raises(mg.MagycError) as refused:
        mg.calibrate(recording)
    remedy = (
        "at most 50% can be left out: raise the gyroscope's full scale, turn more slowly, or choose an interval"
    )
    assert remedy in str(refused.value)
    online = fed(recording)
    assert not online.converged
    assert not online.progress.converged
    assert remedy in online.progress.sentence
    if online.calibration is not None:
        assert not online.calibration.trusted
        assert online.calibration.message == online.progress.sentence


def test_it_is_said_while_it_lasts(wide: Simulation) -> None:
    recording = clipped(wide.recording, 0.9)
    level = find_clipped(recording).level
    last = recording.time[(np.abs(recording.angular_rate) == level).any(axis=1)][-1]
    watch, during, after = mg.OnlineCalibrator(), "", ""
    columns = recording.time, recording.magnetic_field, recording.angular_rate
    before = int(np.searchsorted(recording.time, last - 1.0))
    watch.update(*(column[:before] for column in columns))
    for row in zip(*(column[before:] for column in columns), strict=True):
        watch.update(*row)
        if row[0] == last:
            during = watch.progress.sentence
        if row[0] > last + 1.0:
            after = watch.progress.sentence
            break
    assert during.startswith("angular_rate: axis y of the gyroscope cut off at ")
    assert during.endswith("samples are not used across it")
    assert "cut off" not in after


def test_how_the_samples_are_cut_does_not_matter() -> None:
    log = clipped(mg.simulate("low", 150, seed=2).recording, 0.8)
    results = []
    for way in ways(log):
        online = mg.OnlineCalibrator()
        way(online)
        assert online.progress.clipped.count > 100
        results.append((online.calibration.to_dict(), online.progress.clipped))
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("step", [0.0, 1e-3, 5e-3])
def test_what_the_watch_passes_does_not_depend_on_the_cuts(step: float) -> None:
    """Coarse sensors too, whose samples come near the largest ones again and again."""
    recording = clipped(mg.simulate("wide", 200, seed=4).recording, 0.8)
    rate = recording.angular_rate if not step else np.round(recording.angular_rate / step) * step
    results = []
    for cut in (3, 400, 2000):
        gate, blocks = SampleGate(CutOff()), np.arange(0, len(rate), cut)
        passed = [gate.take(Samples(recording.time[i : i + cut], rate[i : i + cut])) for i in blocks]
        kept = np.concatenate([part.time for part in passed])
        results.append((kept.tolist(), gate.dropped, cut_off(gate), gate.detector.spans.tolist()))
        assert len(kept) == len(rate) if step == 5e-3 else 0 < len(kept) < len(rate)  # so coarse, nothing is seen
    assert all(result == results[0] for result in results)


def test_a_run_resumed_anywhere(tmp_path: Path) -> None:
    recording = clipped(mg.simulate("wide", 120, seed=1).recording, 0.7)
    expected, online = mg.OnlineCalibrator(), mg.OnlineCalibrator()
    columns = recording.time, recording.magnetic_field, recording.angular_rate
    for i in range(0, len(recording.time), 111):
        block = [column[i : i + 111] for column in columns]
        expected.update(*block)
        online.update(*block)
        online.save(tmp_path / "state.npz")
        online = mg.OnlineCalibrator.load(tmp_path / "state.npz")
    assert online.progress == expected.progress
    assert online.progress.clipped.count > 50
    assert online.calibration.to_dict() == expected.calibration.to_dict()


def test_a_state_of_before_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "old.npz", header=np.array(json.dumps({"format": "magyc-gtsam online state 4"})))
    with pytest.raises(mg.MagycError, match=r"format 'magyc-gtsam online state 4', this version reads"):
        mg.OnlineCalibrator.load(tmp_path / "old.npz")


@pytest.mark.parametrize("motion", [*AMPLITUDES, "multi", "dive"])
def test_turns_that_are_not_cut_off_lose_nothing(motion: str) -> None:
    """Clean, held and coarse sensors."""
    time, rate = mg.simulate(motion, seed=0).recording.gyroscope
    for step in (0.0, 3e-4, 1e-3, 3e-3, 0.02):
        watch = watched(Samples(time, np.round(rate / step) * step if step else rate), 480)
        assert cut_off(watch) is None, step
        assert watch.dropped == 0
    assert cut_off(watched(Samples(time, np.repeat(rate[::3], 3, axis=0)[: len(time)]), 480)) is None


def test_coarse_noisy_sensors_are_not_taken_for_cut_off() -> None:
    """Noise of two to ten steps repeats the largest value, too; the batch once took every seventh such log for it."""
    for seed in range(12):
        recording = mg.simulate(list(AMPLITUDES)[seed % 4], 300, seed=seed).recording
        for step in (1e-3, 3e-3, 5e-3):
            coarse = replace(recording, angular_rate=np.round(recording.angular_rate / step) * step)
            assert find_clipped(coarse) is None, (seed, step)


def test_a_gyroscope_that_begins_at_rest_in_steps_is_not_cut_off_at_zero() -> None:
    """An axis that rests at zero and then turns one way only; it was said to be cut off at 0 rad/s, as in BROAD 35."""
    recording = mg.simulate("wide", 120, rate=100.0, seed=3).recording
    rate = np.trunc(recording.angular_rate / 2e-3) * 2e-3
    rate[:, 2] = -np.abs(rate[:, 2]) - 8e-3
    for first in (0, 900, 2000, 5000):
        rate[first : first + 60, 2] = 0.0
    assert find_clipped(replace(recording, angular_rate=rate)) is None


def test_a_turn_at_one_rate_without_noise_is_not_cut_off() -> None:
    time = np.arange(0, 300, 0.1)
    even = np.where((time // 50) % 2 == 0, 0.3, 0.0)[:, None] * [0.0, 0.0, 1.0]
    watch = watched(Samples(time, even))
    assert cut_off(watch) is None
    assert watch.dropped == 0


def test_magyc_ifg_is_watched_too() -> None:
    recording = clipped(mg.simulate("wide", 300, seed=1).recording, 0.9)
    calibration = fed(recording, method="magyc-ifg").calibration
    assert "axis y of the gyroscope cut off at" in calibration.message


def test_on_the_command_line(wide: Simulation, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_mcap(tmp_path / "cut.mcap", clipped(wide.recording, 0.9))
    write_mcap(tmp_path / "much.mcap", clipped(wide.recording, 0.3))
    run = f"--idle 0 --json -o {tmp_path}/out.yaml".split()
    assert main(["online", f"{tmp_path}/cut.mcap", *run]) == 0
    final = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert final["clipped"].startswith("angular_rate: axis y of the gyroscope cut off at ")
    assert main(["online", f"{tmp_path}/much.mcap", *run]) == 1
    assert "raise the gyroscope's full scale" in capsys.readouterr().err


def test_the_rounding_of_a_change_of_axes_is_no_step_of_the_sensor() -> None:
    """A coarse gyroscope at rest, then turned one way only: its largest values are 0 and ±1e-19."""
    random, step = np.random.default_rng(0), 1.1e-3
    rest = np.round(random.normal(-4.0, 2.0, (3000, 3)))
    rest = np.where(rest > 0, -4.0, rest) * step
    turning = -np.abs(np.sin(np.arange(1600)[:, None] * [0.01, 0.013, 0.017])) - 0.01
    rate = np.concatenate([rest, np.round(turning / step) * step])
    dust = rate + 1.3e-19 * random.integers(-1, 2, rate.shape)
    field = 4e-5 + 1e-6 * random.standard_normal(rate.shape)
    for value in (rate, dust):
        assert find_clipped(mg.Recording(0.01 * np.arange(len(value)), field, value)) is None
