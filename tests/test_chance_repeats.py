"""Repeated readings of the magnetometer online: samples if coarse steps explain them, as in the batch."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from test_held import STEP, reading, slow

import magyc_gtsam as mg
from magyc_gtsam.online.chance_repeats import ChanceRepeats
from magyc_gtsam.online.smoother import OnlineSmoother
from magyc_gtsam.recording import Samples
from magyc_gtsam.recording.held import with_chance_repeats


def coarse(seed: int, times: int = 1) -> mg.Recording:
    """A slow turn in coarse steps, with every reading held for so many rows."""
    recording = slow(seed)
    field = np.repeat(recording.magnetic_field[::times], times, axis=0)[: len(recording.time)]
    return reading(recording, np.round(field / STEP) * STEP)


def taken(repeats: ChanceRepeats, entries: Samples, cut: int) -> np.ndarray:
    """The samples (n, 4) that result if no sample is faulty, with so many entries in a call."""
    parts = []
    for i in range(0, len(entries.time), cut):
        fresh, _ = repeats.take(Samples(*(each[i : i + cut] for each in entries)))
        parts.append(np.column_stack(repeats.put_back(fresh, np.inf)))
    return np.vstack(parts)


def of_batch(recording: mg.Recording) -> np.ndarray:
    return np.column_stack(with_chance_repeats(recording).magnetometer)


@pytest.mark.parametrize("seed", [1, 2])
def test_coarse_steps_do_not_make_the_magnetometer_seem_early(seed: int) -> None:
    recording = coarse(seed)
    online = mg.OnlineCalibrator()
    online.update(recording.time, recording.magnetic_field, recording.angular_rate)
    found, batch = online.calibration, mg.calibrate(recording)
    assert found is not None
    assert abs(found.delay) < 2 * found.delay_sigma
    assert abs(found.delay - batch.delay) < 0.1 * batch.delay_sigma
    samples = of_batch(recording)[:, 1:]
    assert len(online.field) > len(samples) - 20  # a few of the last may still be suspects
    np.testing.assert_array_equal(online.field, samples[: len(online.field)])
    engine = online._engine
    assert isinstance(engine, OnlineSmoother)
    assert len(engine._online.recording(None).magnetometer.time) == len(online.field)  # what the refits use


@pytest.mark.parametrize("times", [2, 4])
def test_a_hold_is_left_out(times: int) -> None:
    recording = coarse(1, times)
    found = taken(ChanceRepeats(), Samples(recording.time, recording.magnetic_field), 16)
    assert np.isin(recording.time[::times], found[:, 0]).mean() > 0.98
    assert len(found) < 1.02 * len(recording.time) / times


@pytest.mark.parametrize(("times", "cut"), [(1, 1), (1, 1000), (2, 7), (2, 1000)])
def test_how_the_entries_are_cut_does_not_matter(times: int, cut: int) -> None:
    recording = coarse(1, times)
    every = Samples(recording.time, recording.magnetic_field)
    np.testing.assert_array_equal(taken(ChanceRepeats(), every, cut), of_batch(recording))


@pytest.mark.parametrize("rows", [50, 1234])
def test_a_resumed_run_goes_on_alike(rows: int) -> None:
    """Interrupted while the first entries are held back, and later."""
    recording = coarse(1)
    online = mg.OnlineCalibrator()
    for part in (slice(0, rows), slice(rows, 1500)):
        online = pickle.loads(pickle.dumps(online))
        online.update(recording.time[part], recording.magnetic_field[part], recording.angular_rate[part])
    whole = mg.OnlineCalibrator()
    whole.update(recording.time[:1500], recording.magnetic_field[:1500], recording.angular_rate[:1500])
    np.testing.assert_array_equal(online.field, whole.field)
    np.testing.assert_array_equal(online.field, of_batch(recording)[: len(online.field), 1:])
    assert online.calibration is not None
    assert whole.calibration is not None
    assert online.calibration.to_dict() == whole.calibration.to_dict()


def test_it_is_decided_again_as_the_counts_grow() -> None:
    """A sensor that was held, and is no longer; and the other way."""
    one, other = coarse(1), coarse(1, 4)
    for first, second, by_chance in ((one, other, False), (other, one, True)):
        field = np.vstack([first.magnetic_field, second.magnetic_field])
        time = 0.05 * np.arange(len(field))
        found = taken(ChanceRepeats(), Samples(time, field), 16)
        late = np.isin(time[-1000:], found[:, 0])
        assert (late.mean() > 0.95) == by_chance
        assert (late.mean() < 0.3) != by_chance


def test_only_the_first_of_a_long_run_are_samples() -> None:
    recording = coarse(1)
    field = recording.magnetic_field.copy()
    field[2000:2400] = field[2000]
    found = taken(ChanceRepeats(), Samples(recording.time, field), 16)
    kept = np.isin(recording.time, found[:, 0])
    assert kept[:2000].all()
    assert kept[2000:2010].all()
    assert not kept[2016:2400].any()


def test_a_repeat_goes_the_way_of_its_sample() -> None:
    """It waits while the detectors of faults are undecided about the sample, and is left out with it."""
    recording = coarse(1)
    repeats = ChanceRepeats()
    taken(repeats, Samples(recording.time[:1000], recording.magnetic_field[:1000]), 16)
    time = recording.time[999] + 0.05 * np.arange(1, 6)
    field = recording.magnetic_field[[0, 0, 500, 500, 500]]
    fresh, repeated = repeats.take(Samples(time, field))
    assert fresh.time.tolist() == time[[0, 2]].tolist()
    assert repeated.tolist() == time[[1, 3, 4]].tolist()
    nothing = Samples(fresh.time[:0], fresh.value[:0])
    assert len(repeats.put_back(nothing, time[0]).time) == 0
    passed = repeats.put_back(Samples(fresh.time[1:], fresh.value[1:]), np.inf)
    assert passed.time.tolist() == time[2:].tolist()
    assert (passed.value == field[2]).all()


def test_slow_entries_are_not_held_back_for_long() -> None:
    recording = coarse(1)
    field = np.repeat(recording.magnetic_field[:600:20], 2, axis=0)
    every, repeats = Samples(np.arange(60.0), field), ChanceRepeats()
    assert len(taken(repeats, Samples(*(each[:30] for each in every)), 1)) == 1
    assert len(taken(repeats, Samples(*(each[30:32] for each in every)), 1)) > 10
