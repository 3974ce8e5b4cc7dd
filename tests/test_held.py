"""Repeated values of a magnetometer: held by a log that polls too fast, or due to coarse steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.recording.held import RepeatedEntries, with_chance_repeats

STEP = 0.6e-6  # T, of an AK09911


def slow(seed: int) -> mg.Recording:
    """A slow turn, in which a quarter of the coarse readings repeat."""
    options = {"rate": 20.0, "magnetometer_noise": 0.15e-6, "gyroscope_noise": 5e-4}
    return mg.simulate("ship", duration=300, seed=seed, **options).recording


def reading(recording: mg.Recording, field: np.ndarray) -> mg.Recording:
    return replace(recording, magnetic_field=field, magnetic_field_fresh=None, magnetic_field_stamped=None)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_coarse_steps_do_not_make_the_magnetometer_seem_early(seed: int) -> None:
    recording = slow(seed)
    coarse = reading(recording, np.round(recording.magnetic_field / STEP) * STEP)
    assert (~coarse.magnetic_field_fresh).mean() > 0.1
    assert RepeatedEntries.of(coarse).by_chance
    assert with_chance_repeats(coarse).magnetic_field_fresh.mean() > 0.99
    found = mg.calibrate(coarse)
    assert abs(found.delay) < 2 * found.delay_sigma
    firsts = coarse.magnetic_field_fresh  # the first reading of each run alone
    early = mg.calibrate(replace(coarse, magnetic_field_fresh=firsts, magnetic_field_stamped=firsts))
    assert early.delay < found.delay - 2.5 * found.delay_sigma


@pytest.mark.parametrize("step", [0.0, STEP])
@pytest.mark.parametrize("times", [2, 4])
def test_a_hold_is_left_out(step: float, times: int) -> None:
    recording = slow(1)
    field = np.repeat(recording.magnetic_field[::times], times, axis=0)[: len(recording.time)]
    held = reading(recording, np.round(field / step) * step if step else field)
    assert RepeatedEntries.of(held).held or step  # chance makes the runs of a hold irregular
    assert not RepeatedEntries.of(held).by_chance
    assert with_chance_repeats(held) is held


def test_single_entries_that_a_logger_repeats_are_left_out() -> None:
    """One entry in thirty repeats the one before on all axes, more than coarse steps explain."""
    recording = mg.simulate("wide", duration=120, seed=4).recording
    field = np.round(recording.magnetic_field / 1e-6) * 1e-6
    field[30::30] = field[29:-1:30]
    repeated = reading(recording, field)
    assert not RepeatedEntries.of(repeated).by_chance
    assert with_chance_repeats(repeated) is repeated


def test_a_sensor_that_is_stuck_at_coarse_steps_has_no_samples() -> None:
    recording = slow(1)
    field = np.round(recording.magnetic_field / STEP) * STEP
    field[2000:2400] = field[2000]
    stuck = with_chance_repeats(reading(recording, field))
    assert stuck.magnetic_field_fresh[:2000].all()
    assert not stuck.magnetic_field_fresh[2012:2400].any()
    found, without = mg.calibrate(stuck), mg.calibrate(recording)
    assert found.covariance is not None
    sigma = np.sqrt(np.diag(found.covariance))[6:9]
    assert (np.abs(found.hard_iron - without.hard_iron) < 2 * sigma).all()
