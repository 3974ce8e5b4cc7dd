"""Stamps that are far ahead: wrong ones are dropped, those after a pause are taken."""

from __future__ import annotations

import pickle
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.online.intake import Intake


def taken(time: np.ndarray, cut: int) -> tuple[list[float], int]:
    """Stamps of the magnetometer's samples taken, so many in a call, and how many were left out."""
    intake, stamps = Intake(), []
    field = 1e-5 + 1e-8 * np.arange(len(time))[:, None] * np.ones(3)
    for i in range(0, len(time), cut):
        magnetometer, _ = intake.take(time[i : i + cut], field[i : i + cut], None)
        stamps += magnetometer.time.tolist()
    counts = intake.state()["count"]
    return stamps, int(counts[1])


@pytest.mark.parametrize("cut", [1, 3, 1000])
@pytest.mark.parametrize("seed", range(4))
def test_wrong_stamps_ahead_are_dropped_and_pauses_kept(seed: int, cut: int) -> None:
    random = np.random.default_rng(seed)
    time = 0.1 * np.arange(400) + random.uniform(0, 0.02, 400)
    time[200:] += 3600.0  # a pause
    wrong = np.sort(random.choice(np.r_[10:190, 215:390], 6, replace=False))
    given = time.copy()
    given[wrong] += 10 ** random.uniform(0.5, 9, 6)
    stamps, left_out = taken(given, cut)
    assert stamps == np.delete(time, wrong).tolist()
    assert left_out == 6


@pytest.mark.parametrize("cut", [1, 3, 1000])
def test_a_few_stamps_far_behind_are_left_out_and_a_clock_that_is_set_back_is_not(cut: int) -> None:
    time = 100 + 0.1 * np.arange(60)
    given = np.insert(time, [20, 40, 40, 40, 40, 40], [0.0, 50.0, 50.1, 50.2, 50.3, 50.4])
    assert taken(given, cut) == (time.tolist(), 6)
    with pytest.raises(mg.MagycError, match="time goes back from 105.900 to 50.500 s and stays there"):
        taken(np.r_[time, 50 + 0.1 * np.arange(40)], cut)


@pytest.mark.parametrize("cut", [1, 7, 1000])
def test_messages_that_are_sent_again_are_left_out_and_set_no_clock_back(cut: int) -> None:
    time = 100 + 0.1 * np.arange(300)
    field = 1e-5 + 1e-8 * np.random.default_rng(1).normal(size=(300, 3))
    order = np.r_[0:200, 120:200, 200:300]  # eight seconds again, as after a connection was lost
    intake, stamps = Intake(), []
    for i in range(0, len(order), cut):
        rows = order[i : i + cut]
        stamps += intake.take(time[rows], field[rows], None)[0].time.tolist()
    assert stamps == time.tolist()
    assert int(intake.state()["count"][1]) == len(order) - 300
    # The same stamps with other values are those of a clock that was set back.
    with pytest.raises(mg.MagycError, match="time goes back from 129.900 to 112.500 s and stays there"):
        intake.take(time[120:160], field[120:160] + 1e-6, None)


@pytest.mark.parametrize("step", [0.01, 0.1, 2.0, 30.0])
def test_regular_stamps_are_all_taken(step: float) -> None:
    time = step * np.arange(100)
    assert taken(time, 7) == (time.tolist(), 0)


def test_a_clock_that_was_set_ahead_is_believed_after_five_more_stamps() -> None:
    time = np.append(0.1 * np.arange(100), 5000 + 0.1 * np.arange(6))
    assert taken(time[:-1], 1)[0] == time[:100].tolist()
    assert taken(time, 1) == (time.tolist(), 0)


@pytest.mark.parametrize("cut", [1, 3, 1000])
@pytest.mark.parametrize("wrong", [1, 2, 5])
@pytest.mark.parametrize("by", [2.0, 3600.0, 1e9, -1e9])
def test_wrong_stamps_at_the_very_start_are_dropped(wrong: int, by: float, cut: int) -> None:
    """A clock that is set right just after the start, forward or back, and single stamps among the first."""
    time = 1000 + 0.1 * np.arange(100)
    given = time.copy()
    given[:wrong] += by
    assert taken(given, cut) == (time[wrong:].tolist(), wrong)
    given = time.copy()
    given[1:wrong] += abs(by) * 10.0 ** np.arange(wrong - 1)
    assert taken(given, cut) == (np.delete(time, np.s_[1:wrong]).tolist(), wrong - 1)


def test_few_stamps_between_pauses_are_taken_all_the_same() -> None:
    time = (30.0 * np.arange(20)[:, None] + 0.1 * np.arange(3)).ravel()
    stamps, left_out = taken(time, 1)
    assert left_out <= 5
    assert stamps == time[left_out : left_out + len(stamps)].tolist()
    assert len(stamps) >= len(time) - 10


def test_the_calibration_goes_on(tmp_path: Path) -> None:
    """One stamp of the magnetometer, one of the gyroscope, and a file written while one waits."""
    recording = mg.simulate("wide", 200, seed=3).recording
    without = mg.OnlineCalibrator()
    online = mg.OnlineCalibrator()
    for i, row in enumerate(zip(recording.time, recording.magnetic_field, recording.angular_rate, strict=True)):
        time, field, rate = row
        if i == 500:
            online.update(1e9, field)
            online.save(tmp_path / "state.npz")
            online = mg.OnlineCalibrator.load(tmp_path / "state.npz")
        if i == 900:
            online.update(time + 40.0, angular_rate=rate)
        online.update(time, field, rate)
        without.update(time, field, rate)
    assert online.progress.left_out == 2
    assert online.calibration.to_dict() == without.calibration.to_dict()


