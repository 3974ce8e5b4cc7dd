"""Clocks that drift apart: named with their rate where they harm, taken out on request, silent where they do not."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.estimators.smoother.clock_drift import restamped
from magyc_gtsam.estimators.smoother.residuals import window_residuals
from magyc_gtsam.io import write_mcap
from magyc_gtsam.recording.held import with_chance_repeats
from magyc_gtsam.simulation import AMPLITUDES, disturb
from magyc_gtsam.study.efficiency import error, nees

CHI2_11 = 31.3  # 99.9 % point of χ² of 11 degrees of freedom


def drifting(recording: mg.Recording, rate: float) -> mg.Recording:
    """The same with a magnetometer whose clock gains `rate` s/s from the first row on."""
    time = recording.time
    stamps = time[0] + (time - time[0]) * (1 + rate)
    return mg.Recording.from_streams((stamps, recording.magnetic_field), (time, recording.angular_rate))


@pytest.mark.parametrize("rate", [1e-3, -3e-3])
@pytest.mark.parametrize("motion", AMPLITUDES)
def test_a_drift_is_named_and_taken_out(motion: str, rate: float) -> None:
    """Unnoticed, 0.1 % put the hard iron of `moderate` 8 µT off, 8 of its sigmas."""
    simulation = mg.simulate(motion, 400, seed=1)
    recording = drifting(simulation.recording, rate)
    calibration = mg.calibrate(recording)
    assert not calibration.trusted
    assert calibration.message.startswith(f"the magnetometer's clock {'gains' if rate > 0 else 'loses'} 0.")
    assert "(clock_drift=" in calibration.message
    found, sigma = calibration.diagnostics["clock_drift"]
    assert found == pytest.approx(rate / (1 + rate), abs=4 * sigma)
    assert sigma < 3e-5
    corrected = mg.calibrate(recording, clock_drift=found)
    assert corrected.trusted, corrected.message
    assert "clock_drift" not in corrected.diagnostics
    assert corrected.configuration["clock_drift"] == found
    assert nees(error(corrected, simulation.truth), corrected.covariance) < CHI2_11


def test_what_is_left_of_a_drift_is_added_to_what_was_taken_out() -> None:
    recording = drifting(mg.simulate("tiny", seed=1).recording, 4e-3)
    half = mg.calibrate(recording, clock_drift=2e-3)
    assert not half.trusted
    remedy = float(half.message.split("clock_drift=")[1].split(")")[0])
    assert remedy == pytest.approx(4e-3 / 1.004, abs=4e-5)
    assert mg.calibrate(recording, clock_drift=remedy).trusted


@pytest.mark.parametrize(("motion", "rate"), [("wide", 1e-2), ("moderate", -1e-2), ("low", -1e-2), ("tiny", 1e-2)])
def test_one_percent_is_never_trusted(motion: str, rate: float) -> None:
    assert not mg.calibrate(drifting(mg.simulate(motion, 150, seed=1).recording, rate)).trusted


@pytest.mark.parametrize(("motion", "rate"), [("moderate", 1e-5), ("tiny", 3e-5)])
def test_a_drift_without_effect_harms_no_trust(motion: str, rate: float) -> None:
    simulation = mg.simulate(motion, seed=0)
    calibration = mg.calibrate(drifting(simulation.recording, rate))
    assert calibration.trusted, calibration.message
    assert calibration.message.startswith("converged in")
    assert nees(error(calibration, simulation.truth), calibration.covariance) < CHI2_11
    assert "clock_drift" not in calibration.diagnostics


def test_a_drift_with_little_effect_is_noted_and_one_with_more_is_named() -> None:
    """On low turns 0.02 % moves some parameter by about half a sigma: in some logs by less, in others by more."""
    trusted = 0
    for seed in range(4):
        simulation = mg.simulate("low", seed=seed)
        calibration = mg.calibrate(drifting(simulation.recording, 2e-4))
        trusted += calibration.trusted
        if calibration.trusted:
            assert "which moves no parameter by more than 0.5 sigma" in calibration.message
            assert nees(error(calibration, simulation.truth), calibration.covariance) < CHI2_11
        else:
            assert calibration.message.startswith("the magnetometer's clock gains 0.0")
    assert 1 <= trusted < 4


@pytest.mark.parametrize("motion", AMPLITUDES)
def test_neither_disturbances_nor_a_short_log_pass_for_a_drift(motion: str) -> None:
    seed = list(AMPLITUDES).index(motion)
    for recording in (
        disturb(mg.simulate(motion, 300, seed=seed).recording, 0.2, seed=seed),
        mg.simulate(motion, duration=90, seed=seed).recording,
        mg.simulate(motion, duration=300, seed=seed, effects=("gyro-scale", "hard-iron-drift")).recording,
    ):
        assert "clock_drift" not in mg.calibrate(recording).diagnostics


def test_a_drift_among_disturbances() -> None:
    recording = drifting(disturb(mg.simulate("wide", seed=3).recording, 0.1, seed=3), 1e-3)
    calibration = mg.calibrate(recording)
    found, sigma = calibration.diagnostics["clock_drift"]
    assert found == pytest.approx(1e-3 / 1.001, abs=4 * sigma)
    assert calibration.message.startswith(f"the magnetometer's clock gains {100 * found:.3f} %")
    assert mg.calibrate(recording, clock_drift=found).trusted


def test_the_residuals_are_those_of_the_stamps_that_were_used() -> None:
    simulation = mg.simulate("wide", seed=1)
    recording = drifting(simulation.recording, 3e-3)
    corrected = mg.calibrate(recording, clock_drift=3e-3 / 1.003)
    residuals = window_residuals(recording, corrected)
    chi2 = np.square(residuals.magnetic_field / residuals.magnetic_sigma[:, None]).sum(axis=1).mean()
    assert chi2 < 3.5
    again = restamped(recording, 3e-3 / 1.003)
    np.testing.assert_allclose(again.magnetometer.time, simulation.recording.time[: len(again.magnetometer.time)])


def test_no_number_is_refused() -> None:
    recording = mg.simulate("wide", duration=60).recording
    with pytest.raises(mg.MagycError, match=r"clock_drift must be above -0\.1 and below 0\.1 s/s, got 0\.5"):
        mg.calibrate(recording, clock_drift=0.5)


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "drifting.mcap"
    write_mcap(log, drifting(mg.simulate("moderate", seed=1).recording, 1e-3))
    assert main(["calibrate", str(log), "-o", str(tmp_path / "first")]) == 1
    output, errors = capsys.readouterr()
    message = re.search(r"the magnetometer's clock gains (\S+) %", " ".join(errors.split()))
    assert message is not None
    assert float(message[1]) == pytest.approx(0.1, abs=0.01)
    said = " ".join((output + errors).split())
    remedy = said.split("(--option ")[1].split(")")[0]
    assert main(["calibrate", str(log), "-o", str(tmp_path / "second"), "--option", remedy]) == 0
    assert mg.Calibration.load(tmp_path / "second" / "calibration.yaml").trusted


def test_equal_samples_of_a_coarse_sensor_stay_samples_when_the_clock_is_corrected() -> None:
    """They were taken for repeats of the one before, and the delay of such a log was 3 ms early."""
    recording = mg.simulate("tiny", duration=100, seed=1).recording
    field = np.round(recording.magnetic_field / 1.2e-6) * 1.2e-6
    coarse = with_chance_repeats(mg.Recording(recording.time, field, recording.angular_rate))
    assert (np.diff(coarse.magnetometer.value, axis=0) == 0).all(axis=1).any()
    assert len(restamped(coarse, 1e-4).magnetometer.time) == len(coarse.magnetometer.time)
