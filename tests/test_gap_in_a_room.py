"""What is named beside the varying field of a room, whose functions of time and attitude explain almost anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario, seed_of
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.estimators.smoother.reasons import MOST_UNEXPLAINED
from magyc_gtsam.gap.evidence.answer import answer
from magyc_gtsam.gap.evidence.laplace import Explained, Terms
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION, Node
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.samples.first import First

_NAMES = ("gyro-bias-step", "hysteresis", "eddy-plane")
_PERIOD = 6.0  # s, over which the room's field is correlated


def _with_room(recording: mg.Recording, seed: int, varies: float, period: float) -> mg.Recording:
    """Add a field that varies along the way by `varies`, T, with a correlation time of `period`, s."""
    assert recording.attitude is not None
    keeps = np.exp(-np.median(np.diff(recording.time)) / period)
    noise = np.random.default_rng(seed).standard_normal((len(recording.time), 3))
    place = varies * lfilter([np.sqrt(1 - keeps**2)], [1, -keeps], noise, axis=0)
    field = recording.magnetic_field + Rotation.from_quat(recording.attitude).inv().apply(place)
    return replace(recording, magnetic_field=field)


def _in_a_room(seed: int, jump: float = 0.0, varies: float = 1.5e-6) -> mg.Recording:
    """A walk of 100 s, along which the field varies by so much, T; the gyroscope's bias jumps by so much, rad/s."""
    recording = mg.simulate("wide", 100, rate=20, seed=seed, magnetometer_noise=0.2e-6).recording
    recording = _with_room(recording, seed, varies, _PERIOD)
    assert recording.angular_rate is not None
    after = (recording.time > recording.time[0] + 50)[:, None]
    rate = recording.angular_rate + jump * after * np.array([0.5, -0.5, 0.7])
    return replace(recording, angular_rate=rate)


def _best(recording: mg.Recording) -> Node:
    noise = short_term_noise(recording)
    return answer(First(recording, base_model(recording, None, noise)), noise, _NAMES).tree.best


def test_what_the_room_could_explain_is_named_where_it_explains_as_much_in_its_place() -> None:
    """A twentieth of the field's power is left for it beside the field, and in its place it has more than a third."""
    recording = _in_a_room(2, jump=0.06)
    best = _best(recording)
    assert best.names == (FIELD_VARIATION, "gyro-bias-step")
    power = best.of_terms.powers([0])[0, 0]
    assert power < 0.1 * best.of_field
    assert best.kept == [0]
    said = mg.find_gap(recording, candidates=_NAMES).probabilities
    assert said["gyro-bias-step"] > PRIOR.named_from


def test_the_power_in_place_of_the_field_is_what_a_fit_without_the_term_leaves_more() -> None:
    fit = _best(_in_a_room(2, jump=0.06)).fit
    terms = Terms.of(fit)
    information, score = terms.information(terms.beside(None))
    explained = Explained(information, score, terms.of_term, np.zeros(1)).powers([0])[0, 0]
    left = [
        terms.residual - np.linalg.lstsq(columns.T, terms.residual, rcond=None)[0] @ columns
        for columns in (terms.base, np.concatenate([terms.base, terms.columns]))
    ]
    np.testing.assert_allclose(explained, left[0] @ left[0] - left[1] @ left[1], rtol=0.01)


@pytest.mark.parametrize(("duration", "period"), [(300, 8.0), (600, 8.0), (600, 30.0)])
def test_what_a_field_varies_fast_is_no_noise_of_the_sensor(duration: int, period: float) -> None:
    """Sixty cosines do not reach it: it was correlated noise beside the field, or unknown in ten minutes."""
    recording = _with_room(mg.simulate("wide", duration, rate=10, seed=5).recording, 5, 1e-6, period)
    gap = mg.find_gap(recording)
    assert [effect.name for effect in gap.effects] == [FIELD_VARIATION]
    assert gap.verdict == "closed"


def test_a_room_alone_has_no_name() -> None:
    """Nor has a jump of the bias of which the room explains all but an eighth of its own power."""
    for seed, jump in ((3, 0.0), (4, 0.0), (1, 0.03), (2, 0.03)):
        said = mg.find_gap(_in_a_room(seed, jump), candidates=_NAMES).probabilities
        assert not any(said.get(name, 0.0) > 0.5 for name in _NAMES)


def test_beside_magnets_nothing_but_the_field_is_named() -> None:
    """The field varies by a third of its strength: a part of that looks like any name."""
    gap = mg.find_gap(_in_a_room(1, jump=0.06, varies=15e-6))
    assert gap.names == (FIELD_VARIATION,)
    assert gap.effects[0].setting["share"] > MOST_UNEXPLAINED
    assert "more than 10% of its strength: smaller effects cannot be told; choose an interval" in gap.sentence
    assert gap.verdict == "open"
    assert not gap.calibration.trusted
    assert gap.doubt is not None
    assert gap.doubt.action == "choose an interval (start=, end=), or a place away from magnets and steel"
    assert gap.next_manoeuvre is not None
    assert gap.doubt.action in gap.next_manoeuvre.sentence


@pytest.mark.parametrize("motion", ["wide", "multi"])
def test_what_varies_fast_with_the_sensor_is_correlated_noise(motion: str) -> None:
    """By another model: the same functions in the sensor's axes were unknown, as probable as all unknown effects."""
    name = f"single-{motion}-coloured-noise-x0.25-00"
    made = generate(Scenario(name, "single", motion, seed_of(name, 411), (("coloured-noise", 0.25),)))
    assert mg.find_gap(made.recording).probabilities["coloured-noise"] > PRIOR.named_from
