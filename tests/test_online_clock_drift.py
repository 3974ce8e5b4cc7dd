"""Clocks that drift apart, noticed while the samples come in: said and not trusted as by the batch, and taken out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_clock_drift import drifting

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.io import write_mcap
from magyc_gtsam.simulation import disturb
from magyc_gtsam.study.efficiency import error, nees

CHI2_11 = 31.3  # 99.9 % point of χ² of 11 degrees of freedom


def feed(online: mg.OnlineCalibrator, recording: mg.Recording, step: float = 20.0, after: Any = None) -> Any:
    """Each sensor's own samples, `step` seconds at a time."""
    mag, gyro = recording.magnetometer, recording.gyroscope
    for edge in range(int(recording.time[-1] / step) + 1):
        between = [edge * step, (edge + 1) * step]
        rows = slice(*np.searchsorted(mag.time, between))
        online.update(mag.time[rows], mag.value[rows])
        rows = slice(*np.searchsorted(gyro.time, between))
        online.update(gyro.time[rows], angular_rate=gyro.value[rows])
        if after is not None:
            online = after(online) or online
    return online


@pytest.mark.parametrize(("motion", "rate"), [("moderate", 1e-3), ("low", -5e-3)])
def test_a_drift_is_named_as_by_the_batch_and_taken_out(motion: str, rate: float) -> None:
    """Unnoticed, 0.1 % put the hard iron of `moderate` 9 µT off, 9 of its sigmas, in a converged result."""
    simulation = mg.simulate(motion, 220, seed=1)
    recording = drifting(simulation.recording, rate)
    online, batch = feed(mg.OnlineCalibrator(), recording), mg.calibrate(recording)
    calibration = online.calibration
    assert not online.converged
    assert not online.progress.converged
    assert online.changes == ()
    assert not batch.trusted
    assert not calibration.trusted
    beginning = f"the magnetometer's clock {'gains' if rate > 0 else 'loses'} 0."
    assert calibration.message.startswith(beginning)
    assert batch.message.startswith(beginning)
    assert online.progress.sentence == calibration.message
    found, sigma = calibration.diagnostics["clock_drift"]
    assert found == pytest.approx(batch.diagnostics["clock_drift"][0], abs=5 * sigma)
    remedy = float(calibration.message.split("clock_drift=")[1].split(")")[0])
    online = feed(mg.OnlineCalibrator(clock_drift=remedy), recording)
    corrected = online.calibration
    assert online.converged
    assert corrected.trusted, corrected.message
    assert corrected.configuration["clock_drift"] == remedy
    assert nees(error(corrected, simulation.truth), corrected.covariance) < CHI2_11


@pytest.mark.parametrize("motion", ["wide", "low"])
def test_one_percent_is_never_trusted(motion: str) -> None:
    online = feed(mg.OnlineCalibrator(), drifting(mg.simulate(motion, 120, seed=1).recording, 1e-2))
    assert not online.converged
    assert not online.calibration.trusted


def test_what_is_left_of_a_drift_is_added_to_what_was_taken_out() -> None:
    recording = drifting(mg.simulate("tiny", 260, seed=1).recording, 4e-3)
    half = feed(mg.OnlineCalibrator(clock_drift=2e-3), recording)
    assert not half.converged
    remedy = float(half.calibration.message.split("clock_drift=")[1].split(")")[0])
    assert remedy == pytest.approx(4e-3 / 1.004, abs=2e-4)


@pytest.mark.parametrize("motion", ["moderate", "tiny", "disturbed"])
def test_clocks_that_keep_step_are_not_accused(motion: str) -> None:
    """Whenever they are asked."""
    recording = mg.simulate("low" if motion == "disturbed" else motion, 200, seed=2).recording
    if motion == "disturbed":
        recording = disturb(recording.between(0, 150), 0.1, seed=2)
    said: list[str] = []

    def look(online: mg.OnlineCalibrator) -> None:
        calibration = online.calibration
        said.append("" if calibration is None else calibration.message)

    feed(mg.OnlineCalibrator(), recording, step=40.0, after=look)
    assert not any("clock" in message for message in said)


def test_it_is_said_when_it_speaks_not_only_at_the_next_refit() -> None:
    """What is read does not depend on what was read before."""
    recording = drifting(mg.simulate("moderate", 230, seed=5).recording, 4e-4)
    heard: list[bool] = []
    swept: list[bool] = []

    def look(online: mg.OnlineCalibrator) -> None:
        calibration = online.calibration
        heard.append(calibration is not None and "the magnetometer's clock gains" in calibration.message)
        swept.append(online._engine._online.belief.drift is not None)  # type: ignore[attr-defined]

    online = feed(mg.OnlineCalibrator(), recording, after=look)
    assert heard.index(True) < swept.index(True)
    assert all(heard[heard.index(True) :])
    assert feed(mg.OnlineCalibrator(), recording).calibration.to_dict() == online.calibration.to_dict()


@pytest.mark.parametrize(("options", "duration"), [({}, 150), ({"clock_drift": 1.9e-3}, 240)])
def test_how_it_is_cut_and_resumed_does_not_matter(
    tmp_path: Path, options: dict[str, Any], duration: float
) -> None:
    recording = drifting(mg.simulate("tiny", duration, seed=2).recording, 2e-3)
    expected = feed(mg.OnlineCalibrator(**options), recording)

    def killed(online: mg.OnlineCalibrator) -> mg.OnlineCalibrator:
        online.save(tmp_path / "state.npz")
        return mg.OnlineCalibrator.load(tmp_path / "state.npz")

    online = feed(mg.OnlineCalibrator(**options), recording, step=37.3, after=killed)
    assert online.converged == expected.converged
    assert online.progress == expected.progress
    assert online.calibration.to_dict() == expected.calibration.to_dict()
    assert expected.converged == bool(options)


def test_no_number_is_refused() -> None:
    with pytest.raises(mg.MagycError, match=r"clock_drift must be above -0\.1 and below 0\.1 s/s, got 0\.5"):
        mg.OnlineCalibrator(clock_drift=0.5)


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_mcap(tmp_path / "log.mcap", drifting(mg.simulate("tiny", 220, seed=1).recording, 1e-3))
    run = ["online", f"{tmp_path}/log.mcap", "--idle", "0", "--json", "-o", f"{tmp_path}/out.yaml"]
    assert main(run) == 1
    out, err = capsys.readouterr()
    assert "must not be trusted: the magnetometer's clock gains 0." in err
    assert "(--option clock_drift=" in err
    final = json.loads(out.splitlines()[-1])
    assert not final["converged"]
    assert main([*run, "--option", final["sentence"].split("(--option ")[1].split(")")[0]]) == 0
