"""Held magnetometer values: stamped by the clock that the rows show."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.factors.rotations import Array
from magyc_gtsam.gap.discrete import settled
from magyc_gtsam.gap.effects import NAMES
from magyc_gtsam.gap.noise_effects import sample_hold


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
    gap = mg.find_gap(held)
    assert gap.names[0] == "sample-hold"
    (late,) = (h for h in gap.hypotheses if h.name == "timing")
    assert abs(late.expected[0]) < 10  # ms; by the stamps of the rows it would be 50


@pytest.mark.parametrize(
    "kept",
    [
        lambda time: ((time < 100) | (time > 117.3)) & ((time < 350) | (time > 379.1)),
        lambda time: (np.arange(len(time)) < 2000) | (np.arange(len(time)) > 2002),
        lambda time: time % 20 < 10,
        lambda time: time % 30 < 5,
    ],
    ids=["long", "short", "half", "seldom"],
)
def test_a_hole_in_the_log_hides_no_clock(kept: Callable[[Array], Array]) -> None:
    """How many samples a hole holds is open by one from the rows at its ends, and is not from those beside it."""
    full = mg.simulate("wide", duration=600, seed=4, effects=("sample-hold",)).recording
    rows = kept(full.time - full.time[0])
    assert full.angular_rate is not None
    holes = mg.Recording(full.time[rows], full.magnetic_field[rows], full.angular_rate[rows])
    own, whole = (settled(recording, NAMES)[0].magnetometer.time for recording in (holes, full))
    assert np.abs(own[:, None] - whole).min(axis=1).max() < 5e-3
    assert mg.find_gap(holes).names == ("sample-hold",)
