"""Samples that get lost: what the motion between the others adds to the sigmas, and when too little of it is left."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import run

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import added_variance, short_term_noise
from magyc_gtsam.factors.chain.rotations import increments
from magyc_gtsam.factors.chain.unresolved import RateSpectrum
from magyc_gtsam.io import write_mcap
from magyc_gtsam.online.buffers import SampleBuffer
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.simulation import FIELD, GYRO_BIAS, HARD_IRON, SOFT_IRON
from magyc_gtsam.simulation.motion import MOTIONS, kinematics

RATE = 10.0  # Hz, before samples are lost
NOISE = (1e-6, 5e-3)  # T, rad/s
TOO_FEW = "are too few for this motion"


def moved(period: float, seed: int, swell: float = 5.0, duration: float = 600.0) -> tuple[Array, Array, Array]:
    """Stamps, fields and rates on wide motion with a swell of this period, s, and amplitude, degrees."""
    random = np.random.default_rng(seed)
    time = np.arange(round(duration * RATE)) / RATE
    angle, derivative = MOTIONS["wide"](random)(time)
    frequency = 2 * np.pi / (period * random.uniform(0.95, 1.05, 3))
    argument = time[:, None] * frequency + random.uniform(-np.pi, np.pi, 3)
    amplitude = np.deg2rad(swell)
    angle, derivative = angle + amplitude * np.sin(argument), derivative + amplitude * frequency * np.cos(argument)
    attitude, rate = kinematics(angle, derivative)
    noise = random.standard_normal((2, len(time), 3))
    field = attitude.inv().apply(FIELD) @ SOFT_IRON.T + HARD_IRON + NOISE[0] * noise[0]
    return time, field, rate + GYRO_BIAS + NOISE[1] * noise[1]


def rows_lost(period: float, share: float, seed: int, swell: float = 5.0) -> mg.Recording:
    time, field, rate = moved(period, seed, swell)
    kept = np.random.default_rng(seed).random(len(time)) >= share
    return mg.Recording(time[kept], field[kept], rate[kept])


def gyroscope_lost(period: float, share: float, seed: int) -> mg.Recording:
    time, field, rate = moved(period, seed)
    kept = np.random.default_rng(seed).random(len(time)) >= share
    return mg.Recording.from_streams((time, field), (time[kept], rate[kept]))


@pytest.mark.parametrize("share", [0.0, 0.5, 0.8])
def test_the_spectrum_of_uneven_samples_is_that_of_the_motion(share: float) -> None:
    """An oscillation of 2 s about x and a slow one about z, whose variances are 0.02 and 0.005 rad²/s²."""
    for seed in range(4):
        random = np.random.default_rng(seed)
        time = np.arange(6000) / RATE
        rate = np.stack([0.2 * np.sin(np.pi * time), 0 * time, 0.1 * np.sin(time / 5)], axis=1)
        rate += 5e-3 * random.standard_normal(rate.shape)
        kept = random.random(len(time)) >= share
        found = RateSpectrum.of(time[kept], rate[kept])
        fast = np.abs(found.frequency - 0.5) < 0.1
        assert 3 * found.power[fast].sum() == pytest.approx(0.02, rel=0.2)
        assert 3 * found.power[~fast].sum() == pytest.approx(0.005, rel=0.5)


@pytest.mark.parametrize("period", [1.5, 3.0])
def test_the_turn_across_a_step_is_as_wrong_as_stated(period: float) -> None:
    """Half of the samples lost, without noise: the error over steps of each length is 0.6 to 1.7 times the stated."""
    time = np.arange(60000) / RATE
    kept = time[np.random.default_rng(1).random(len(time)) >= 0.5]
    frequency = 2 * np.pi / period * np.array([0.93, 1.0, 1.07])
    rate = 0.01 * np.sin(kept[:, None] * frequency + [0.0, 1.0, 2.0])  # so slow that no rotation matters
    exact = -0.01 / frequency * np.diff(np.cos(kept[:, None] * frequency + [0.0, 1.0, 2.0]), axis=0)
    wrong = np.square(increments(kept, rate) - exact).mean(axis=1)
    step = np.diff(kept)
    stated = RateSpectrum.of(kept, rate).variance(step)
    for length in (0.3, 0.4, 0.6, 0.8):
        alike = np.abs(step - length) < 0.01
        assert 0.6 < np.sqrt(wrong[alike].mean() / stated[alike].mean()) < 1.7


def test_the_gyroscopes_noise_is_found_where_samples_are_lost() -> None:
    """Second differences over the uneven steps give two to nine times as much."""
    for share in (0.3, 0.5, 0.7):
        found = [short_term_noise(rows_lost(2.0, share, seed)).gyroscope for seed in range(4)]
        assert 0.75 * NOISE[1] < min(found) <= max(found) < 1.35 * NOISE[1]


def test_sound_samples_add_nothing() -> None:
    assert added_variance(rows_lost(2.0, 0.0, 1).gyroscope) is None
    for seed in range(4):  # samples at times between those of a regular clock
        time = np.arange(6000) / RATE + np.random.default_rng(seed).uniform(-0.03, 0.03, 6000)
        rate = np.stack([0.1 * np.sin(time * k) for k in (0.2, 0.7, 1.5)], axis=1)
        rate += NOISE[1] * np.random.default_rng(seed).standard_normal(rate.shape)
        added = added_variance(Samples(time, rate))
        assert added is None or added.sum() < 0.1 * np.square(np.diff(time)).sum()


def test_the_error_is_smaller_by_what_the_long_steps_count_less() -> None:
    """Of a swell of 2 s the gyroscope loses half of its samples: 0.18 µT without, stated 0.11."""
    errors, scores = [], []
    for seed in range(20, 32):
        calibration = mg.calibrate(gyroscope_lost(2.0, 0.45, seed), misalignment=0)
        error, covariance = calibration.hard_iron - HARD_IRON, calibration.covariance[6:9, 6:9]
        assert calibration.trusted, calibration.message
        errors.append(error)
        scores.append(error @ np.linalg.solve(covariance, error))
    assert np.sqrt(np.square(errors).mean()) < 0.12e-6
    assert np.mean(scores) < 3 + 3 * np.sqrt(2 * 3 / len(scores))


@pytest.mark.parametrize(("period", "share", "told"), [(2.0, 0.75, True), (2.0, 0.4, False), (20.0, 0.8, False)])
def test_too_few_samples_for_the_motion_are_said(period: float, share: float, told: bool) -> None:
    for seed in range(3):
        calibration = mg.calibrate(rows_lost(period, share, seed, swell=10.0))
        assert (TOO_FEW in calibration.message) == told
        assert calibration.trusted != told, calibration.message


def test_all_ways_to_calibrate_say_it(tmp_path: Path) -> None:
    recording = rows_lost(2.0, 0.8, 5, swell=10.0)
    gap = mg.find_gap(recording).calibration
    online = mg.OnlineCalibrator()
    for i in range(0, len(recording.time), 100):
        rows = slice(i, i + 100)
        online.update(recording.time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
    assert online.calibration is not None
    for calibration in (gap, online.calibration):
        assert not calibration.trusted
        assert TOO_FEW in calibration.message
    write_mcap(tmp_path / "lossy.mcap", recording)
    finished = run("calibrate", "lossy.mcap", cwd=tmp_path)
    assert finished.returncode == 1
    assert TOO_FEW in " ".join((finished.stdout + finished.stderr).split())


def test_online_adds_the_same_variance() -> None:
    recording = rows_lost(2.0, 0.6, 3)
    buffer = SampleBuffer(1.5, 0.2, interval_mean=False)
    buffer.append(recording.magnetometer, recording.gyroscope)
    last = int(buffer.numbers[-1])
    piece = buffer.windows(last - 60, last, 0.0)
    whole = added_variance(recording.gyroscope)
    assert piece.added_variance is not None
    assert whole is not None
    rows = slice(*np.searchsorted(recording.gyroscope.time, piece.gyroscope_time[[0, -1]]))
    assert piece.added_variance.sum() == pytest.approx(whole[rows].sum(), rel=0.4)
