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
    assert RepeatedEntries.of(coarse).repetition.rows == 1
    assert with_chance_repeats(coarse).magnetic_field_fresh.mean() > 0.99
    found = mg.calibrate(coarse)
    assert abs(found.delay) < 2 * found.delay_sigma
    firsts = coarse.magnetic_field_fresh  # the first reading of each run alone
    early = mg.calibrate(replace(coarse, magnetic_field_fresh=firsts, magnetic_field_stamped=firsts))
    assert early.delay < found.delay - 2.5 * found.delay_sigma


def test_the_coarser_the_steps_the_longer_are_runs_that_are_samples() -> None:
    recording = mg.simulate("ship", duration=300, rate=20.0, seed=351, magnetometer_noise=0.1e-6).recording
    coarse = reading(recording, np.round(recording.magnetic_field / 1e-6) * 1e-6)
    place = np.flatnonzero(coarse.magnetic_field_fresh)
    assert np.diff(place).max() > 20
    assert with_chance_repeats(coarse).magnetic_field_fresh.mean() > 0.99


def test_of_three_rows_none_says_how_many_make_a_sample() -> None:
    rate = np.array([[1.0, 2, 3], [1, 4, 5], [1, 4, 5]])
    log = mg.Recording(0.1 * np.arange(3), slow(1).magnetic_field[:3], rate)
    assert log.angular_rate_fresh.tolist() == [True, True, False]


@pytest.mark.parametrize("times", [2, 4])
def test_a_hold_is_left_out(times: int) -> None:
    recording = slow(1)
    field = np.repeat(recording.magnetic_field[::times], times, axis=0)[: len(recording.time)]
    held = reading(recording, field)
    assert RepeatedEntries.of(held).held
    assert np.isinf(RepeatedEntries.of(held).repetition.rows)
    assert with_chance_repeats(held) is held


@pytest.mark.parametrize("times", [2, 3, 5])
def test_of_coarse_samples_that_are_held_each_counts_once(times: int) -> None:
    """As on a phone that is read faster than its magnetometer measures; the first of equal samples alone is early."""
    options = {"rate": 20.0 * times, "magnetometer_noise": 0.1e-6, "gyroscope_noise": 5e-4}
    recording = mg.simulate("moderate", duration=120, seed=5, **options).recording
    field = np.repeat(recording.magnetic_field[::times], times, axis=0)[: len(recording.time)]
    held = reading(recording, np.round(field / STEP) * STEP)
    assert RepeatedEntries.of(held).repetition.rows == times
    missed = with_chance_repeats(held).magnetic_field_fresh != (np.arange(len(field)) % times == 0)
    assert missed.mean() < 0.01
    found, early = (
        mg.calibrate(held),
        mg.calibrate(replace(held, magnetic_field_stamped=held.magnetic_field_fresh)),
    )
    assert abs(found.delay) < 2 * found.delay_sigma
    assert early.delay < found.delay - 2 * found.delay_sigma


def test_coarse_samples_of_a_clock_of_its_own_are_not_counted_twice() -> None:
    """With 2.3 rows to a sample, runs of two and three rows are one sample each."""
    recording = mg.simulate("moderate", duration=120, rate=50.0, seed=6, magnetometer_noise=0.1e-6).recording
    rows = np.arange(len(recording.time))
    taken = np.ceil(np.floor(rows / 2.3) * 2.3).astype(int)
    held = reading(recording, np.round(recording.magnetic_field[taken] / STEP) * STEP)
    assert RepeatedEntries.of(held).repetition.rows == pytest.approx(2.3, abs=0.2)
    samples = with_chance_repeats(held).magnetic_field_fresh.sum()
    assert samples == pytest.approx(len(np.unique(taken)), rel=0.02)
    assert held.magnetic_field_fresh.sum() < 0.95 * samples


def test_single_entries_that_a_logger_repeats_are_left_out() -> None:
    """One entry in thirty repeats the one before on all axes, more than coarse steps explain."""
    recording = mg.simulate("wide", duration=120, seed=4).recording
    field = np.round(recording.magnetic_field / 1e-6) * 1e-6
    field[30::30] = field[29:-1:30]
    repeated = reading(recording, field)
    assert 1 < RepeatedEntries.of(repeated).repetition.rows < 1.1
    np.testing.assert_array_equal(
        with_chance_repeats(repeated).magnetic_field_fresh, repeated.magnetic_field_fresh
    )


def test_a_sensor_that_is_stuck_at_coarse_steps_has_no_samples() -> None:
    recording = slow(1)
    field = np.round(recording.magnetic_field / STEP) * STEP
    field[2000:2400] = field[2000]
    stuck = with_chance_repeats(reading(recording, field))
    assert stuck.magnetic_field_fresh[:2000].all()
    assert not stuck.magnetic_field_fresh[2016:2400].any()
    found, without = mg.calibrate(stuck), mg.calibrate(recording)
    assert found.covariance is not None
    sigma = np.sqrt(np.diag(found.covariance))[6:9]
    assert (np.abs(found.hard_iron - without.hard_iron) < 2 * sigma).all()


@pytest.mark.parametrize(("times", "step", "seed"), [(1, 4e-3, 400), (1, 2e-3, 402), (3, 1e-3, 401)])
def test_a_coarse_gyroscope_on_a_slow_ship_makes_no_delay(times: int, step: float, seed: int) -> None:
    """A third and more of its readings repeat on all axes, as if it were held; the delay was up to 34 ms off."""
    options = {"rate": 20.0 * times, "magnetometer_noise": 0.1e-6, "gyroscope_noise": 3e-4}
    recording = mg.simulate("ship", duration=300, seed=seed, **options).recording
    assert recording.angular_rate is not None
    rows = np.arange(len(recording.time))
    coarse = np.round(recording.angular_rate / step)[rows // times * times] * step
    assert (coarse[1:] == coarse[:-1]).all(axis=1).mean() > 0.3
    log = mg.Recording(recording.time, recording.magnetic_field, coarse)
    assert (log.angular_rate_fresh != (rows % times == 0)).mean() < 0.01
    found = mg.calibrate(log)
    assert abs(found.delay) < 2 * found.delay_sigma


@pytest.mark.parametrize("step", [None, 4e-3])
@pytest.mark.parametrize("apart", [0.0, 1e-3])
def test_a_gyroscope_that_is_held_in_a_stream_of_its_own(apart: float, step: float | None) -> None:
    """A table and two topics of the same log are the same samples; each entry at its stamp is 17 ms late."""
    options = {"rate": 60.0, "magnetometer_noise": 0.1e-6, "gyroscope_noise": 3e-4}
    recording = mg.simulate("low", duration=120, seed=401, **options).recording
    assert recording.angular_rate is not None
    rate = recording.angular_rate[np.arange(len(recording.time)) // 3 * 3]
    rate = rate if step is None else np.round(rate / step) * step
    streams = mg.Recording.from_streams((recording.time, recording.magnetic_field), (recording.time + apart, rate))
    assert len(streams.gyroscope.time) == pytest.approx(len(rate) / 3, rel=0.01)
    found = mg.calibrate(streams)
    assert abs(found.delay + apart) < 2.5 * found.delay_sigma
    if not apart:
        table = mg.calibrate(mg.Recording(recording.time, recording.magnetic_field, rate))
        np.testing.assert_allclose(found.hard_iron, table.hard_iron, rtol=0, atol=1e-9)
