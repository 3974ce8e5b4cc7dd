"""Held magnetometer values: stamped by the clock that the rows show, by the rows themselves where it keeps step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import magyc_gtsam as mg
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import NAMES
from magyc_gtsam.gap.preparation.discrete import settled
from magyc_gtsam.gap.samples.noise_effects import sample_hold

# What a clock may be taken for.
CLOCKS = ["sample-hold", "timing", "eddy-plane", "gyro-scale", "hysteresis"]


def in_step(every: int, rate: int, delay: float, seed: int) -> mg.Recording:
    """A log of `rate` Hz whose magnetometer, late by `delay` s, is new in every so many rows, and held in between."""
    noise = 1e-7 * 100 / rate  # T; half a row of a faster log shows in less of it
    whole = mg.simulate(
        "wide", duration=300, seed=seed, rate=100.0, delay=delay, magnetometer_noise=noise
    ).recording
    log = whole.rows(slice(None, None, 100 // rate))
    row = np.arange(len(log.time))
    return mg.Recording(
        log.time, log.magnetic_field[row // every * every], log.angular_rate, attitude=log.attitude
    )


def spread(calibration: mg.Calibration, recording: mg.Recording) -> float:
    """T, by how much the calibrated field of all rows, held ones too, moves in the world; a delay is of the stamps."""
    when = np.maximum(recording.time - calibration.delay, recording.time[0])
    attitude = Slerp(recording.time, Rotation.from_quat(recording.attitude))(when)
    world = attitude.apply(calibration.apply(recording))
    return float(np.sqrt(world.var(axis=0).sum()))


@pytest.mark.parametrize(
    ("every", "rate", "seed", "delay"), [(2, 10, 1, 0.09), (5, 10, 3, 0.0), (5, 10, 3, 0.09), (5, 100, 1, 0.0)]
)
def test_a_clock_in_step_with_the_rows_makes_no_delay(every: int, rate: int, seed: int, delay: float) -> None:
    """Half a row would be 50 ms at 10 Hz."""
    recording = in_step(every, rate, delay, seed)
    gap = mg.find_gap(recording, candidates=CLOCKS)
    assert gap.verdict == "closed"
    assert gap.names == (("sample-hold", "timing") if delay else ("sample-hold",))
    if delay:
        found, sigma = gap.effects[1].value[0], gap.effects[1].sigma[0]  # ms
    else:
        (late,) = (h for h in gap.hypotheses if h.name == "timing")
        found, sigma = late.expected[0], late.sigma[0]
    assert sigma < 10 * 10 / rate + 0.5
    assert found == pytest.approx(1e3 * delay, abs=3 * sigma)
    assert gap.calibration.delay == pytest.approx(delay, abs=0.02)
    before = spread(replace(mg.calibrate(recording), delay=0.0), recording)
    assert spread(gap.calibration, recording) < (0.93 if delay else 1.001) * before


def log_of(shown: Array, stamps: Array) -> mg.Recording:
    """Rows at `stamps` (n,) s that show samples by their numbers (n,), as far as the clock is concerned."""
    random = np.random.default_rng(0)
    field = 5e-5 * random.standard_normal((int(shown.max()) + 1, 3))
    return mg.Recording(stamps, field[shown], 0.1 * random.standard_normal((len(stamps), 3)))


def stamped(log: mg.Recording) -> tuple[Array, np.ndarray]:
    """Stamps (m,) s of the samples of the log as they are read, and the rows (m,) of the log that brought them."""
    own, scores = settled(log, NAMES)
    assert [s.name for s in scores if s.significant] == ["sample-hold"]
    brought = {tuple(value): row for row, value in reversed(list(enumerate(log.magnetic_field)))}
    return own.magnetometer.time, np.array([brought[tuple(value)] for value in own.magnetometer.value])


@pytest.mark.parametrize("start", [0, 1])
@pytest.mark.parametrize(("samples", "rows"), [(1, 2), (1, 5), (2, 3), (2, 5), (3, 4), (4, 5), (4, 9)])
def test_a_clock_in_step_has_the_latest_stamps_that_its_rows_allow(samples: int, rows: int, start: int) -> None:
    """What all samples are older than that shows in no row: a delay has to say so."""
    row = np.arange(3000)
    shown = (samples * row + start) // rows
    times, brought = stamped(log_of(shown, row / 10))
    assert len(times) > 0.99 * shown.max()
    age = row[brought] / 10 - times
    assert age.min() == pytest.approx(0, abs=1e-9)
    assert age.max() == pytest.approx(0.1 * (1 - 1 / samples), abs=1e-9)
    np.testing.assert_allclose(np.diff(times), 0.1 * rows / samples, atol=1e-9)


def test_a_clock_in_step_with_rows_whose_stamps_jitter_keeps_their_stamps() -> None:
    row = np.arange(3000)
    stamps = (row + np.random.default_rng(1).uniform(-0.3, 0.3, 3000)) / 10
    times, brought = stamped(log_of(row // 5, stamps))
    np.testing.assert_allclose(times, stamps[brought], atol=1e-9)


def test_holes_in_a_log_break_no_step() -> None:
    row = np.arange(6000)
    kept = (row % 700 > 23) & (row % 811 > 1)
    log = log_of(row // 3, row / 10).rows(kept)
    times, brought = stamped(log)
    assert len(times) > 0.95 * kept.sum() / 3
    np.testing.assert_allclose(times, log.time[brought], atol=1e-9)


@pytest.mark.parametrize(("share", "allowed"), [(0.003, 1e-9), (0.1, 0.01), (0.5, 0.01)])
def test_a_sample_that_misses_its_row_now_and_then_is_no_sooner(share: float, allowed: float) -> None:
    """A task that runs after the logger's, at times: the soonest rows say when samples are measured, s."""
    random = np.random.default_rng(2)
    row = np.arange(6000)
    late = (random.random(1200) < share)[row // 5] & (row % 5 == 0)
    times, brought = stamped(log_of(row // 5 + 1 - late, row / 10))
    true = 0.1 * (row[brought] // 5 * 5)
    assert np.abs(times - true).max() < allowed


@pytest.mark.parametrize(("period", "seed"), [(0.1175, 1), (0.17, 2), (0.2413, 3)])
def test_held_samples_are_stamped_by_the_clock_that_they_show(period: float, seed: int) -> None:
    """A magnetometer that measures every `period` s, read in the rows of a log of 10 Hz."""
    fine = mg.simulate("wide", duration=300, seed=seed, rate=200.0, magnetometer_noise=1e-6).recording
    rows = np.arange(40, len(fine.time), 20)  # what was measured before the first row is known, too
    start = fine.time[rows[0]] - 0.07
    tick = start + np.floor((fine.time[rows] - start) / period) * period
    shown = np.searchsorted(fine.time, tick)
    assert fine.angular_rate is not None
    held = mg.Recording(fine.time[rows], fine.magnetic_field[shown], fine.angular_rate[rows])
    assert sample_hold(held).significant
    own, scores = settled(held, NAMES)
    assert [s.name for s in scores if s.significant] == ["sample-hold"]
    stamps = own.magnetometer.time
    true = np.unique(tick)
    nearest = true[np.abs(stamps[:, None] - true).argmin(axis=1)]
    assert np.abs(stamps - nearest).max() < 0.008  # of 200 Hz
    gap = mg.find_gap(held, candidates=CLOCKS)
    assert gap.names[0] == "sample-hold"
    (late,) = (h for h in gap.hypotheses if h.name == "timing")
    assert abs(late.expected[0]) < 10  # ms; by the stamps of the rows it would be 50


@pytest.mark.parametrize(
    "kept",
    [
        lambda time: ((time < 50) | (time > 67.3)) & ((time < 175) | (time > 204.1)),
        lambda time: (np.arange(len(time)) < 1000) | (np.arange(len(time)) > 1002),
        lambda time: time % 20 < 10,
        lambda time: time % 30 < 5,
    ],
    ids=["long", "short", "half", "seldom"],
)
def test_a_hole_in_the_log_hides_no_clock(kept: Callable[[Array], Array]) -> None:
    """How many samples a hole holds is open by one from the rows at its ends, and is not from those beside it."""
    full = mg.simulate("wide", duration=300, seed=4, effects=("sample-hold",)).recording
    rows = kept(full.time - full.time[0])
    assert full.angular_rate is not None
    holes = mg.Recording(full.time[rows], full.magnetic_field[rows], full.angular_rate[rows])
    own, whole = (settled(recording, NAMES)[0].magnetometer.time for recording in (holes, full))
    assert np.abs(own[:, None] - whole).min(axis=1).max() < 5e-3
    assert mg.find_gap(holes, candidates=CLOCKS).names == ("sample-hold",)


def test_held_samples_in_coarse_steps_make_no_delay() -> None:
    """Of a magnetometer of 20 Hz in steps of 0.6 µT, read at 100 Hz: samples that equal the one before count."""
    log = in_step(5, 100, 0.0, 4)
    coarse = replace(log, magnetic_field=np.round(log.magnetic_field / 0.6e-6) * 0.6e-6, magnetic_field_fresh=None)
    gap = mg.find_gap(coarse, candidates=[*CLOCKS, "quantisation"])
    assert gap.verdict == "closed"
    assert set(gap.names) == {"sample-hold", "quantisation"}
    assert gap.effects[gap.names.index("sample-hold")].value[0] == pytest.approx(5.0, abs=0.01)
