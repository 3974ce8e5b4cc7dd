"""The gap workflow on real recordings: what is known to be missing in them is found, and so is what is put in."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam import metrics
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.estimators.chain_search import short_term_noise
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.find import base_model
from magyc_gtsam.gap.noise_effects import sample_hold
from magyc_gtsam.gap.result import Gap
from magyc_gtsam.report.gap_page import render_gap
from magyc_gtsam.simulation import inject

pytestmark = pytest.mark.real

TURNED = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])


@lru_cache
def looked_at(log: Path, start: float | None, end: float | None) -> tuple[mg.Recording, Gap]:
    """A part of a log, and what is found in it."""
    recording = mg.read(log).between(start, end)
    return recording, mg.find_gap(recording)


def heading(recording: mg.Recording, calibration: mg.Calibration) -> float:
    """Degrees against the optical attitude."""
    known = np.isfinite(recording.attitude).all(axis=1) & recording.magnetic_field_fresh
    field = calibration.apply(recording)[known]
    return float(metrics.heading_deviation(field, recording.attitude[known]))


@pytest.mark.parametrize(
    ("name", "start", "end", "low", "high"),
    [
        ("broad_01_slow_rotation.mcap", 36, 100, 8.5, 12.5),
        ("broad_01_slow_rotation.mcap", 34, 160, 8.5, 12.5),
        ("broad_06_fast_rotation.mcap", 40, 100, 9.5, 11.5),
        ("nexus5_augmented_reality.mcap", None, None, 20, 60),
        ("nexus5_calibration_d1.mcap", None, None, 20, 60),
    ],
)
def test_a_late_magnetometer_is_found(
    shared_data: Path, name: str, start: float | None, end: float | None, low: float, high: float
) -> None:
    """Without a delay in the model that the search begins with."""
    recording, gap = looked_at(shared_data / name, start, end)
    late = next(effect for effect in gap.effects if effect.name == "timing")
    assert low < late.value[0] < high
    assert gap.verdict in ("closed", "open")
    if recording.attitude is not None:
        assert heading(recording, gap.calibration) < heading(recording, gap.base)


def test_one_instrument_has_one_delay_and_one_misalignment(shared_data: Path) -> None:
    """Of two recordings of it, one slow and one fast, whose rooms differ."""
    _, slow = looked_at(shared_data / "broad_01_slow_rotation.mcap", 36, 100)
    _, fast = looked_at(shared_data / "broad_06_fast_rotation.mcap", 40, 100)
    for name, size in (("timing", 1.0), ("misalignment", 4.0)):
        first, second = (next(e for e in gap.effects if e.name == name) for gap in (slow, fast))
        np.testing.assert_allclose(first.value, second.value, atol=size)


def test_products_of_a_name_do_not_take_its_evidence(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A drift of 1.4 µT beside a room: what is left is of the form of its products, and a tenth of what it explains."""
    recording = mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap").between(41.5, 92)
    drifting = generate(
        Scenario("x", "real", "log", 242620365030394, (("hard-iron-drift", 1.0),)), recording
    ).recording
    assert "hard-iron-drift" in mg.find_gap(drifting).names
    monkeypatch.setattr("magyc_gtsam.gap.objections.product_of", lambda _: None)
    assert "hard-iron-drift" not in mg.find_gap(drifting).names


def test_a_small_step_put_in_is_found_beside_the_room(shared_data: Path) -> None:
    """Of 1.3 times the published strength, in a room that leaves more than it explains; the delay stays."""
    recording = mg.read(shared_data / "broad_01_slow_rotation.mcap").between(36, 154)
    stepped, (truth,) = inject(recording, mg.calibrate(recording), [("hard-iron-step", 1.3)], seed=5)
    found = {e.name: e for e in mg.find_gap(stepped).effects}
    assert found["timing"].value[0] == pytest.approx(10.8, abs=0.5)
    step = found["hard-iron-step"]
    assert step.setting["time"] - recording.time[0] == pytest.approx(truth.drawn["time"], abs=1.0)
    np.testing.assert_allclose(step.value, 0.78 * truth.drawn["direction"], atol=0.2)


