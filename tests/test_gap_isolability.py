"""The isolability table against what `find_gap` says of the same strengths."""

from __future__ import annotations

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap import isolability
from magyc_gtsam.gap.effects import NAMES
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import Candidates
from magyc_gtsam.gap.evidence.detectable import power_of
from magyc_gtsam.gap.evidence.look import finer
from magyc_gtsam.gap.evidence.weighing import weigh
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.result import Isolability
from magyc_gtsam.simulation.environment import CHANNELS

_SECONDS = {"wide": 600.0, "survey": 600.0, "tiny": 150.0}


@pytest.fixture(scope="module")
def tables() -> dict[str, dict[str, Isolability]]:
    return {
        motion: {row.name: row for row in isolability(mg.simulate(motion, seconds, channels=CHANNELS).recording)}
        for motion, seconds in _SECONDS.items()
    }


# Factor 1 is 40 ms, 0.6 µT, and values of 0.6 to 1 times 150·10⁻³ s/rad about each of the three axes.
@pytest.mark.parametrize(
    ("motion", "name", "factor_1"),
    [
        ("wide", "gyro-quadratic", 0.8 * 150),
        ("survey", "timing", 40.0),
        ("wide", "hard-iron-step", 0.6),
    ],
)
def test_found_and_named_as_the_table_says(
    tables: dict[str, dict[str, Isolability]], motion: str, name: str, factor_1: float
) -> None:
    """At one and a half of the smallest strength, by the names of the table; not at a seventh."""
    row = tables[motion][name]
    for share in (1.5, 0.15):
        effect = (name, share * row.smallest / factor_1)
        recording = mg.simulate(motion, _SECONDS[motion], effects=[effect], channels=CHANNELS).recording
        gap = mg.find_gap(recording, candidates=None if share > 1 else [name])
        assert next(h for h in gap.hypotheses if h.name == name).significant == (share > 1)
        if share > 1:
            (found,) = gap.effects
            assert name in (found.name, *found.ambiguous_with)
            assert {found.name, *found.ambiguous_with} <= {name, *row.confused_with}


def test_the_table_has_every_effect(tables: dict[str, dict[str, Isolability]]) -> None:
    assert tables["wide"].keys() == set(NAMES)
    assert all(np.isfinite(row.smallest) for row in tables["wide"].values())


def test_a_survey_hardly_shows_a_scale_that_grows_with_the_rate(tables: dict[str, dict[str, Isolability]]) -> None:
    """The table is of the axis that turns least; about the one that turns, a bad part is seen (docs/limits.md)."""
    assert tables["survey"]["gyro-quadratic"].smallest > 0.15e3


def test_what_a_motion_leaves_open_is_not_found(tables: dict[str, dict[str, Isolability]]) -> None:
    """A survey turns at 0.03 rad/s about two axes, and at 0.26 about the third: it sees no gyroscope better."""
    for name in ("gyro-scale", "gyro-quadratic", "misalignment", "timing", "g-sensitivity", "cubic"):
        survey, wide = tables["survey"][name], tables["wide"][name]
        assert survey.smallest > 3.5 * wide.smallest, name
        assert not survey.nameable, name
        assert "would matter" in survey.sentence, name


def test_no_claim_is_out_of_proportion(tables: dict[str, dict[str, Isolability]]) -> None:
    for table in tables.values():
        for row in table.values():
            # The axes are tried before anything is estimated: any exchange is found.
            never = np.isinf(row.smallest)  # its channel or its level is not reached
            assert row.name == "axis-order" or never or 0.01 * row.matters < row.smallest < 1e4 * row.matters, row


def test_names_are_alone_where_a_search_tells_them_from_their_rivals(
    tables: dict[str, dict[str, Isolability]],
) -> None:
    """Delays lie in every matrix of eddy currents, and warming is much like a drift: ten minutes tell both apart."""
    wide = tables["wide"]
    for name in ("timing", "temperature-hard-iron", "motor-current"):
        assert not wide[name].confused_with, name
    assert wide["temperature-hard-iron"].nameable
    assert wide["gyro-quadratic"].confused_with["gyro-scale"] > 0.4
    assert "as temperature-hard-iron or hard-iron-drift" in tables["tiny"]["temperature-hard-iron"].sentence
    assert not tables["tiny"]["temperature-hard-iron"].nameable


def test_the_power_is_of_the_motion_and_not_of_the_noise() -> None:
    """The time of a jump that noise prefers may be at an end, where no jump is found."""
    powers = []
    for seed in range(4):
        recording = mg.simulate("wide", seed=seed, magnetometer_noise=0.7e-6).recording
        twin = base_model(recording, None, short_term_noise(recording)).twin
        found = weigh(Candidates.of(twin, ("hard-iron-step",), ()), Beside.of_model(twin))
        powers.append(power_of("hard-iron-step", found["hard-iron-step"].everywhere))
    assert min(powers) > 0.8
    assert np.ptp(powers) < 0.15


def test_a_refined_setting_keeps_what_every_setting_could_show() -> None:
    """The power of a jump was of the twelve times around the one that noise prefers."""
    recording = mg.simulate("wide", 60, seed=0).recording
    twin = base_model(recording, None, short_term_noise(recording)).twin
    beside = Beside.of_model(twin)
    found = weigh(Candidates.of(twin, ("hard-iron-step",), ()), beside)["hard-iron-step"]
    refined = finer(found, twin, beside)
    assert refined.log != found.log
    assert refined.everywhere == found.everywhere
