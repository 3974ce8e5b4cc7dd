"""The gap workflow on real recordings: what is known to be missing in them is found, and so is what is put in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam import metrics
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import real_scenarios
from magyc_gtsam.blindtest.scoring import IN_SET, RIGHT, beyond, judged
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.samples.noise_effects import sample_hold
from magyc_gtsam.report.gap_page import render_gap
from magyc_gtsam.simulation import inject

pytestmark = pytest.mark.real


def heading(recording: mg.Recording, calibration: mg.Calibration) -> float:
    """Degrees against the optical attitude."""
    known = np.isfinite(recording.attitude).all(axis=1) & recording.magnetic_field_fresh
    field = calibration.apply(recording)[known]
    return float(metrics.heading_deviation(field, recording.attitude[known]))


def test_a_late_magnetometer_is_found(shared_data: Path) -> None:
    """Without a delay in the model that the search begins with; of one instrument the same, slow and fast. Of another
    see the phone below.

    What the room leaves beside it is the field that varies, for which nothing else is named.
    """
    found = []
    for name, start, end, low, high, candidates in (
        ("broad_01_slow_rotation.mcap", 36, 86, 8.5, 12.5, None),
        ("broad_06_fast_rotation.mcap", 40, 70, 9.5, 11.5, ["timing", "eddy-plane", "gyro-scale", "misalignment"]),
    ):
        recording = mg.read(shared_data / name).between(start, end)
        gap = mg.find_gap(recording, candidates=candidates)
        effects = {effect.name: effect for effect in gap.effects}
        assert low < effects["timing"].value[0] < high
        assert gap.verdict == "closed"
        assert "field-variation" in effects
        assert heading(recording, gap.calibration) < heading(recording, gap.base)
        found.append(effects["timing"].value)
    np.testing.assert_allclose(*found, atol=1.0)


def test_a_small_step_and_a_tone_put_in_are_found_beside_the_room(shared_data: Path) -> None:
    """Of twice the published strength in 50 s, in a room that leaves more than it explains; the delay stays."""
    recording = mg.read(shared_data / "broad_01_slow_rotation.mcap").between(36, 86)
    stepped, (truth,) = inject(recording, mg.calibrate(recording), [("hard-iron-step", 2.0)], seed=5)
    hum = np.array([0.2e-6, -0.1e-6, 0.15e-6]) * np.sin(2 * np.pi * 14.5 * stepped.time)[:, None]
    stepped = replace(stepped, magnetic_field=stepped.magnetic_field + hum)
    candidates = ["tone", "timing", "hard-iron-step", "hard-iron-drift", "local-anomaly", "misalignment"]
    found = {e.name: e for e in mg.find_gap(stepped, candidates=candidates).effects}
    assert found["timing"].value[0] == pytest.approx(10.8, abs=0.5)
    step = found["hard-iron-step"]
    assert step.setting["time"] - recording.time[0] == pytest.approx(truth.drawn["time"], abs=1.0)
    np.testing.assert_allclose(step.value, 1.2 * truth.drawn["direction"], atol=0.2)
    assert found["tone"].setting["frequency"] == pytest.approx(14.5, abs=0.02)


def test_a_magnetometer_that_holds_two_rows_is_held(shared_data: Path) -> None:
    """In BROAD, always two: stamped by the rows, its samples would seem 0.7 ms later than they are."""
    held = sample_hold(mg.read(shared_data / "broad_06_fast_rotation.mcap").between(38, 60))
    assert held.significant
    assert held.statistic == pytest.approx(0.3, abs=0.02)


def test_a_magnet_that_comes_and_goes(shared_data: Path) -> None:
    """Attached by hand and taken off again; its field is (−6, −1, 58) µT."""
    recording = mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap").between(28, 105)
    gap = mg.find_gap(recording, candidates=["hard-iron-step", "hard-iron-drift", "local-anomaly", "timing"])
    steps = [e for e in gap.effects if e.name == "hard-iron-step"]
    for time, value in ((38.0, np.array([-6, -1, 58])), (95.0, np.array([6, 1, -58]))):
        near = [e for e in steps if abs(e.setting["time"] - time) < 1.5]  # the hand takes a second
        assert near
        np.testing.assert_allclose(np.sum([e.value for e in near], axis=0), value, atol=6)


def test_the_first_model_beside_a_magnet_does_not_hang_on_rounding(shared_data: Path) -> None:
    """The fit of the twelve parameters at the sensors' own noise ends anywhere there."""
    recording = mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap").between(30, 100)
    hard_iron = []
    for scale in (1.0, 1.0 + 1e-9):
        scaled = replace(recording, magnetic_field=recording.magnetic_field * scale)
        hard_iron.append(base_model(scaled, None, short_term_noise(scaled)).model.parameters[6:9] * 1e6)
    np.testing.assert_allclose(*hard_iron, atol=0.1)
    np.testing.assert_allclose(hard_iron[0], [-5.6, -1, 64.6], atol=1)


