"""Single wrong samples are told from what a model misses: colour, coarse steps, noise that comes and goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.factors.chain.chain_values import DELAY, PARAMETERS, SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.samples.fine import NOISE_LIMIT, fine_innovations
from magyc_gtsam.gap.samples.wrong_samples import spikes

_SAMPLES = 4000


def model_of(truth: mg.Calibration) -> Model:
    """The model of a simulation, with the noise of its sensors."""
    assert truth.field_strength is not None
    assert truth.gyro_bias is not None
    soft_iron = vech(truth.soft_iron * truth.field_strength)
    noise = SensorNoise(truth.noise["magnetic_field"], truth.noise["angular_rate"])
    parameters = np.concatenate([soft_iron, truth.hard_iron, truth.gyro_bias, [0.0]])
    return Model(parameters, np.arange(PARAMETERS) < DELAY, noise)


def _white(random: np.random.Generator) -> Array:
    return random.standard_normal((3, _SAMPLES))


def _misfit(random: np.random.Generator) -> Array:
    """White noise beside a misfit fifteen times as large that changes over some tens of samples."""
    slow = lfilter([1.0], [1, -1.94, 0.9432], random.standard_normal((3, _SAMPLES)), axis=1)
    return np.asarray(15 * slow / slow.std() + _white(random))


def _modulated(random: np.random.Generator) -> Array:
    """Coloured, and five times as large at some times as at others."""
    size = np.exp(0.8 * np.sin(2 * np.pi * np.arange(_SAMPLES) / 600))
    return np.asarray(lfilter([1.0], [1, -0.8], size * _white(random), axis=1))


def _rounded(random: np.random.Generator) -> Array:
    """What rounding to three times the noise leaves of a reading that wanders."""
    true = 60 * np.sin(2 * np.pi * np.arange(_SAMPLES) / np.array([[900.0], [700.0], [1100.0]]))
    return np.asarray(3 * np.round((true + _white(random)) / 3) - true)


@pytest.mark.parametrize("misses", [_white, _misfit, _modulated, _rounded])
def test_what_a_model_misses_is_no_wrong_sample(misses: Callable[[np.random.Generator], Array]) -> None:
    scores = [spikes(misses(np.random.default_rng(seed)), 1.0, NOISE_LIMIT) for seed in range(12)]
    assert max(score.evidence for score in scores) < NOISE_LIMIT
    assert not any(score.significant for score in scores)


def test_wrong_samples_are_found_below_the_misfit() -> None:
    """At eight times the noise they are half of the misfit that hides them; those beside them stay."""
    random = np.random.default_rng(5)
    hidden = _misfit(random)
    hit = random.random(_SAMPLES) < 0.008
    hit[1:] |= hit[:-1] & (random.random(_SAMPLES - 1) < 0.3)
    way = random.standard_normal((3, _SAMPLES))
    wrong = 8 * hit * way / np.linalg.norm(way, axis=0)
    found = spikes(hidden + wrong, 1e-6, NOISE_LIMIT)
    assert found.significant
    assert found.rows is not None
    assert (found.rows & hit).sum() > 0.7 * hit.sum()  # of two beside each other only the larger is
    assert (found.rows & ~hit).sum() <= 4
    assert found.value[0] == pytest.approx(8e-6 / np.sqrt(3), rel=0.2)


def test_white_noise_keeps_its_own_residuals() -> None:
    random = np.random.default_rng(2)
    v = _white(random)
    v[:, ::200] += 8.0
    found = spikes(v, 1e-6, NOISE_LIMIT)
    assert found.rows is not None
    np.testing.assert_array_equal(np.flatnonzero(found.rows), np.arange(0, _SAMPLES, 200))


def test_wrong_samples_are_found_in_noise_of_two_levels() -> None:
    """As a phone's: half of its samples scatter more than twice as much as the others."""
    random = np.random.default_rng(4)
    v = _white(random) * np.where(random.random(_SAMPLES) < 0.5, 2.3, 1.0)
    assert not spikes(v, 1.0, NOISE_LIMIT).significant
    v[0, ::100] += 20.0
    found = spikes(v, 1.0, NOISE_LIMIT)
    assert found.significant
    assert found.rows is not None
    assert (found.rows & (np.arange(_SAMPLES) % 100 == 0)).sum() > 36
    assert found.rows.sum() < 44


