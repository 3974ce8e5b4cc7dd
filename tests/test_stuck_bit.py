"""A bit of the magnetometer's converter that always reads the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.recording import Array
from magyc_gtsam.sensor_faults.stuck_bit import StuckBits, stuck_bit

STEP = 0.15e-6  # T


def codes(field: Array, step: float = STEP) -> np.ndarray:
    return np.rint(field / step).astype(np.int64)


def with_stuck_bit(recording: mg.Recording, worth: int, high: bool = True, axis: int = 1) -> mg.Recording:
    """The recording in steps, with a bit of an axis stuck that is worth so many."""
    read = codes(recording.magnetic_field)
    read[:, axis] = read[:, axis] | worth if high else read[:, axis] & ~worth
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
