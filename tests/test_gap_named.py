"""The names that the posterior gives, and the verdict that follows."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.gap.effects import NAMES, TERMS
from magyc_gtsam.gap.evidence.answer import Answer, answer
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION
from magyc_gtsam.gap.evidence.posterior import NOTHING, UNKNOWN, Set
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.field_variation import field_variation
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.naming.named import _each_once, _parts, named
from magyc_gtsam.gap.outcome.outcome import gap_of
from magyc_gtsam.gap.samples.first import First
from magyc_gtsam.report.gap_words import key_numbers

Looked = tuple[First, Answer, SensorNoise]


@pytest.fixture(scope="module")
def looked() -> Looked:
    """A late magnetometer."""
    recording = mg.simulate("wide", 200, seed=9, effects=[("timing", 2.0)]).recording
    noise = short_term_noise(recording)
    base = base_model(recording, None, noise)
    first = First(recording, base)
    return first, answer(first, noise, NAMES), noise


def gap_by(looked: Looked, posterior: Mapping[Set, float]) -> mg.Gap:
    """What is told of it under a posterior."""
    first, said, noise = looked
    result = named(replace(said, posterior=dict(posterior)), first, noise)
    return gap_of(result, noise, None, NAMES, ())


def test_a_probable_effect_is_named_and_corrected(looked: Looked) -> None:
    gap = gap_by(looked, looked[1].posterior)
    assert gap.names == ("timing",)
    assert gap.effects[0].applied
    assert gap.effects[0].probability == gap.probabilities["timing"] > 0.9
    assert gap.verdict == "closed"
    assert {h.name: h.status for h in gap.hypotheses}["timing"] == "named"


def test_an_effect_that_is_probable_in_sets_that_were_not_fitted_is_named(looked: Looked) -> None:
    """Its probability was told, and that it is not probable enough."""
    first, said, noise = looked
    tree = copy(said.tree)
    tree.nodes = {key: node for key, node in tree.nodes.items() if not key}
    gap = gap_by((first, replace(said, tree=tree), noise), said.posterior)
    assert gap.names == ("timing",)
    assert gap.verdict == "closed"


def test_an_improbable_effect_is_not_named(looked: Looked) -> None:
    least = PRIOR.named_from
    gap = gap_by(looked, {((), True): 1.01 - least, (("timing",), True): least - 0.01})
    assert gap.verdict == "unknown"
    assert not gap.names
    assert "missing" in gap.sentence
    assert gap.calibration.delay == 0
    assert not gap.calibration.trusted
    assert {h.name: h.status for h in gap.hypotheses}["timing"] == "possible"
    again = gap_by(looked, {((), True): 0.99 - least, (("timing",), True): least + 0.01})
    assert again.names == ("timing",)
    assert again.verdict == "open"
    assert again.effects[0].applied


def test_something_is_missing_only_where_that_is_probable(looked: Looked) -> None:
    """Any effect that is not named counts, not only one outside the catalogue."""
    least = PRIOR.missing_from
    half = 0.5 * (least + 0.01)
    assert (
        gap_by(looked, {((), False): 0.99 - least, (("timing",), False): half, ((), True): half}).verdict
        == "unknown"
    )
    half = 0.5 * (least - 0.01)
    gap = gap_by(looked, {((), False): 1.01 - least, (("timing",), False): half, ((), True): half})
    assert gap.verdict == "none"
    assert "possible" in gap.sentence


def test_a_misalignment_that_the_sigmas_hold_is_not_missing(looked: Looked) -> None:
    """The skew of the chips is estimated beside every model, whether it is named or not."""
    gap = gap_by(looked, {(("misalignment",), False): 0.75, (("hysteresis",), False): 0.2, ((), False): 0.05})
    assert gap.verdict == "none"
    assert gap.doubt is None


def test_effects_of_which_one_is_missing_are_listed(looked: Looked) -> None:
    """They are of the catalogue: it would be false that what is missing is not in it."""
    listed = {(("hysteresis",), False): 0.6, (("saturation",), False): 0.3, ((), True): 0.1}
    gap = gap_by(looked, listed)
    said = "one of “magnetic hysteresis of nearby iron” (60%) and “magnetometer saturation” (30%) is missing"
    assert gap.verdict == "unknown"
    assert gap.doubt is not None
    assert gap.doubt.cause == said
    assert gap.next_manoeuvre is not None
    assert gap.next_manoeuvre.motion == gap.doubt.action == TERMS["hysteresis"].motion
    listed |= {((), True): 0.4, (("saturation",), False): 0.0}
    assert (
        "one of “magnetic hysteresis of nearby iron” (60%) and an unknown effect (40%)"
        in gap_by(looked, listed).sentence
    )
    outside = gap_by(looked, {((), True): 0.95, (("hysteresis",), False): 0.05})
    assert "it is not in the catalogue" in outside.sentence


def test_rivals_are_named_together(looked: Looked) -> None:
    """Neither is probable, but one of both is."""
    gap = gap_by(looked, {(("timing",), False): 0.5, (("eddy-plane",), False): 0.45, ((), True): 0.05})
    assert gap.names == ("timing",)
    assert gap.effects[0].ambiguous_with == ("eddy-plane",)
    assert gap.verdict == "closed"
    unlike = gap_by(looked, {(("timing",), False): 0.78, (("eddy-plane",), False): 0.04, ((), True): 0.18})
    assert not unlike.names  # the likely one alone is not probable enough, and the other is not a rival
    apart = gap_by(looked, {(("timing",), False): 0.5, (("cubic",), False): 0.45, ((), True): 0.05})
    assert not apart.names  # the two are not confused with each other
    assert apart.verdict == "unknown"
    parts = {names: 0.25 for names in ((), ("timing",), ("eddy-plane",), ("eddy-plane", "timing"))}
    beside = gap_by(looked, {(names, True): share for names, share in parts.items()} | {(("timing",), False): 0.1})
    assert not beside.names  # each may be a part of what is unknown, independently of the other


def test_the_variation_of_the_field_is_named_by_its_own_probability(
    looked: Looked, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, said, noise = looked
    bare = said.tree.nodes[()]
    variation = replace(field_variation(bare.fit.twin), gain=100.0)
    monkeypatch.setattr(said.tree, "nodes", {(): replace(bare, variation=variation)})
    for unknown, verdict in ((0.0, "closed"), (0.2, "closed"), (0.95, "open")):
        posterior = {((FIELD_VARIATION,), False): 1 - unknown, ((FIELD_VARIATION,), True): unknown}
        gap = gap_by((first, said, noise), posterior)
        assert gap.names == (FIELD_VARIATION,)
        assert gap.effects[0].ambiguous_with == ("field-gradient",)  # there is no position
        assert gap.verdict == verdict


def test_one_step_ends_where_another_is() -> None:
    """An object is taken off and another attached in the same window: there is one step, not two of the same form."""
    on_and_off = Active("hard-iron-step", {"time": 20.0, "until": 60.0}, np.ones(3))
    other = Active("hard-iron-step", {"time": 60.0}, np.ones(3))
    late, time = Active("timing", {}, np.ones(1)), np.arange(100.0)
    parts = _each_once(part for term in (on_and_off, late, other) for part in _parts(term, time))
    assert [(part.name, part.setting.get("time")) for part in parts] == [
        ("hard-iron-step", 20.0),
        ("hard-iron-step", 60.0),
        ("timing", None),
    ]
    assert [part.setting["time"] for part in _parts(on_and_off, np.arange(50.0))] == [20.0]


def test_a_field_that_varies_closes_the_gap() -> None:
    """In the world's axes it is the place's, and nothing else is named for it; in the sensor's it has no name."""
    recording = mg.simulate("wide", 300, seed=8).recording
    phases = np.random.default_rng(1).uniform(0, 6, (3, 5))
    slow = np.sin(2 * np.pi * recording.time[:, None, None] / np.array([31, 43, 57, 71, 97.0]) + phases).sum(
        axis=2
    )
    for moving, added in (
        (False, Rotation.from_quat(recording.attitude).inv().apply(slow)),
        (True, slow),
    ):
        field = recording.magnetic_field + 0.4e-6 * added
        gap = mg.find_gap(mg.Recording(recording.time, field, recording.angular_rate))
        assert ("field-variation" in gap.names) is not moving
        if moving:
            assert gap.probabilities.get(FIELD_VARIATION, 0.0) < 0.5
        if not moving:
            assert gap.verdict == "closed"
            assert gap.probabilities[FIELD_VARIATION] > 0.95
            assert gap.probabilities.get(UNKNOWN, 0.0) + gap.probabilities.get(NOTHING, 0.0) < 0.5
            assert gap.effects[-1].unit == "µT"
            assert 0.1 < gap.effects[-1].value[0] < 1.6
            assert all(effect.probability > PRIOR.named_from for effect in gap.effects)
            assert "field-variation" not in {term.name for term in gap.calibration.terms}
            (added,) = (number for number in key_numbers(gap) if number.what == "Effects added")
            assert int(added.value) == len(gap.effects) - 1


