"""Names that explain as much as each other, and what more is known of them later."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.factors.chain.field_chain import SensorNoise
from magyc_gtsam.gap import search
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.effects.term import EffectTerm
from magyc_gtsam.gap.find import base_model
from magyc_gtsam.gap.naming import faint
from magyc_gtsam.gap.problem import Active
from magyc_gtsam.gap.refit import Refit
from magyc_gtsam.gap.result import Gap
from magyc_gtsam.gap.steps import _asked

ALONE = (1e-9, 0.0)  # only the strongest is tried


def _gap(motion: str, seed: int, *effects: tuple[str, float]) -> Gap:
    return mg.find_gap(generate(Scenario("x", "pair", motion, seed, effects)).recording)


def _names(gap: Gap) -> set[str]:
    return {effect.name for effect in gap.effects}


def test_as_good_on_the_grid_is_decided_by_the_direction_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    gap = _gap("wide", 103960999143326, ("hysteresis", 0.5))
    assert gap.verdict == "closed"
    assert _names(gap) == {"hysteresis"}
    assert gap.effects[0].ambiguous_with == ("eddy-plane",)
    monkeypatch.setattr("magyc_gtsam.gap.naming.TIE", ALONE)
    # On the grid of directions a plate explains 0.6 nats more.
    assert _names(_gap("wide", 103960999143326, ("hysteresis", 0.5))) == {"eddy-plane"}


def test_of_names_as_good_the_one_is_taken_that_leaves_least(monkeypatch: pytest.MonkeyPatch) -> None:
    hidden = ("hard-iron-drift", 1.0), ("spikes", 1.0)
    gap = _gap("moderate", 214149218315110, *hidden)
    assert gap.verdict == "closed"
    assert _names(gap) == {"hard-iron-drift", "spikes"}
    monkeypatch.setattr("magyc_gtsam.gap.naming.TIE", ALONE)
    # The temperature explains 0.1 nats more, and leaves a part that no temperature explains.
    assert "temperature-hard-iron" in _names(_gap("moderate", 214149218315110, *hidden))


def test_what_is_left_decides_only_where_it_is_less_than_what_is_explained(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("magyc_gtsam.gap.search.rest", lambda left: left)
    decided: Any = search._best
    assert decided([(175.0, "current", 50.0), (169.0, "drift", 5.0)])[1] == "drift"
    assert decided([(175.0, "current", 220.0), (169.0, "drift", 209.0)])[1] == "current"


def test_beside_colour_a_name_must_pass_clearly() -> None:
    white: Any = (SimpleNamespace(name="timing"),)
    coloured: Any = (*white, SimpleNamespace(name="coloured-noise"))
    score: Any = SimpleNamespace(name="eddy-plane", statistic=78.0, threshold=72.0)
    assert faint(score, coloured)
    assert not faint(score, white)
    score.statistic = 102.0
    assert not faint(score, coloured)
    # What lies between the settings of a grid may explain more.
    passed: Any = SimpleNamespace(name="local-anomaly", statistic=85.0, threshold=72.0)
    assert not faint(passed, coloured)


def test_a_name_is_exchanged_for_the_rival_that_explains_more_beside_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hidden = ("gyro-quadratic", 1.0), ("temperature-gyro", 1.0)
    gap = _gap("moderate", 213673857261604, *hidden)
    assert gap.verdict == "closed"
    assert _names(gap) == {"gyro-quadratic", "temperature-gyro"}
    # Its evidence is of all that it explains, as that of the name it replaces was.
    assert next(e for e in gap.effects if e.name == "gyro-quadratic").statistic > 200

    monkeypatch.setattr("magyc_gtsam.gap.search.with_exchange", lambda *_: None)
    assert "gyro-scale" in _names(_gap("moderate", 213673857261604, *hidden))


@pytest.mark.parametrize("seed", [70, 72])
def test_two_causes_are_not_one_drift(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Iron that warms and is moved once; neither explains as much as a drift of twelve modes does."""
    recording = mg.simulate("wide", seed=seed, channels=["temperature"]).recording
    time = recording.time
    warmth = 4 * (1 - np.exp(-time / 250))
    extra = warmth[:, None] * np.array([0.15e-6, 0.1e-6, -0.12e-6]) + np.outer(
        time > 400, [-0.6e-6, 0.8e-6, 0.1e-6]
    )
    hidden = replace(
        recording, magnetic_field=recording.magnetic_field + extra, channels={"temperature": 15 + warmth}
    )
    gap = mg.find_gap(hidden)
    assert gap.verdict == "closed"
    assert _names(gap) == {"temperature-hard-iron", "hard-iron-step"}
    jump = next(e for e in gap.effects if e.name == "hard-iron-step")
    assert np.linalg.norm(jump.value - [-0.6, 0.8, 0.1]) < 4 * np.linalg.norm(jump.sigma)

    monkeypatch.setattr("magyc_gtsam.gap.search.with_two_causes", lambda *_: None)
    assert _names(mg.find_gap(hidden)) != {"temperature-hard-iron", "hard-iron-step"}