@pytest.mark.parametrize("method", ["smoother", "magyc-ifg"])
def test_a_copy_by_pickle_goes_on_alike(method: str) -> None:
    recording = mg.simulate("wide", 60, seed=3).recording
    rows = (recording.time, recording.magnetic_field, recording.angular_rate)
    online = mg.OnlineCalibrator(method)
    online.update(*(each[:301] for each in rows))
    copied = pickle.loads(pickle.dumps(online))
    for one in (online, copied):
        one.update(*(each[301:] for each in rows))
    assert copied.calibration.hard_iron.tolist() == online.calibration.hard_iron.tolist()  # type: ignore[union-attr]


def test_threads_take_turns() -> None:
    """One thread per sensor: a block that both wrote back at once lost the stamps of the other."""
    recording = mg.simulate("wide", 20, 50, seed=5).recording
    online, together = mg.OnlineCalibrator(), threading.Barrier(2)

    def give(sensor: str) -> None:
        for first in range(0, len(recording.time), 2):
            rows = slice(first, first + 2)
            together.wait(10)
            online.update(recording.time[rows], **{sensor: getattr(recording, sensor)[rows]})

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(2) as pool:
            for driver in [pool.submit(give, name) for name in ("magnetic_field", "angular_rate")]:
                driver.result()
    finally:
        sys.setswitchinterval(interval)
    assert online.taken_until == (recording.time[-1], recording.time[-1])
    assert online.progress.left_out == 0
    assert online.calibration is not None


def test_what_is_no_number_is_refused() -> None:
    zero = np.zeros(3)
    for sample, says in (
        (("a", zero, zero), "time: not a number"),
        ((0.0, "x", zero), "magnetic_field: not an array"),
    ):
        with pytest.raises(mg.MagycError, match=says):
            mg.OnlineCalibrator().update(*sample)  # type: ignore[arg-type]


def test_an_error_of_single_samples_costs_no_other_sample() -> None:
    """Nine samples wait when a clock is set back; they and the block given next were lost."""
    recording = mg.simulate("wide", 20, 10, seed=1).recording
    time, field, rate = recording.time, recording.magnetic_field, recording.angular_rate
    online = mg.OnlineCalibrator()
    online.update(time[:100], field[:100], rate[:100])
    for k in range(100, 109):
        online.update(time[k], field[k], rate[k])
    for k in range(6):
        online.update(
            float(time[k]), field[k + 50], rate[k + 50]
        )  # the sixth shows that these are not late samples
    with pytest.raises(mg.MagycError, match="time goes back"):
        online.update(time[109:], field[109:], rate[109:])
    assert online.taken_until == (time[-1], time[-1])
    assert online.progress.duration == time[-1]
    again = mg.OnlineCalibrator()
    for k in range(15):
        again.update(1e3 * float(time[k]), field[k], rate[k])
    with pytest.raises(mg.MagycError, match="likely unit: ms"):
        again.update(1e3 * float(time[15]), field[15], rate[15])
    assert again.taken_until == (-np.inf, -np.inf)


def test_a_gyroscope_alone_after_a_pause_of_both_goes_on() -> None:
    """The magnetometer's samples in the gyroscope's pause are dropped, and none was left to compare stamps with."""
    online, random = mg.OnlineCalibrator(), np.random.default_rng(0)

    def turn(time: np.ndarray) -> None:
        online.update(time, angular_rate=0.2 + random.normal(0, 0.01, (len(time), 3)))

    def read(time: np.ndarray) -> None:
        online.update(time, 3e-5 + random.normal(0, 1e-7, (len(time), 3)))

    read(np.arange(9.0, 10.55, 0.1) - 0.02)
    turn(10 + 0.01 * np.arange(8))
    read(np.arange(10.6, 14.9, 0.1) - 0.02)
    for second in range(4):
        turn(15 + second + 0.01 * np.arange(100))
    read(np.arange(15, 19, 0.1))
    assert online.progress.sentence


@pytest.mark.parametrize("silent", ["angular_rate", "magnetic_field"])
def test_one_long_block_keeps_what_both_sensors_have(silent: str) -> None:
    """As of a whole file in which one sensor stops half-way: all of the other was dropped but the last minute."""
    recording = mg.simulate("wide", 300, 10, seed=3).recording
    given = {"magnetic_field": recording.magnetic_field, "angular_rate": recording.angular_rate}
    given[silent] = np.where(recording.time[:, None] < 150, given[silent], np.nan)
    found = []
    for size in (100, 3000):
        online = mg.OnlineCalibrator()
        for first in range(0, 3000, size):
            rows = slice(first, first + size)
            online.update(recording.time[rows], **{name: value[rows] for name, value in given.items()})
        assert online.calibration is not None
        found.append(online.calibration.hard_iron)
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("silent", ["angular_rate", "magnetic_field"])
def test_without_one_sensor_the_estimate_is_out_of_date(silent: str) -> None:
    """It stayed converged while nothing came: 5 µT of payload later it was wrong at every look."""
    recording = mg.simulate("wide", 400, seed=2).recording
    online = mg.OnlineCalibrator()
    first = recording.time < 250
    field, rate = recording.magnetic_field, recording.angular_rate
    online.update(recording.time[first], field[first], rate[first])
    assert online.converged
    rest = {"magnetic_field": field[~first], "angular_rate": rate[~first]}
    del rest[silent]
    online.update(recording.time[~first], **rest)
    assert not online.converged
    assert not online.progress.converged
    assert f"no sample of {silent} for 150 s" in online.progress.sentence
