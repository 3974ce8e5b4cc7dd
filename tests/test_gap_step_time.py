"""A jump of the hard iron inside a window: the samples between it and the window's edge are not named as wrong."""

from dataclasses import replace

import numpy as np
import pytest

from magyc_gtsam import Recording, find_gap, simulate

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