def test_what_comes_in_stretches_is_a_disturbance() -> None:
    random = np.random.default_rng(3)
    v = _white(random)
    for start in range(100, _SAMPLES, 500):
        v[:, start : start + 12] *= 6.0
    found = spikes(v, 1.0, NOISE_LIMIT)
    assert found.evidence > 10 * NOISE_LIMIT
    assert not found.significant


def test_wrong_samples_are_seen_in_all_of_a_long_log() -> None:
    """However many samples there are, those at both ends are among the innovations."""
    simulation = mg.simulate("wide", 610, rate=100, seed=7)
    recording = simulation.recording
    field, wrong = recording.magnetic_field.copy(), [20, 30000, 60980]
    field[wrong] += 20e-6
    fine = fine_innovations(replace(recording, magnetic_field=field), model_of(simulation.truth))
    assert len(fine.time) == len(recording.time) - 1  # the first is predicted by none
    height = np.linalg.norm(fine.innovation, axis=0)
    np.testing.assert_array_equal(fine.time[height > 10], recording.time[wrong])


@pytest.mark.real
def test_a_real_misfit_neither_makes_nor_hides_them(shared_data: Path) -> None:
    """At 2.2 µT, eight times what single samples scatter, and beside steps of 0.84 µT."""
    log = mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap").between(41.5, 56)
    random = np.random.default_rng(1)
    hit = random.random(len(log.time)) < 0.01
    way = random.standard_normal((len(log.time), 3))
    wrong = 2.2e-6 * hit[:, None] * way / np.linalg.norm(way, axis=1, keepdims=True)
    fresh = log.magnetic_field_fresh
    candidates = ["sample-hold", "timing", "misalignment", "coloured-noise", "spikes", "tone", "quantisation"]
    spiky = mg.find_gap(replace(log, magnetic_field=log.magnetic_field + wrong), candidates=candidates)
    found = next(effect for effect in spiky.effects if effect.name == "spikes")
    assert 0.6 < found.setting["count"] / (hit & fresh).sum() < 1.1
    coarse = 0.84e-6 * np.round(log.magnetic_field / 0.84e-6)
    rounded = replace(log, magnetic_field=coarse, magnetic_field_fresh=None)
    stepped = mg.find_gap(rounded, candidates=candidates)
    assert "quantisation" in stepped.names
    assert "spikes" not in stepped.names


def test_a_step_of_a_coarse_resolution_is_not_a_wrong_sample() -> None:
    """Far from the next reading, the noise passes a step of 6 µT rarely, and then by a step."""
    hidden = Scenario("x", "single", "wide", 151496623810230, (("quantisation", 2.0),))
    recording, names = generate(hidden).recording, ["quantisation", "spikes"]
    assert mg.find_gap(recording, candidates=names).names == ("quantisation",)
    field = recording.magnetic_field.copy()
    field[100::200] += [36e-6, -24e-6, 18e-6]
    assert set(mg.find_gap(replace(recording, magnetic_field=field), candidates=names).names) == set(names)


@pytest.mark.parametrize("seed", [4, 5])
def test_large_ones_that_a_passed_object_resembled_are_taken_out_later(seed: int) -> None:
    """Beside the model of the first ones."""
    gap = mg.find_gap(mg.simulate("wide", 300, seed=seed, effects=[("spikes", 3.0)]).recording)
    assert (gap.verdict, gap.names) == ("closed", ("spikes",))
    assert gap.effects[0].setting["count"] == pytest.approx(30, abs=3)
