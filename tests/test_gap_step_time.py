"""A jump of the hard iron inside a window: the samples between it and the window's edge are not named as wrong."""

from dataclasses import replace

import numpy as np
import pytest

from magyc_gtsam import Recording, find_gap, simulate
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.model.base import base_model, problem_of
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.refit import refit, with_term
from magyc_gtsam.gap.naming.named import Found, Named
from magyc_gtsam.gap.naming.steps import with_one_jump
from magyc_gtsam.gap.samples.fine import First

JUMP = np.array([-4e-6, 2e-6, -15e-6])  # T


def jumped(recording: Recording, time: float) -> Recording:
    field = recording.magnetic_field + (recording.time > time)[:, None] * JUMP
    return replace(recording, magnetic_field=field, attitude=None)


def test_samples_next_to_a_jump_are_no_spikes() -> None:
    time = 80.14
    gap = find_gap(jumped(simulate("wide", duration=120, seed=10).recording, time))
    assert gap.names == ("hard-iron-step",)
    assert "spikes" not in gap.probabilities
    (step,) = gap.effects
    assert step.setting["time"] == pytest.approx(time, abs=0.5)
    assert np.all(np.abs(step.value - JUMP * 1e6) < 4.5 * step.sigma)


def test_spikes_elsewhere_are_named_beside_a_jump() -> None:
    recording = jumped(simulate("wide", duration=120, seed=4).recording, 80.04)
    field = recording.magnetic_field.copy()
    field[[300, 500, 1100]] += 12e-6
    gap = find_gap(replace(recording, magnetic_field=field))
    assert sorted(gap.names) == ["hard-iron-step", "spikes"]
    assert gap.probabilities["spikes"] > 0.95


@pytest.mark.parametrize("jumps", [1, 2])
def test_two_steps_beside_one_window_are_one_jump_inside_it(jumps: int) -> None:
    """Unless the field of the window is none between those before and after it."""
    still = replace(simulate("wide", duration=120, seed=10).recording, attitude=None)
    noise, base = short_term_noise(still), base_model(still, None, short_term_noise(still))
    time = base.twin.time
    start, end = 0.5 * (time[59:61] + time[60:62])
    inside = 0.5 * (start + end)
    recording = jumped(still, inside)
    if jumps == 2:  # the window reads 9 µT beside the line from one to the other
        there = (recording.time > start) & (recording.time < end)
        field = recording.magnetic_field + there[:, None] * np.array([9e-6, 0.0, 0.0])
        recording = replace(recording, magnetic_field=field)
    model = base.model
    for at in (start, end):
        model = with_term(model, Active("hard-iron-step", {"time": float(at)}, np.zeros(3)))
    fitted = refit(problem_of(recording), model, noise)
    first, tree = First(recording, fitted), Tree(base, ())
    found = (Found("hard-iron-step", 900.0),) * 2
    result = with_one_jump(Named(recording, first, tree, fitted, found, (), {}), noise)
    assert len(result.found) == jumps
    if jumps == 1:
        (step,) = result.fitted.model.terms
        assert step.setting["time"] == pytest.approx(inside, abs=0.15)
        assert np.all(np.abs(step.value - JUMP) < 1e-6)
