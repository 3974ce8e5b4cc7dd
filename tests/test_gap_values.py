"""The gap workflow's values: of many with little in them, of coarse steps, of several plates beside a delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.factors.effects.changes import per_axis
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.gap.effects.term import measured
from magyc_gtsam.gap.model.refit import spread
from magyc_gtsam.gap.samples.coarse import rounding, truncation
from magyc_gtsam.simulation import HARD_IRON, MILLIGAUSS
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.signals import record


def test_what_rounding_adds_on_average() -> None:
    """Against 200,000 roundings, for noise of a tenth to a half of the step."""
    random = np.random.default_rng(0)
    step = 6e-6
    reading = np.linspace(-step, step, 9)
    for noise in (0.1 * step, 0.2 * step, 0.5 * step):
        noisy = reading + noise * random.standard_normal((200_000, len(reading)))
        measured = (step * np.round(noisy / step)).mean(axis=0) - reading
        np.testing.assert_allclose(rounding(reading, step, noise), measured, atol=5e-3 * step)
    assert np.abs(rounding(reading, step, step)).max() < 1e-6 * step


def test_what_truncation_towards_zero_adds_on_average() -> None:
    """Against 200,000 truncations, where the sign changes and far from there."""
    random = np.random.default_rng(0)
    step = 6e-6
    reading = np.concatenate([np.linspace(-2.5, 2.5, 21), [-40.3, 35.9]]) * step
    for noise in (0.1 * step, 0.3 * step, step):
        noisy = reading + noise * random.standard_normal((200_000, len(reading)))
        measured = (step * np.trunc(noisy / step)).mean(axis=0) - reading
        np.testing.assert_allclose(truncation(reading, step, noise), measured, atol=0.01 * step)


@pytest.mark.parametrize(("motion", "step"), [("wide", 0.3e-6), ("tiny", 2e-6)])
def test_truncated_readings_are_told_from_rounded_ones(motion: str, step: float) -> None:
    """Steps finer than the noise, whose rounding does no harm, and steps of five times the noise."""
    simulation = mg.simulate(motion, 300, seed=5, magnetometer_noise=0.4e-6)
    reading = simulation.recording.magnetic_field / step
    cut, near = (
        mg.find_gap(replace(simulation.recording, magnetic_field=step * values))
        for values in (np.trunc(reading), np.round(reading))
    )
    assert [effect.name for effect in cut.effects] == ["quantisation"]
    assert {effect.name for effect in near.effects} <= {"quantisation"}
    for gap in (cut, near):
        assert gap.calibration.trusted
        assert gap.calibration.covariance is not None
        error = gap.calibration.hard_iron - simulation.truth.hard_iron
        assert (np.abs(error) < 3.5 * np.sqrt(np.diag(gap.calibration.covariance)[6:9])).all()
    assert "truncated towards zero" in cut.sentence
    assert "truncated" not in near.sentence


@pytest.mark.parametrize(("motion", "seed"), [("wide", 1), ("moderate", 2)])
def test_coarse_steps_bend_no_other_name(motion: str, seed: int) -> None:
    """Steps of six times the noise."""
    coarse = mg.find_gap(mg.simulate(motion, 120, seed=seed, effects=[("quantisation", 2.0)]).recording)
    assert [effect.name for effect in coarse.effects] == ["quantisation"]


def test_a_misalignment_beside_coarse_steps_is_found_and_of_its_size() -> None:
    """And the steps, of six times the noise, are no saturation."""
    simulation = mg.simulate("wide", 200, seed=2, effects=["misalignment", ("quantisation", 2.0)])
    candidates = ["misalignment", "quantisation", "saturation", "cubic", "gyro-scale", "timing"]
    both = mg.find_gap(simulation.recording, candidates=candidates)
    assert sorted(effect.name for effect in both.effects) == ["misalignment", "quantisation"]
    misaligned = next(effect for effect in both.effects if effect.name == "misalignment")
    assert np.linalg.norm(misaligned.value) == pytest.approx(1e3 * np.deg2rad(2.6), rel=0.1)
    assert min(both.probabilities["misalignment"], both.probabilities["quantisation"]) > 0.9
    assert both.probabilities.get("saturation", 0.0) < 0.3


def test_the_spread_of_values_is_found() -> None:
    """Of forty values with a deviation of their own, measured with different sigmas, one hardly at all."""
    random = np.random.default_rng(1)
    prior, true = 0.02, 0.003
    sigma = np.geomspace(0.0005, 0.5, 40)
    value = true * random.standard_normal(40) + sigma * random.standard_normal(40)
    kept = prior**2 / (prior**2 + sigma**2)  # with the prior as a part of the estimate
    found = spread(kept * value, np.diag(kept * sigma**2), prior)
    assert 0.6 * true < found < 1.6 * true
    none = sigma * random.standard_normal(40)
    assert spread(kept * none, np.diag(kept * sigma**2), prior) < 0.3 * true


def test_a_weak_scale_is_corrected_to_the_good() -> None:
    """On a motion that leaves one direction of the matrix weak."""
    gains = []
    for seed in range(1, 4):
        simulation = mg.simulate("multi", 300, seed=seed, effects=["gyro-scale"])
        gap = mg.find_gap(simulation.recording, candidates=["gyro-scale", "gyro-quadratic", "misalignment"])
        assert [e.name for e in gap.effects] in (["gyro-scale"], ["gyro-quadratic"]), gap.sentence
        truth = simulation.truth.hard_iron
        gains.append([np.linalg.norm(c.hard_iron - truth) for c in (gap.base, gap.calibration)])
    before, after = np.sqrt(np.mean(np.square(gains), axis=0))
    assert after < 0.85 * before


def test_several_plates_beside_a_delay() -> None:
    """Any matrix of eddy currents is a delay and one of trace zero."""
    random = np.random.default_rng(2)
    signals = Signals(np.arange(50.0), field_rate=random.standard_normal((3, 50)))
    whole = -per_axis(signals.need("field_rate"))
    uneven = FORMS["eddy-plane"].columns(signals, {"uneven": 1.0})
    late = FORMS["timing"].columns(signals, {})
    value = random.standard_normal((3, 3))
    delay = np.trace(value) / 3
    beyond = (value - delay * np.eye(3)).T.ravel()[:8]  # column by column
    parts = np.tensordot(beyond, uneven, 1) + delay * late[0]
    np.testing.assert_allclose(parts, np.tensordot(value.T.ravel(), whole, 1), atol=1e-12)
    assert np.linalg.matrix_rank(np.concatenate([uneven, late]).reshape(9, -1)) == 9


def test_a_fast_hand_finds_plates_beside_a_delay() -> None:
    """As in a real instrument turned by hand at some rad/s: late by 10 ms, and 2 ms from x to z and from z to x."""
    time = np.arange(0, 40, 0.002)
    random = np.random.default_rng(5)
    rate = np.stack([3 * np.sin(w * time + p) for w, p in ((1.3, 0.0), (1.7, 1.0), (0.9, 2.0))], axis=1)
    world = np.array([20e-6, 0.0, 40e-6])
    body = [world]
    for back in Rotation.from_rotvec(-0.001 * (rate[1:] + rate[:-1])).as_matrix():
        body.append(back @ body[-1])
    late = np.stack([np.interp(time - 0.01, time, axis) for axis in np.transpose(body)], axis=1)
    plates = np.zeros((3, 3))
    plates[0, 2] = plates[2, 0] = 2e-3
    field = (late - np.gradient(late, time, axis=0) @ plates.T)[::10]
    field += 0.1e-6 * random.standard_normal(field.shape)
    time, rate = time[::10], rate[::10] + 2e-3 * random.standard_normal(field.shape)
    inside = slice(5, -5)  # before the first sample nothing is known of the field
    candidates = ["timing", "eddy-plane", "gyro-scale", "misalignment"]
    gap = mg.find_gap(mg.Recording(time[inside], field[inside], rate[inside]), candidates=candidates)
    found = {effect.name: effect for effect in gap.effects}
    assert found.keys() == {"timing", "eddy-plane"}
    assert found["timing"].value[0] == pytest.approx(10, abs=0.5)
    expected = np.zeros(8)
    expected[[2, 6]] = 2.0
    np.testing.assert_allclose(found["eddy-plane"].value, expected, atol=0.3)


def test_a_thick_plate_whose_currents_decay_slowly() -> None:
    """A third of the field across a plate, late by 0.5 s in a study of faults that shares no code with the model."""
    fault = FAULTS["eddy-currents"]
    log = record("low", 35011, fault, fault.strong, "eddy-currents")
    gap = mg.find_gap(log.recording("plate"), candidates=["eddy-plane", "hysteresis", "timing", "cubic"])
    assert [effect.name for effect in gap.effects] == ["eddy-plane"], gap.sentence
    assert "and decay in about" in gap.effects[0].sentence
    found = gap.calibration
    off = np.abs(found.hard_iron - HARD_IRON) / np.sqrt(np.diag(found.covariance)[6:9])
    assert off.max() < 3  # 5.8 with currents that follow the change at once


def test_currents_that_decay_are_those_of_a_change_before() -> None:
    """A field that changes evenly since long ago drives the same currents with a decay as without."""
    time = np.arange(0.0, 5.0, 0.1)
    changing = Signals(time, field_rate=np.tile([[1.0], [2.0], [-1.0]], (1, 50)))
    jumping = Signals(time, field_rate=np.where(time < 2.0, 0.0, [[1.0], [2.0], [-1.0]]))
    plate, slow = {"x": 0.0, "y": 1.0, "z": 0.0}, {"x": 0.0, "y": 1.0, "z": 0.0, "lag": 0.5}
    columns = FORMS["eddy-plane"].columns
    np.testing.assert_allclose(columns(changing, slow), columns(changing, plate), atol=1e-12)
    late = columns(jumping, slow)[0, 0, time >= 2.0]
    np.testing.assert_allclose(late[5:], -2 * (1 - np.exp(-(time[25:] - 1.95) / 0.5)), atol=0.02)


def test_a_strong_step_stays_beside_weak_ones() -> None:
    """A name is not taken back because a fifth of it is wanted once more."""
    recording = mg.simulate("wide", 120, seed=4).recording
    since = recording.time - recording.time[0]
    field = recording.magnetic_field.copy()
    for start, size in ((33, 2.5), (83, -12.0), (133, 2.5), (173, -2.5)):
        field[since > start] += size * 10 * MILLIGAUSS * np.array([1.0, 0.0, 0.0])
    changes = ["hard-iron-step", "hard-iron-drift", "local-anomaly"]
    gap = mg.find_gap(replace(recording, magnetic_field=field), candidates=changes)
    strong = max(
        (e for e in gap.effects if e.name == "hard-iron-step"), key=lambda e: abs(e.value[0]), default=None
    )
    assert strong is not None, gap.sentence
    assert strong.setting["time"] - recording.time[0] == pytest.approx(83, abs=2)
    assert strong.value[0] == pytest.approx(-12.0, abs=2.0)


def test_a_value_per_a_small_unit_keeps_its_digits() -> None:
    assert measured(-2.8e-6, 4.6e-7) == "-2.8e-06 ± 4.6e-07"
    assert measured(0.0511, 0.005) == "0.051 ± 0.005"


@pytest.mark.parametrize("seed", [2, 3])
def test_a_large_scale_of_the_gyroscope_is_estimated(seed: int) -> None:
    """Of 15 %, as of a wrong range: more than data sheets allow, and than a prior for them would let it reach."""
    simulation = mg.simulate("multi", 150, seed=seed, effects=[("gyro-scale", 7.5)])
    gap = mg.find_gap(simulation.recording, candidates=["gyro-scale", "gyro-quadratic", "misalignment", "timing"])
    (scale,) = gap.effects
    assert scale.name == "gyro-scale"
    matrix = simulation.effects[0].drawn["matrix"]
    true = np.concatenate([np.diag(matrix), matrix[[0, 0, 1], [1, 2, 2]]])
    assert np.abs(scale.value[:2] / 1e3 - true[:2]).max() < 0.03
    np.testing.assert_allclose(scale.value[2:] / 1e3, true[2:], atol=0.015)
    assert gap.verdict == "closed"
