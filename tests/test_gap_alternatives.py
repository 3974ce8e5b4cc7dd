"""Names that explain as much as each other, and what more is known of them later."""

from __future__ import annotations

import pytest

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.gap.result import Gap


def _gap(motion: str, seed: int, *effects: tuple[str, float]) -> Gap:
    return mg.find_gap(generate(Scenario("x", "pair", motion, seed, effects)).recording)


def _names(gap: Gap) -> set[str]:
    return {effect.name for effect in gap.effects}


def test_as_good_on_the_grid_is_decided_by_the_direction_beside_it() -> None:
    gap = _gap("wide", 103960999143326, ("hysteresis", 0.5))
    assert gap.verdict == "closed"
    assert _names(gap) == {"hysteresis"}  # on the grid of directions a plate explains 0.6 nats more


def test_of_names_as_good_the_one_is_taken_that_leaves_least() -> None:
    gap = _gap("moderate", 214149218315110, ("hard-iron-drift", 1.0), ("spikes", 1.0))
    assert gap.verdict == "closed"
    # The temperature explains 0.1 nats more, and leaves a part that no temperature explains.
    assert _names(gap) == {"hard-iron-drift", "spikes"}


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


def test_a_line_of_the_motion_is_not_a_tone_while_a_delay_explains_it() -> None:
    gap = _gap("moderate", 76702749063867, ("hard-iron-step", 1.0), ("timing", 1.0))
    assert gap.verdict == "closed"
    assert _names(gap) == {"hard-iron-step", "timing"}  # the line is at 0.5001 Hz


@pytest.mark.parametrize("seed", [17131588332080, 155810056638208])
def test_more_left_than_was_named_speaks_against_the_name(seed: int) -> None:
    gap = _gap("moderate", seed, ("servo-magnet", 0.5))
    assert gap.verdict == "unknown"  # hysteresis and cubic explain some of it
    assert not gap.effects
