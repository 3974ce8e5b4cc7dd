"""Effects of the blind test put into real recordings, and what was once mistaken in them."""

from __future__ import annotations

from pathlib import Path

import pytest

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario

pytestmark = pytest.mark.real

FAST = "broad_06_fast_rotation.mcap"
MAGNET = "broad_32_attached_magnet_1cm.mcap"
WALK = "nexus5_augmented_reality.mcap"
CALIBRATION = "nexus5_calibration_d1.mcap"


def with_hidden(
    effect: str, seed: int, log: Path, start: float | None = None, end: float | None = None
) -> mg.Recording:
    """A part of a log with an effect that stands out in it as far as its published strength does in a simulated one."""
    scenario = Scenario("x", "real", log.stem, seed, ((effect, 1.0),))
    return generate(scenario, mg.read(log).between(start, end)).recording


def test_products_of_a_name_do_not_take_its_evidence(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A drift of 1.4 µT beside a room: what is left is of the form of its products, and a tenth of what it explains."""
    drifting = with_hidden("hard-iron-drift", 242620365030394, shared_data / MAGNET, 41.5, 92)
    assert "hard-iron-drift" in mg.find_gap(drifting).names
    monkeypatch.setattr("magyc_gtsam.gap.objections.product_of", lambda _: None)
    assert "hard-iron-drift" not in mg.find_gap(drifting).names


def test_what_a_growing_scale_leaves_is_no_passed_object(shared_data: Path) -> None:
    """Beside the scale error that the phone's gyroscope has, which is taken for what the growing one leaves."""
    gap = mg.find_gap(with_hidden("gyro-quadratic", 138430964859705, shared_data / CALIBRATION))
    assert {"timing", "gyro-quadratic"} <= set(gap.names)
    assert "local-anomaly" not in gap.names


def test_a_growing_scale_levels_off(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At 16 rad/s it is nearly a plain scale."""
    recording = with_hidden("gyro-quadratic", 231329256614374, shared_data / FAST, 40, 80)
    gap = mg.find_gap(recording)
    growing = next(e for e in gap.effects if e.name == "gyro-quadratic")
    assert 1.0 <= growing.setting["level"] <= 10.0
    assert "ever less beyond" in growing.sentence
    assert "gyro-scale" not in gap.names
    monkeypatch.setattr("magyc_gtsam.gap.effects.gyroscope._LEVELS", ())
    assert "gyro-scale" in mg.find_gap(recording).names


def test_what_lies_between_the_bumps_of_the_grid_is_tried(shared_data: Path) -> None:
    """A bump explains more than the position does, but on the grid a tenth less."""
    recording = with_hidden("tone", 209321639191110, shared_data / FAST, 40, 155)
    names = mg.find_gap(recording).names
    assert {"tone", "local-anomaly"} <= set(names)
    assert "field-gradient" not in names


def test_a_slow_channel_counts_in_a_short_recording(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A temperature of 50 s, which explains as much a second later: that is no other time."""
    recording = with_hidden("temperature-gyro", 210326453580875, shared_data / MAGNET, 41.5, 92)
    names = mg.find_gap(recording).names
    assert "temperature-gyro" in names
    assert "g-sensitivity" not in names
    monkeypatch.setattr("magyc_gtsam.gap.own_time._SAME", 1.1)
    assert "temperature-gyro" not in mg.find_gap(recording).names


def test_what_a_channel_too_slow_to_tell_explains_better_may_be_its(shared_data: Path) -> None:
    """In 28 s a temperature explains as much at most other times; a bump that explains less takes its place."""
    gap = mg.find_gap(with_hidden("temperature-gyro", 269562187165566, shared_data / CALIBRATION))
    passed = next(e for e in gap.effects if e.name == "local-anomaly")
    assert "temperature-gyro" in passed.ambiguous_with


def test_a_loop_as_wide_as_the_field_allows_is_none(shared_data: Path) -> None:
    """It never closes: a bent gain, of what a temperature leaves that comes late."""
    recording = with_hidden("temperature-hard-iron", 113857388251021, shared_data / MAGNET, 41.5, 92)
    gap = mg.find_gap(recording)
    assert "temperature-hard-iron" in gap.names
    assert "hysteresis" not in gap.names


def test_a_core_saturates_softly(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On one side of one axis, where a power of the field explains more than what lies beyond a level does."""
    recording = with_hidden("saturation", 251224500127924, shared_data / WALK)
    gap = mg.find_gap(recording)
    assert gap.verdict == "closed"
    (effect,) = [e for e in gap.effects if e.name != "coloured-noise"]
    assert effect.name == "saturation"
    assert effect.setting["knee"] > 0
    assert "softly" in effect.sentence
    monkeypatch.setattr("magyc_gtsam.gap.effects.response._KNEES", ())
    assert "saturation" not in mg.find_gap(recording).names


def test_what_warms_up_behind_the_thermometer_may_be_a_drift_in_half_a_minute(shared_data: Path) -> None:
    """Of the lags that are looked for, 28 s hold none."""
    gap = mg.find_gap(with_hidden("temperature-hard-iron", 276434416037446, shared_data / CALIBRATION))
    drift = next(e for e in gap.effects if e.name == "hard-iron-drift")
    assert "temperature-hard-iron" in drift.ambiguous_with


def test_what_is_left_of_a_delay_for_its_form_may_be_the_effect(shared_data: Path) -> None:
    """A plate and the phone's delay explain most of a hysteresis, and the rest of it is little beside the delay."""
    gap = mg.find_gap(with_hidden("hysteresis", 158700465263294, shared_data / CALIBRATION))
    assert "hysteresis" not in gap.names
    late = next(e for e in gap.effects if e.name == "timing")
    assert "hysteresis" in late.ambiguous_with


def test_a_matrix_of_eddy_currents_becomes_the_delay_once_the_loop_is_known(shared_data: Path) -> None:
    """Before a hysteresis is in the model, a matrix explains more of it, and of the delay, than any other name."""
    recording = with_hidden("hysteresis", 109766625713881, shared_data / MAGNET, 41.5, 92)
    names = mg.find_gap(recording).names
    assert {"hysteresis", "timing"} <= set(names)
    assert "eddy-plane" not in names


def test_what_a_loop_leaves_for_its_form_is_no_plate(shared_data: Path) -> None:
    """A fifth of what the loop explained at the noise without it, a tenth of what it explains with it."""
    recording = with_hidden("hysteresis", 106057416373883, shared_data / WALK)
    gap = mg.find_gap(recording)
    assert gap.names == ("hysteresis",)
    assert gap.effects[0].ambiguous_with == ("eddy-plane", "timing")


def test_coarse_steps_of_a_phone_are_no_hold(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They repeat for one to five rows where it is turned slowly; a clock would hold one or two at a time."""
    recording = with_hidden("quantisation", 266710381606992, shared_data / CALIBRATION)
    names = mg.find_gap(recording).names
    assert "quantisation" in names
    assert "sample-hold" not in names
    monkeypatch.setattr("magyc_gtsam.gap.noise_effects._BY_CHANCE", 10.0)
    assert "sample-hold" in mg.find_gap(recording).names