def test_an_effect_put_into_the_log_of_a_phone(shared_data: Path) -> None:
    """Of a channel that drifts, which a drift or the bias may resemble, beside what is missing in the log as it is."""
    phone = mg.read(shared_data / "nexus5_calibration_d1.mcap")
    own, *others = [s for s in real_scenarios([phone.name], 1, edition=26) if not s.cut]
    put_in = "temperature-hard-iron"
    candidates = ["timing", "eddy-plane", "gyro-scale", put_in, "temperature-gyro", "hard-iron-drift"]
    as_it_is = mg.find_gap(generate(own, phone).recording, candidates=candidates)
    assert as_it_is.verdict == "closed"
    effects = {effect.name: effect for effect in as_it_is.effects}
    assert {"timing", "field-variation"} <= effects.keys()
    assert 20 < effects["timing"].value[0] < 60
    assert effects["timing"].probability > 0.8
    already = {effect.name: frozenset(effect.ambiguous_with) for effect in as_it_is.effects}
    already |= {name: frozenset() for name in as_it_is.diagnostics["leftover"]}
    (scenario,) = (each for each in others if each.label == put_in)
    gap = mg.find_gap(generate(scenario, phone).recording, candidates=candidates)
    said = [(effect.name, effect.ambiguous_with) for effect in gap.effects]
    assert judged(scenario, gap.verdict, beyond(said, scenario.names, already)) in {RIGHT, IN_SET}, said


def test_the_axes_of_breakout_boards_and_a_delay_put_in(shared_data: Path) -> None:
    """Their gyroscope is cut off at 250 °/s twice; as they are they have no delay that shows."""
    recording = mg.read(shared_data / "breakout_boards_hand_rotation.mcap")
    candidates = ["axis-order", "misalignment", "timing"]
    gap = mg.find_gap(recording, candidates=candidates)
    assert gap.effects[0].name == "axis-order"
    np.testing.assert_array_equal(gap.effects[0].value.reshape(3, 3), np.diag([-1.0, -1.0, 1.0]))
    assert [fault for fault in gap.diagnostics["left_out"] if "axis x of the gyroscope cut off" in fault]
    assert "Left out: angular_rate: axis x" in render_gap(recording, gap)
    assert "timing" not in [e.name for e in gap.effects]
    right = replace(recording, angular_rate=recording.angular_rate * [-1.0, -1.0, 1.0])
    late, _ = inject(right, mg.calibrate(right), [("timing", 1.5)], seed=7)
    gap = mg.find_gap(late, candidates=candidates)
    found = next(e for e in gap.effects if e.name == "timing")
    assert found.value[0] == pytest.approx(60, abs=8)


def test_correlated_noise_beside_a_field_that_varies_is_no_drift(shared_data: Path) -> None:
    """Its size and time are estimated together with the variation of the place."""
    phone = mg.read(shared_data / "nexus5_augmented_reality.mcap")
    put_in = [s for s in real_scenarios([phone.name], 1, edition=402) if s.names == ("coloured-noise",)]
    generated = generate(put_in[0], phone)
    effects = {effect.name: effect for effect in mg.find_gap(generated.recording).effects}
    noise = effects["coloured-noise"]
    assert "hard-iron-drift" not in effects
    assert noise.value[0] == pytest.approx(1e6 * generated.applied[0].size, abs=noise.sigma[0])  # octaves
    assert 1 <= noise.setting["correlation_time"] <= 4