def test_a_line_of_the_motion_is_not_a_tone_while_a_delay_explains_it(monkeypatch: pytest.MonkeyPatch) -> None:
    hidden = ("hard-iron-step", 1.0), ("timing", 1.0)
    gap = _gap("moderate", 76702749063867, *hidden)
    assert gap.verdict == "closed"
    assert _names(gap) == {"hard-iron-step", "timing"}
    monkeypatch.setattr("magyc_gtsam.gap.naming._SLOW", 0.5)  # Hz; the line is at 0.5001
    assert _names(_gap("moderate", 76702749063867, *hidden)) != {"hard-iron-step", "timing"}


@pytest.mark.parametrize("seed", [17131588332080, 155810056638208])
def test_more_left_than_was_named_speaks_against_the_name(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    gap = _gap("moderate", seed, ("servo-magnet", 0.5))
    assert gap.verdict == "unknown"
    assert not gap.effects
    left = next(h for h in gap.hypotheses if h.name in gap.diagnostics["leftover"])
    assert left.status != "vetoed"
    monkeypatch.setattr("magyc_gtsam.gap.objections._MANY", 1000)
    assert _gap("moderate", seed, ("servo-magnet", 0.5)).effects  # hysteresis and cubic explain some of it


def test_what_clips_takes_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bend that a loss of a twentieth beyond some level explains best."""
    gap = _gap("moderate", 254445855685853, ("cubic", 1.0))
    assert gap.verdict == "closed"
    assert _names(gap) == {"cubic"}
    assert gap.effects[0].ambiguous_with == ("saturation",)
    monkeypatch.setattr("magyc_gtsam.gap.refit.TERMS", {**TERMS, "saturation": _anything("saturation")})
    assert _names(_gap("moderate", 254445855685853, ("cubic", 1.0))) == {"saturation"}


def _anything(name: str) -> EffectTerm:
    return replace(TERMS[name], possible=lambda *_: True)


def test_of_two_steps_the_one_that_stays_has_all_their_evidence() -> None:
    """Two explain as much as one whose other end is next to the end of the recording; that one is taken out."""
    gap = _gap("multi", 224536401793529, ("hard-iron-step", 1.0))
    assert gap.verdict == "closed"
    (step,) = gap.effects
    assert step.name == "hard-iron-step"
    assert step.statistic > 120
    assert {"time:sensor-12", "position:magnetometer"} <= {
        h.name for h in gap.hypotheses if h.statistic > step.statistic
    }


def test_a_family_that_the_name_holds_is_not_ahead_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three values of pitch and roll explain as much as the nine of a gyroscope that feels acceleration."""
    gap = _gap("multi", 161429319753792, ("g-sensitivity", 1.0))
    assert gap.verdict == "closed"
    assert _names(gap) == {"g-sensitivity"}
    monkeypatch.setattr("magyc_gtsam.gap.objections._HELD", 1.0)
    assert _gap("multi", 161429319753792, ("g-sensitivity", 1.0)).verdict == "unknown"


def test_what_makes_another_superfluous_explains_that_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step explains more than a drift of few modes; the drift that takes its place has the evidence of both."""
    gap = _gap("multi", 45163682133384, ("hard-iron-drift", 1.0))
    assert gap.verdict == "closed"
    assert _names(gap) == {"hard-iron-drift"}
    assert gap.effects[0].statistic > 120
    monkeypatch.setattr("magyc_gtsam.gap.steps._taken_over", lambda _, after, __: after)
    assert _gap("multi", 45163682133384, ("hard-iron-drift", 1.0)).verdict == "unknown"


def test_a_weak_name_beside_a_strong_rival_explains_a_fifth_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what each explains in one model; what is strong by itself stands, as do the plates of a matrix."""

    def asked(weights: dict[str, float], index: int, uneven: str = "") -> float:
        terms = [Active(n, {"uneven": 1.0} if n == uneven else {}, np.zeros(3)) for n in weights]
        model = replace(gap_model, terms=tuple(terms))
        monkeypatch.setattr(Refit, "weight_of", lambda _, i: list(weights.values())[i])
        return _asked(Refit(replace(twin, model=model), np.zeros((0, 0)), True), index, range(len(terms)))

    twin = base_model(mg.simulate("wide", 60, seed=3).recording, None, SensorNoise(1e-6, 5e-3)).twin
    gap_model = twin.model
    assert asked({"misalignment": 300.0, "cubic": 47.0}, 1) == pytest.approx(60.0)
    assert asked({"misalignment": 3000.0, "cubic": 47.0}, 1) == pytest.approx(100.0)
    assert asked({"misalignment": 300.0, "hard-iron-step": 47.0}, 1) == 0
    # No loop is quite of the form of another.
    assert asked({"hysteresis": 3000.0, "eddy-plane": 147.0}, 1) == pytest.approx(600.0)
    assert asked({"hysteresis": 3000.0, "eddy-plane": 147.0}, 1, uneven="eddy-plane") == pytest.approx(600.0)
    assert asked({"timing": 3000.0, "eddy-plane": 47.0}, 1, uneven="eddy-plane") == 0
    assert asked({"timing": 47.0, "eddy-plane": 3000.0}, 0, uneven="eddy-plane") == 0