def test_a_delay_is_estimated_beside_what_is_named() -> None:
    """At a constant spin a delay turns the field as a misalignment does: fixed at 0, it would be taken for one."""
    recording = mg.simulate("moderate", 100, seed=2, delay=0.01, effects=[("misalignment", 2.0)]).recording
    gap = mg.find_gap(recording, candidates=["misalignment"])
    assert gap.names == ("misalignment",)
    assert gap.calibration.delay_sigma is not None
    assert abs(gap.calibration.delay - 0.01) < 3 * gap.calibration.delay_sigma


def test_a_second_jump_is_named_if_it_is_as_probable_as_a_name() -> None:
    """The best of many times at which it may have gone back explains some noise: at 395 s here."""
    base = mg.simulate("wide", 400, seed=12).recording
    since = base.time[:, None] - base.time[0]
    size = np.array([1e-7, -3.6e-7, 1.5e-7])
    found = []
    for there in (since > 175, (since > 175) & (since < 290)):
        moved = replace(base, magnetic_field=base.magnetic_field + there * size)
        gap = mg.find_gap(moved, candidates=["hard-iron-step"])
        assert set(gap.names) == {"hard-iron-step"}
        found.append([effect.setting["time"] for effect in gap.effects])
    assert found[0] == pytest.approx([175], abs=10)
    assert found[1] == pytest.approx([175, 290], abs=15)
