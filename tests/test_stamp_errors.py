"""Gyroscope samples that a driver reads in batches and stamps by its own clock."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import added_variance, preintegrate
from magyc_gtsam.factors.chain.stamp_errors import stamp_errors
from magyc_gtsam.online.buffers import SampleBuffer
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.simulation import Simulation

STEP = 0.02  # s, between samples of the gyroscope
BATCH = 12  # samples


def taken(seconds: float = 300) -> Array:
    """Stamps of a sensor that samples evenly."""
    return STEP * np.arange(round(seconds / STEP))


def delayed(time: Array, late: float, how: str, batch: int = BATCH) -> Array:
    """Stamps of a driver that gets each batch late by an exponential delay of `late` s."""
    every = np.arange(len(time))
    last = np.minimum((every // batch + 1) * batch - 1, len(time) - 1)
    arrival = time[last] + np.random.default_rng(4).exponential(late, len(time) // batch + 1)[every // batch]
    arrival = np.maximum.accumulate(arrival)
    if how == "at arrival":
        return arrival + 2e-5 * (every % batch)
    if how == "between arrivals":
        ends = np.unique(last)
        return np.interp(every, ends, arrival[ends] + 1e-6 * ends, left=np.nan)
    return arrival - 0.985 * STEP * (
        last - every
    )  # spread backwards by the nominal step, which is not the true one


def kept(time: Array) -> np.ndarray:
    """Which stamps do not run backwards, as a reader leaves them out."""
    before = np.maximum.accumulate(np.where(np.isfinite(time), time, -np.inf))
    result: np.ndarray = time > np.concatenate([[-np.inf], before[:-1]]) + 1e-6
    return result


def ascending(time: Array) -> Array:
    result: Array = time[kept(time)]
    return result


@pytest.mark.parametrize("how", ["backwards", "at arrival", "between arrivals"])
@pytest.mark.parametrize("late", [0.02, 0.06])
def test_the_spread_of_the_delay_is_found_from_the_stamps(how: str, late: float) -> None:
    found = stamp_errors(ascending(delayed(taken(), late, how)))
    assert found is not None
    assert found.spread == pytest.approx(late, rel=0.3)
    assert found.count.mean() == pytest.approx(BATCH, rel=0.5)


def test_stamps_that_are_right_are_left_alone() -> None:
    random, time = np.random.default_rng(1), taken()
    lost = np.repeat(random.random(len(time) // 20) < 0.5, 20)
    stamps = {
        "even": time,
        "rounded to 1 ms": np.round(time * 1.003, 3),
        "in ticks of 10 ms": np.floor(time / 1.7 * 100) / 100,
        "lost in bursts": np.round(time[~lost], 4),
        "in ticks of a quarter of the step, and lost": np.ceil(0.993 * time[~lost] / 0.005) * 0.005,
        "paused": time + np.cumsum(random.random(len(time)) < 0.01) * 0.13,
        "uneven": np.sort(time + random.normal(0, 0.003, len(time))),
        "two rates": np.cumsum(np.where(np.arange(len(time)) // 5000 % 2, STEP, 0.5 * STEP)),
        "few": time[:5],
    }
    assert [name for name, each in stamps.items() if stamp_errors(np.unique(each)) is not None] == []


def test_a_constant_rate_is_right_by_wrong_stamps() -> None:
    """By as much as the rate changes from a batch to the next the turn is uncertain, once for each."""
    time = ascending(delayed(taken(), 0.03, "between arrivals"))
    rate = np.zeros((len(time), 3))
    rate[len(time) // 2 :, 2] = 0.5
    found = stamp_errors(time)
    assert found is not None
    variance = found.variance(rate, 0.0)
    changed = np.abs(np.flatnonzero(variance) - len(time) // 2)
    assert len(changed) <= 2
    assert changed.max() <= 2 * BATCH
    assert 0.49 < variance.sum() / (found.spread * 0.5) ** 2 < 1.01


@cache
def turning() -> Simulation:
    return mg.simulate("moderate", 200, rate=50, seed=5)


@cache
def logged(late: float) -> mg.Recording:
    recording = turning().recording
    stamps = delayed(recording.time, late, "backwards") if late else recording.time
    own, field = kept(stamps), recording.magnetic_field[::5]
    assert recording.angular_rate is not None
    return mg.Recording.from_streams((recording.time[::5], field), (stamps[own], recording.angular_rate[own]))


def test_the_links_are_looser_where_the_rate_changes() -> None:
    sound, wandering = (preintegrate(logged(late)) for late in (0.0, 0.05))
    assert sound.added_variance is None
    assert wandering.added_variance is not None
    steps = np.square(wandering.step).sum()
    whole = wandering.integrate().link_time.sum()
    assert whole == pytest.approx(steps + wandering.added_variance.sum(), rel=0.05)
    part, rates = wandering.stretch(10, 40, 1.0)
    assert part.added_variance is not None
    assert np.array_equal(part.added_variance, wandering.added_variance[rates.start : rates.stop - 1])


def test_the_end_of_a_stretch_may_be_that_of_the_log() -> None:
    samples = preintegrate(logged(0.05))
    part, _ = samples.stretch(5, len(samples.starts), 1e3)
    assert part.added_variance is not None
    assert len(part.added_variance) == len(part.gyroscope_time) - 1


def test_the_result_says_so_and_is_covered() -> None:
    calibration = mg.calibrate(logged(0.05))
    assert "batches of some 1" in calibration.message
    assert "ms (1σ)" in calibration.message
    covariance = calibration.covariance
    assert covariance is not None
    off = calibration.hard_iron - turning().truth.hard_iron
    assert np.abs(off / np.sqrt(np.diag(covariance)[6:9])).max() < 3
    assert "batches" not in mg.calibrate(logged(0.0)).message


def test_online_judges_the_stamps_by_those_just_before() -> None:
    magnetometer, gyroscope = logged(0.05).magnetometer, logged(0.05).gyroscope
    buffer = SampleBuffer(1.5, 0.2, interval_mean=False)
    buffer.append(Samples(*magnetometer), Samples(*gyroscope))
    last = int(buffer.numbers[-1])
    piece = buffer.windows(last - 60, last, 0.0)
    whole = added_variance(gyroscope)
    assert piece.added_variance is not None
    assert whole is not None
    rows = slice(*np.searchsorted(gyroscope.time, piece.gyroscope_time[[0, -1]]))
    assert piece.added_variance.sum() == pytest.approx(whole[rows].sum(), rel=0.4)
