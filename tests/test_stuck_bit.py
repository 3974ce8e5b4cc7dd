"""A bit of a sensor's converter that always reads the same, or is wrong in some of the readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.recording import Array
from magyc_gtsam.sensor_faults.stuck_bit import StuckBits, stuck_bit
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.signals import record

STEP = 0.15e-6  # T


def codes(field: Array, step: float = STEP) -> np.ndarray:
    return np.rint(field / step).astype(np.int64)


def with_stuck_bit(recording: mg.Recording, worth: int, high: bool = True, axis: int = 1) -> mg.Recording:
    """The recording in steps, with a bit of an axis stuck that is worth so many."""
    read = codes(recording.magnetic_field)
    read[:, axis] = read[:, axis] | worth if high else read[:, axis] & ~worth
    return replace(recording, magnetic_field=read * STEP)


def with_failing_bit(recording: mg.Recording, worth: int, share: float = 0.15, axis: int = 1) -> mg.Recording:
    """The recording in steps, with a bit of an axis inverted in a share of the readings."""
    read = codes(recording.magnetic_field)
    read[:, axis] ^= worth * (np.random.default_rng(worth).random(len(read)) < share)
    return replace(recording, magnetic_field=read * STEP)


@pytest.fixture(scope="module")
def recording() -> mg.Recording:
    return mg.simulate("wide", 200, rate=20, seed=3, magnetometer_noise=0.3e-6).recording


@pytest.mark.parametrize("high", [True, False])
@pytest.mark.parametrize("worth", [2, 4, 16, 32])
def test_it_is_found_whatever_the_offset_and_the_scale(recording: mg.Recording, worth: int, high: bool) -> None:
    field = with_stuck_bit(recording, worth, high).magnetic_field
    for read in (
        field,
        field.astype(np.float32).astype(float),
        1.37 * field + 3.21e-6,
        codes(field).astype(float),
    ):
        found = stuck_bit(read)
        assert found is not None
        assert found.axis == 1
        assert found.worth / (np.ptp(read[:, 1]) / np.ptp(codes(field[:, 1]))) == pytest.approx(worth, rel=1e-3)


@pytest.mark.parametrize("step", [0.02e-6, 0.15e-6, 0.6e-6, 3e-6])
@pytest.mark.parametrize("motion", ["wide", "tiny"])
def test_a_sound_sensor_in_steps_has_none(motion: str, step: float) -> None:
    field = mg.simulate(motion, 300, seed=2).recording.magnetic_field
    assert stuck_bit(field) is None
    assert stuck_bit(codes(field, step) * step) is None
    assert stuck_bit(field.astype(np.float32).astype(float)) is None
    assert stuck_bit(codes(field, step) // 16 * 16 * step) is None  # the lowest bits are not used
    assert stuck_bit(np.rint(1.25 * codes(field, step)) * step) is None  # scaled in whole numbers


def test_positions_at_rest_are_no_stretches() -> None:
    """Twelve positions at the same distance, with noise of as many steps as a bit might be worth."""
    random = np.random.default_rng(1)
    for noise in (0, 1, 2, 4, 8):
        place = np.repeat(random.permutation(12), 300)[:, None] * 64 + np.zeros(3)
        assert stuck_bit(np.rint(place + random.normal(0, noise, place.shape)) * STEP) is None


def test_short_and_constant_readings() -> None:
    assert stuck_bit(np.zeros((1, 3))) is None
    assert stuck_bit(np.full((700, 3), 4e-5)) is None
    assert stuck_bit(np.repeat([[0.0, 1.0, 1.0], [1e9, 2.0, 1.0]], 400, axis=0)) is None


def test_no_calibration_is_trusted(recording: mg.Recording) -> None:
    calibration = mg.calibrate(with_stuck_bit(recording, 4))
    assert not calibration.trusted
    assert calibration.message.startswith(
        "magnetic_field: the bit worth 0.6 µT of axis y of the magnetometer is stuck"
    )
    assert mg.calibrate(replace(recording, magnetic_field=codes(recording.magnetic_field) * STEP)).trusted


def test_online_does_not_converge_and_a_saved_state_goes_on(recording: mg.Recording) -> None:
    bad = with_stuck_bit(recording, 4)
    online = mg.OnlineCalibrator()
    online.update(bad.time[:2000], bad.magnetic_field[:2000], bad.angular_rate[:2000])  # type: ignore[index]
    assert not online.progress.converged
    assert "the bit worth 0.6 µT of axis y" in online.progress.sentence
    watch, again = StuckBits(), StuckBits()
    watch.observe(bad.magnetic_field[:1999])
    again.restore(watch.state())
    for each in (watch, again):
        each.observe(recording.magnetic_field[2000:2300])  # sound again: what was found remains
        found = each.finding()
        assert found is not None
        assert found.axis == "y"


@pytest.mark.parametrize("motion", ["wide", "moderate", "low", "tiny"])
@pytest.mark.parametrize("worth", [64, 128])
def test_a_bit_that_fails_at_times_is_found_on_every_motion(motion: str, worth: int) -> None:
    sound = mg.simulate(motion, 600, seed=worth).recording
    for share in (0.05, 0.15):
        found = stuck_bit(with_failing_bit(sound, worth, share).magnetic_field)
        assert found is not None
        assert (found.axis, found.always) == (1, False)
        assert found.worth == pytest.approx(worth * STEP)


@pytest.mark.parametrize(
    "name", ["two-sided-spikes", "one-sided-spikes", "one-axis-spikes", "noise-bursts", "sign-flips"]
)
def test_other_readings_that_stand_out_are_no_failing_bit(name: str) -> None:
    fault = FAULTS[name]
    for motion in ("wide", "moderate", "low", "tiny"):
        for strength in (fault.weak, fault.strong):
            field = record(motion, 5, fault, strength, name).field
            assert stuck_bit(codes(field) * STEP) is None


def test_noise_that_is_not_white_is_no_failing_bit_in_a_long_log() -> None:
    """The neighbours that tell the stretch move with those that a reading is compared with."""
    random = np.random.default_rng(3)
    drift = np.cumsum(random.normal(0, 0.3, (40000, 3)), axis=0)
    noise = random.normal(0, 4, (40000, 3)) + (drift - np.roll(drift, 20, axis=0))
    assert stuck_bit(np.rint(noise + 40 * np.sin(np.arange(40000) / 900)[:, None]) * STEP) is None


def test_online_and_batch_refuse_a_bit_that_fails_from_some_time_on() -> None:
    """Both trusted it, with the hard iron off by 3 µT."""
    sound = mg.simulate("tiny", 700, seed=2).recording
    before, after = codes(sound.magnetic_field[:4000]) * STEP, with_failing_bit(sound, 64).magnetic_field[4000:]
    bad = replace(sound, magnetic_field=np.vstack([before, after]))
    message = "magnetic_field: the bit worth 9.6 µT of axis y of the magnetometer is wrong in some of the readings"
    assert mg.calibrate(bad).message.startswith(message)
    online = mg.OnlineCalibrator()
    online.update(bad.time, bad.magnetic_field, bad.angular_rate)  # type: ignore[arg-type]
    assert not online.converged
    assert online.calibration is not None
    assert not online.calibration.trusted
    assert online.progress.sentence.startswith(message)


def with_stuck_rate_bit(recording: mg.Recording, worth: int, step: float = 1.2e-3, axis: int = 2) -> mg.Recording:
    """The recording with rates in steps (rad/s), with a bit of an axis that is always set."""
    assert recording.angular_rate is not None
    read = codes(recording.angular_rate, step)
    read[:, axis] |= worth
    return replace(recording, angular_rate=read * step)


@pytest.mark.parametrize("motion", ["wide", "moderate", "tiny"])
def test_a_stuck_bit_of_the_gyroscope_is_refused_in_batch_and_online(motion: str) -> None:
    """The bias was off by half of what the bit is worth, at 50 sigmas, and trusted."""
    sound = mg.simulate(motion, 400, seed=6).recording
    message = "angular_rate: the bit worth 19.2 mrad/s of axis z of the gyroscope is stuck"
    for worth in (0, 16):
        bad = with_stuck_rate_bit(sound, worth)
        calibration, online = mg.calibrate(bad), mg.OnlineCalibrator()
        online.update(bad.time, bad.magnetic_field, bad.angular_rate)  # type: ignore[arg-type]
        assert calibration.message.startswith(message) == (worth > 0)
        assert calibration.trusted == (worth == 0)
        assert online.progress.sentence.startswith(message) == (worth > 0)
        assert not (worth and online.converged)


def test_a_gap_with_a_stuck_bit_of_the_gyroscope_is_open() -> None:
    bad = with_stuck_rate_bit(mg.simulate("wide", 300, seed=6).recording, 16)
    gap = mg.find_gap(bad, candidates=["timing"])
    assert gap.verdict == "open"
    assert gap.sentence.startswith("angular_rate: the bit worth 19.2 mrad/s of axis z of the gyroscope is stuck")
    assert gap.doubt is not None
    assert gap.doubt.cause == "a bit of axis z of the gyroscope is stuck"
    assert not gap.calibration.trusted


def with_failing_rate_bit(
    recording: mg.Recording, worth: int, share: float, step: float = 1e-3, axis: int = 2
) -> mg.Recording:
    """The recording with rates in steps (rad/s), with a bit of an axis set in a share of the readings."""
    assert recording.angular_rate is not None
    read = codes(recording.angular_rate, step)
    read[:, axis] |= worth * (np.random.default_rng(worth).random(len(read)) < share)
    return replace(recording, angular_rate=read * step)


@pytest.mark.parametrize("noise", [1e-3, 5e-3])
@pytest.mark.parametrize("motion", ["wide", "moderate", "low", "tiny"])
def test_a_bit_of_the_gyroscope_that_fails_at_times_is_found_on_every_motion(motion: str, noise: float) -> None:
    """The bias was off by half of what the readings are on average, and trusted, at 20 to 40 sigmas."""
    sound = mg.simulate(motion, 600, seed=8, gyroscope_noise=noise).recording
    message = "angular_rate: the bit worth {} mrad/s of axis z of the gyroscope is wrong in some of the readings"
    for worth, share in ((64, 0.05), (64, 0.15), (256, 0.05)):
        bad = with_failing_rate_bit(sound, worth, share)
        found = stuck_bit(bad.angular_rate)  # type: ignore[arg-type]
        assert found is not None
        assert (found.axis, found.always) == (2, False)
        assert found.worth == pytest.approx(worth * 1e-3)
    calibration = mg.calibrate(with_failing_rate_bit(sound, 64, 0.15))
    assert not calibration.trusted
    assert calibration.message.startswith(message.format(64))
    assert mg.calibrate(with_failing_rate_bit(sound, 64, 0.0)).trusted


def test_online_and_a_gap_refuse_a_bit_of_the_gyroscope_that_fails() -> None:
    bad = with_failing_rate_bit(mg.simulate("tiny", 600, seed=8).recording, 64, 0.15)
    message = "angular_rate: the bit worth 64 mrad/s of axis z of the gyroscope is wrong in some of the readings"
    online = mg.OnlineCalibrator()
    online.update(bad.time, bad.magnetic_field, bad.angular_rate)  # type: ignore[arg-type]
    assert not online.converged
    assert online.progress.sentence.startswith(message)
    gap = mg.find_gap(bad, candidates=["timing"])
    assert gap.verdict == "open"
    assert gap.sentence.startswith(message)
    assert gap.doubt is not None
    assert gap.doubt.cause == "a bit of axis z of the gyroscope is wrong in some of the readings"
    assert not gap.calibration.trusted


def test_a_bit_whose_readings_are_left_out_as_spikes_is_not_refused() -> None:
    sound = mg.simulate("wide", 600, seed=8).recording
    calibration = mg.calibrate(with_failing_rate_bit(sound, 1024, 0.02))
    assert calibration.trusted
    assert "spikes of the gyroscope" in calibration.message


def test_quick_turns_in_steps_are_no_fault_of_the_gyroscope() -> None:
    """Their peaks stand out upwards at high rates and downwards at low ones, as the readings of a failing bit do.

    So do the steps of a walk, of which one axis of a phone in a pocket had a bit at 47 Hz.
    """
    time = np.arange(6000) / 20
    quick = (np.sin(time / 7) > 0.9)[:, None] * 1.5 * np.sin(2 * np.pi * 5.3 * time[:, None] + np.arange(3))
    rate = quick + np.random.default_rng(2).normal(0, 5e-3, (6000, 3))
    for step in (2e-4, 1.2e-3, 5e-3):
        assert stuck_bit(np.rint(rate / step) * step) is None