def test_what_a_growing_scale_leaves_is_no_passed_object(shared_data: Path) -> None:
    """Beside the scale error that the phone's gyroscope has, which is taken for what the growing one leaves."""
    hidden = Scenario("x", "real", "nexus5_calibration_d1", 138430964859705, (("gyro-quadratic", 1.0),))
    gap = mg.find_gap(generate(hidden, mg.read(shared_data / "nexus5_calibration_d1.mcap")).recording)
    assert {"timing", "gyro-quadratic"} <= set(gap.names)
    assert "local-anomaly" not in gap.names


def test_a_growing_scale_levels_off(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At 16 rad/s it is nearly a plain scale."""
    hidden = Scenario("x", "real", "broad_06_fast_rotation", 231329256614374, (("gyro-quadratic", 1.0),))
    recording = generate(hidden, mg.read(shared_data / "broad_06_fast_rotation.mcap").between(40, 80)).recording
    gap = mg.find_gap(recording)
    growing = next(e for e in gap.effects if e.name == "gyro-quadratic")
    assert 1.0 <= growing.setting["level"] <= 10.0
    assert "ever less beyond" in growing.sentence
    assert "gyro-scale" not in gap.names
    monkeypatch.setattr("magyc_gtsam.gap.effects.gyroscope._LEVELS", ())
    assert "gyro-scale" in mg.find_gap(recording).names


def test_what_lies_between_the_bumps_of_the_grid_is_tried(shared_data: Path) -> None:
    """A bump explains more than the position does, but on the grid a tenth less."""
    hidden = Scenario("x", "real", "broad_06_fast_rotation", 209321639191110, (("tone", 1.0),))
    recording = generate(hidden, mg.read(shared_data / "broad_06_fast_rotation.mcap").between(40, 155)).recording
    names = mg.find_gap(recording).names
    assert {"tone", "local-anomaly"} <= set(names)
    assert "field-gradient" not in names


def test_a_slow_channel_counts_in_a_short_recording(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A temperature of 50 s, which explains as much a second later: that is no other time."""
    hidden = Scenario("x", "real", "broad_32", 210326453580875, (("temperature-gyro", 1.0),))
    recording = generate(
        hidden, mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap").between(41.5, 92)
    ).recording
    names = mg.find_gap(recording).names
    assert "temperature-gyro" in names
    assert "g-sensitivity" not in names
    monkeypatch.setattr("magyc_gtsam.gap.own_time._SAME", 1.1)
    assert "temperature-gyro" not in mg.find_gap(recording).names


def test_what_a_channel_too_slow_to_tell_explains_better_may_be_its(shared_data: Path) -> None:
    """In 28 s a temperature explains as much at most other times; a bump that explains less takes its place."""
    hidden = Scenario("x", "real", "nexus5_calibration_d1", 269562187165566, (("temperature-gyro", 1.0),))
    gap = mg.find_gap(generate(hidden, mg.read(shared_data / "nexus5_calibration_d1.mcap")).recording)
    passed = next(e for e in gap.effects if e.name == "local-anomaly")
    assert "temperature-gyro" in passed.ambiguous_with


def test_a_loop_as_wide_as_the_field_allows_is_none(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It never closes: a bent gain, of what a temperature leaves that comes late."""
    hidden = Scenario("x", "real", "broad_32", 113857388251021, (("temperature-hard-iron", 1.0),))
    recording = generate(
        hidden, mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap").between(41.5, 92)
    ).recording
    gap = mg.find_gap(recording)
    assert "temperature-hard-iron" in gap.names
    assert "hysteresis" not in gap.names
    assert next(h for h in gap.hypotheses if h.name == "hysteresis").status == "slight"
    monkeypatch.setattr("magyc_gtsam.gap.effects.response._NO_LOOP", 1.1)
    assert "hysteresis" in mg.find_gap(recording).names


def test_a_core_saturates_softly(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On one side of one axis, where a power of the field explains more than what lies beyond a level does."""
    seed = 251224500127924
    hidden = Scenario("x", "real", "nexus5_augmented_reality", seed, (("saturation", 1.0),))
    recording = generate(hidden, mg.read(shared_data / "nexus5_augmented_reality.mcap")).recording
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
    hidden = Scenario("x", "real", "nexus5_calibration_d1", 276434416037446, (("temperature-hard-iron", 1.0),))
    gap = mg.find_gap(generate(hidden, mg.read(shared_data / "nexus5_calibration_d1.mcap")).recording)
    drift = next(e for e in gap.effects if e.name == "hard-iron-drift")
    assert "temperature-hard-iron" in drift.ambiguous_with


def test_what_is_left_of_a_delay_for_its_form_may_be_the_effect(shared_data: Path) -> None:
    """A plate and the phone's delay explain most of a hysteresis, and the rest of it is little beside the delay."""
    hidden = Scenario("x", "real", "nexus5_calibration_d1", 158700465263294, (("hysteresis", 1.0),))
    gap = mg.find_gap(generate(hidden, mg.read(shared_data / "nexus5_calibration_d1.mcap")).recording)
    assert "hysteresis" not in gap.names
    late = next(e for e in gap.effects if e.name == "timing")
    assert "hysteresis" in late.ambiguous_with


def test_a_matrix_of_eddy_currents_becomes_the_delay_once_the_loop_is_known(
    shared_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before a hysteresis is in the model, a matrix explains more of it, and of the delay, than any other name."""
    hidden = Scenario("x", "real", "broad_32", 109766625713881, (("hysteresis", 1.0),))
    recording = generate(
        hidden, mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap").between(41.5, 92)
    ).recording
    names = mg.find_gap(recording).names
    assert {"hysteresis", "timing"} <= set(names)
    assert "eddy-plane" not in names
    monkeypatch.setattr("magyc_gtsam.gap.search.with_exchange", lambda *_: None)
    assert "timing" not in mg.find_gap(recording).names


def test_what_a_loop_leaves_for_its_form_is_no_plate(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fifth of what the loop explained at the noise without it, a tenth of what it explains with it."""
    hidden = Scenario("x", "real", "nexus5_augmented_reality", 106057416373883, (("hysteresis", 1.0),))
    recording = generate(hidden, mg.read(shared_data / "nexus5_augmented_reality.mcap")).recording
    gap = mg.find_gap(recording)
    assert gap.names == ("hysteresis",)
    assert gap.effects[0].ambiguous_with == ("eddy-plane", "timing")
    exact = replace(TERMS["hysteresis"], rough=False)
    monkeypatch.setattr("magyc_gtsam.gap.naming.TERMS", {**TERMS, "hysteresis": exact})
    monkeypatch.setattr("magyc_gtsam.gap.steps.TERMS", {**TERMS, "hysteresis": exact})
    assert "eddy-plane" in mg.find_gap(recording).names


def test_coarse_steps_of_a_phone_are_no_hold(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They repeat for one to five rows where it is turned slowly; a clock would hold one or two at a time."""
    hidden = Scenario("x", "real", "nexus5_calibration_d1", 266710381606992, (("quantisation", 1.0),))
    recording = generate(hidden, mg.read(shared_data / "nexus5_calibration_d1.mcap")).recording
    names = mg.find_gap(recording).names
    assert "quantisation" in names
    assert "sample-hold" not in names
    monkeypatch.setattr("magyc_gtsam.gap.noise_effects._BY_CHANCE", 10.0)
    assert "sample-hold" in mg.find_gap(recording).names


def test_a_magnetometer_that_holds_two_rows_is_held(shared_data: Path) -> None:
    """In BROAD, always two: stamped by the rows, its samples would seem 0.7 ms later than they are."""
    held = sample_hold(mg.read(shared_data / "broad_06_fast_rotation.mcap").between(38, 60))
    assert held.significant
    assert held.statistic == pytest.approx(0.3, abs=0.02)


def test_a_magnet_that_comes_and_goes(shared_data: Path) -> None:
    """Attached by hand and taken off again; its field is (−6, −1, 58) µT."""
    gap = mg.find_gap(mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap"))
    on, off = sorted((e for e in gap.effects if e.name == "hard-iron-step"), key=lambda e: e.setting["time"])
    assert on.setting["time"] == pytest.approx(38, abs=1)
    assert off.setting["time"] == pytest.approx(95, abs=1)
    np.testing.assert_allclose(on.value, [-6, -1, 58], atol=3)
    np.testing.assert_allclose(off.value, [6, 1, -58], atol=3)


def test_the_first_model_beside_a_magnet_does_not_hang_on_rounding(shared_data: Path) -> None:
    """The fit of the twelve parameters at the sensors' own noise ends anywhere there."""
    recording = mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap")
    hard_iron = []
    for scale in (1.0, 1.0 + 1e-9):
        scaled = replace(recording, magnetic_field=recording.magnetic_field * scale)
        hard_iron.append(base_model(scaled, None, short_term_noise(scaled)).model.parameters[6:9] * 1e6)
    np.testing.assert_allclose(*hard_iron, atol=0.1)
    np.testing.assert_allclose(hard_iron[0], [-5, 3, 49], atol=1)


@pytest.mark.parametrize(
    ("name", "start", "end"),
    [
        ("nexus5_augmented_reality.mcap", None, None),
        ("nexus5_calibration_d1.mcap", None, None),
        ("broad_32_attached_magnet_1cm.mcap", 41.5, 92),
    ],
)
def test_a_step_and_exchanged_axes_that_were_put_in(
    shared_data: Path, name: str, start: float | None, end: float | None
) -> None:
    """A step of 6 µT, and the gyroscope's axes in another order with other signs."""
    recording = mg.read(shared_data / name).between(start, end)
    stepped, (truth,) = inject(recording, mg.calibrate(recording), [("hard-iron-step", 10.0)], seed=7)
    found = [e for e in mg.find_gap(stepped).effects if e.name == "hard-iron-step"]
    assert len(found) == 1
    since = found[0].setting["time"] - recording.time[0]
    assert since == pytest.approx(truth.drawn["time"], abs=1.0)
    np.testing.assert_allclose(found[0].value, 6.0 * truth.drawn["direction"], atol=1.0)
    turned = mg.find_gap(replace(recording, angular_rate=recording.angular_rate @ TURNED.T))
    assert turned.effects[0].name == "axis-order"
    np.testing.assert_array_equal(turned.effects[0].value.reshape(3, 3), TURNED.T)


def test_the_axes_of_breakout_boards_and_a_delay_put_in(shared_data: Path) -> None:
    """Their gyroscope is cut off at 250 °/s twice; as they are they have no delay that shows."""
    recording = mg.read(shared_data / "breakout_boards_hand_rotation.mcap")
    gap = mg.find_gap(recording)
    assert gap.effects[0].name == "axis-order"
    np.testing.assert_array_equal(gap.effects[0].value.reshape(3, 3), np.diag([-1.0, -1.0, 1.0]))
    assert [fault for fault in gap.diagnostics["left_out"] if "axis x of the gyroscope cut off" in fault]
    assert "Left out: angular_rate: axis x" in render_gap(recording, gap)
    assert "timing" not in [e.name for e in gap.effects]
    right = replace(recording, angular_rate=recording.angular_rate * [-1.0, -1.0, 1.0])
    late, _ = inject(right, mg.calibrate(right), [("timing", 1.5)], seed=7)
    found = next(e for e in mg.find_gap(late).effects if e.name == "timing")
    assert found.value[0] == pytest.approx(60, abs=8)
