"""The names that score tests gave, as the posterior sees them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.gap.effects import NAMES
from magyc_gtsam.gap.evidence.answer import Answer, answer
from magyc_gtsam.gap.evidence.decision import NOTHING, UNKNOWN
from magyc_gtsam.gap.evidence.posterior import Set
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import FIELD_VARIATION
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.field_variation import field_variation
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.outcome.outcome import gap_of
from magyc_gtsam.gap.search.adopted import adopted
from magyc_gtsam.gap.search.found import Found
from magyc_gtsam.gap.search.search import Search, search
from magyc_gtsam.gap.search.weighed import weighed
from magyc_gtsam.report.gap_words import key_numbers

Looked = tuple[Search, Answer, Refit, SensorNoise]


@pytest.fixture(scope="module")
def looked() -> Looked:
    """A late magnetometer, searched and weighed."""
    recording = mg.simulate("wide", 200, seed=9, effects=[("timing", 2.0)]).recording
    noise = short_term_noise(recording)
    base = base_model(recording, None, noise)
    found = search(recording, base, noise, NAMES, lambda share: None)
    return found, answer(recording, base, noise, NAMES), base, noise


def gap_by(looked: Looked, posterior: Mapping[Set, float]) -> mg.Gap:
    """What is told of it under a posterior."""
    found, said, base, noise = looked
    result = weighed(found, replace(said, posterior=dict(posterior)), noise)
    return gap_of(result, base, noise, None, NAMES, (), 0.0)


def test_a_name_that_is_likely_is_corrected(looked: Looked) -> None:
    gap = gap_by(looked, looked[1].posterior)
    assert gap.names == ("timing",)
    assert gap.effects[0].applied
    assert gap.verdict == "closed"


def test_an_improbable_name_is_not_given(looked: Looked) -> None:
    """A name and something unknown that is nearly certain would contradict each other."""
    least = PRIOR.improbable
    gap = gap_by(looked, {((), True): 1 - 0.5 * least, (("timing",), False): 0.5 * least})
    assert gap.verdict == "unknown"
    assert not gap.names
    assert "missing" in gap.sentence
    assert gap.calibration.delay == 0
    assert not gap.calibration.trusted
    again = gap_by(looked, {((), True): 1 - 2 * least, (("timing",), True): 2 * least})
    assert again.names == ("timing",)  # whatever is unknown beside it
    assert again.effects[0].applied


def test_what_the_field_of_the_place_explains_is_not_named(
    looked: Looked, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The variation is named by its own probability; a gap in which nothing else is left is closed."""
    found, said, base, noise = looked
    variation = replace(field_variation(said.tree.best.fit.twin), gain=100.0)
    monkeypatch.setattr(said.tree, "nodes", {(): replace(said.tree.best, variation=variation)})
    for unknown, verdict in ((0.0, "closed"), (0.2, "closed"), (0.95, "open")):
        posterior = {((FIELD_VARIATION,), False): 1 - unknown, ((FIELD_VARIATION,), True): unknown}
        gap = gap_by((found, said, base, noise), posterior)
        assert gap.names == (FIELD_VARIATION,)
        assert gap.verdict == verdict


def test_something_unknown_that_is_sure_is_left(looked: Looked) -> None:
    """The score tests leave nothing here, and the verdict says what the probabilities say."""
    sure = {(("timing",), True): PRIOR.sure + 0.01, (("timing",), False): 0.09 - PRIOR.unforeseen}
    gap = gap_by(looked, sure)
    assert gap.effects[0].applied
    assert gap.verdict == "open"
    assert "missing" in gap.sentence
    less = {(("timing",), True): PRIOR.sure - 0.01, (("timing",), False): 0.11}
    assert gap_by(looked, less).verdict == "closed"


def test_a_name_is_as_likely_as_all_that_it_may_be(looked: Looked) -> None:
    found, said, _, noise = looked
    two = replace(found, found=tuple(replace(one, rivals=("eddy-plane",)) for one in found.found))
    (one,) = weighed(two, replace(said, posterior={(("eddy-plane",), False): 1.0}), noise).found
    assert one.name == "timing"


@pytest.mark.parametrize("name", ["coloured-noise", "tone"])
def test_what_is_no_noise_is_left(looked: Looked, name: str) -> None:
    found, said, _, noise = looked
    loud = replace(found, found=(*found.found, Found(name, 90.0, 20.0, 40.0)))
    result = weighed(loud, replace(said, posterior={(("timing",), False): 1.0}), noise)
    assert [one.name for one in result.found] == ["timing"]
    assert result.leftover == (name,)


def test_a_set_that_is_sure_is_adopted(looked: Looked, monkeypatch: pytest.MonkeyPatch) -> None:
    """The score tests gave up; the posterior is sure, or it is not, or the set predicts nothing."""
    found, said, base, noise = looked
    nothing = replace(found, found=(), last=found.first, leftover=("field:cubic",))
    gap = gap_of(adopted(nothing, said, noise), base, noise, None, NAMES, (), 0.0)
    assert gap.names == ("timing",)
    assert gap.verdict == "closed"
    assert gap.calibration.delay == pytest.approx(gap_by(looked, said.posterior).calibration.delay, rel=1e-3)
    assert adopted(found, said, noise) is found
    unsure = {(("timing",), False): PRIOR.sure - 0.01, ((), True): 1.01 - PRIOR.sure}
    assert adopted(nothing, replace(said, posterior=unsure), noise) is nothing
    monkeypatch.setattr("magyc_gtsam.gap.search.adopted.predicts", lambda *_: False)
    assert adopted(nothing, said, noise) is nothing


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
            assert all(effect.probability > PRIOR.sure for effect in gap.effects)
            assert "field-variation" not in {term.name for term in gap.calibration.terms}
            (added,) = (number for number in key_numbers(gap) if number.what == "Effects added")
            assert int(added.value) == len(gap.effects) - 1
