"""Logs that begin before the instrument is picked up and end after it is put down, where the field is another one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.effects.changes import during
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.gap.effects.world import ANOMALY, turned
from magyc_gtsam.gap.model.base import base_model, problem_of, root
from magyc_gtsam.gap.model.rests import rate_at_rest
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.simulation import HARD_IRON
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.signals import record

TABLE = np.array([1.2e-6, -2.1e-6, 1.8e-6])  # T, in the world's axes


def on_a_table(motion: str, seed: int, first: float, last: float) -> tuple[mg.Recording, mg.Calibration]:
    """A log whose first and last seconds are in another field, and its truth."""
    simulation = mg.simulate(motion, 200, seed=seed)
    recording = simulation.recording
    since = recording.time - recording.time[0]
    there = (since < first) | (since > since[-1] - last)
    field = Rotation.from_quat(recording.attitude).inv().apply(TABLE) * there[:, None]
    return replace(recording, magnetic_field=recording.magnetic_field + field), simulation.truth


@pytest.mark.parametrize(("motion", "seed"), [("wide", 1), ("wide", 2), ("moderate", 3), ("multi", 4)])
def test_the_field_of_a_table_is_one_of_the_place(motion: str, seed: int) -> None:
    """Of a second before and three after: no window of it may be a jump of a bias or of the iron."""
    recording, truth = on_a_table(motion, seed, 1.2, 3.0)
    gap = mg.find_gap(recording)
    assert {effect.name for effect in gap.effects} == {"local-anomaly"}, gap.sentence
    ends = [gap.effects[i].setting.get(end) for i in range(len(gap.effects)) for end in ("time", "until")]
    found = sorted(end - recording.time[0] for end in ends if end is not None)
    np.testing.assert_allclose(found, [1.2, 197.0], atol=0.8)
    assert gap.calibration.trusted
    off = gap.calibration.hard_iron - truth.hard_iron
    assert off @ np.linalg.solve(gap.calibration.covariance[6:9, 6:9], off) < 16.3  # one of a thousand


def test_a_stay_is_found_from_both_ends_of_the_rest() -> None:
    """The field beside steel, for 40 % of the log, was taken for that of the place, and the hard iron 24 µT off."""
    fault = FAULTS["stay-beside-steel"]
    log = record("tiny", 35099, fault, fault.strong, "stay-beside-steel").recording("stay")
    gap = mg.find_gap(log)
    (stay,) = gap.effects
    assert (stay.name, *stay.setting) == ("local-anomaly", "time", "until")
    assert gap.calibration.trusted
    assert np.abs(gap.calibration.hard_iron - HARD_IRON).max() < 2e-6


def test_before_and_after_are_one_field() -> None:
    """Where `until` is earlier than `time`, the effect is present outside of them."""
    inside = during(Signals(np.arange(10.0)), {"time": 2.5, "until": 6.5})
    outside = during(Signals(np.arange(10.0)), {"time": 6.5, "until": 2.5})
    np.testing.assert_array_equal(inside, [0, 0, 0, 1, 1, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(outside, 1 - inside)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"time": 10.0, "until": 20.0}, "from 10 s to 20 s"),
        ({"until": 20.0}, "until 20 s"),
        ({"time": 10.0}, "from 10 s on"),
        ({"time": 20.0, "until": 10.0}, "until 10 s and from 20 s on"),
    ],
)
def test_when_the_field_is_another_one_in_words(setting: dict[str, float], words: str) -> None:
    assert f"was another one {words}, by" in ANOMALY.sentence(np.ones(3), np.ones(3), setting)


def test_a_rest_does_not_turn_by_a_wrong_bias() -> None:
    """The bias that a model has beside a jump of the iron may be wrong by 50 mrad/s; the rest knows better."""
    random = np.random.default_rng(3)
    simulation = mg.simulate("wide", 100, seed=6)
    moving = simulation.recording
    rows = 200
    rest = {
        "magnetic_field": moving.magnetic_field[:1] + 1e-8 * random.standard_normal((rows, 3)),
        "angular_rate": simulation.truth.gyro_bias + 1e-4 * random.standard_normal((rows, 3)),
    }
    time = np.concatenate([moving.time[0] - 0.1 * np.arange(rows, 0, -1), moving.time])
    recording = mg.Recording(
        time, *(np.concatenate([rest[name], getattr(moving, name)]) for name in ("magnetic_field", "angular_rate"))
    )
    np.testing.assert_allclose(rate_at_rest(recording), simulation.truth.gyro_bias, atol=5e-4)
    assert rate_at_rest(moving) is None
    model = root(problem_of(recording), base_model(recording, None, short_term_noise(recording)).model).model
    parameters = model.parameters.copy()
    parameters[9:12] += 0.05
    twin = Twin.of(problem_of(recording), replace(model, parameters=parameters))
    start = float(recording.time[0])
    still, moved = turned(twin, start + np.array([2.0, 40.0]), start + np.array([12.0, 50.0]))
    assert still < 0.02
    assert moved > 0.3


def test_a_turn_that_the_gyroscope_missed_is_no_other_place() -> None:
    """A wrong sample of the gyroscope near the end leaves the strength of the field as it was."""
    simulation = mg.simulate("low", 300, seed=7)
    recording = simulation.recording
    rate = recording.angular_rate.copy()
    rate[-8] += [0.0, 0.0, 3.0]  # of which 0.1 s are 17°
    gap = mg.find_gap(replace(recording, angular_rate=rate))
    assert "local-anomaly" not in gap.names, gap.sentence
