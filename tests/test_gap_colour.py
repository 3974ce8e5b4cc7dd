"""Coloured noise is the noise of every set of effects, once it is more probable than any effect in its place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario, seed_of
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.posterior import UNKNOWN
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.colour import Autoregression, ColouredNoise
from magyc_gtsam.gap.model.problem import Problem
from magyc_gtsam.gap.model.refit import refit
from magyc_gtsam.gap.model.twin import Twin


def _turning(n: int) -> Array:
    angle = 2 * np.pi * np.arange(n) / 120
    return np.array([np.cos(angle), np.sin(angle), np.ones(n)]) / np.sqrt(2)


def _innovations(n: int, along: float, across: float, seed: int = 0) -> tuple[Array, Array]:
    """Innovations (3, n) with a correlation from each to the next along a direction that turns, and one across it."""
    random, direction = np.random.default_rng(seed), _turning(n)
    slow = lfilter([1.0], [1.0, -along], random.standard_normal(n))
    fast = lfilter([1.0], [1.0, -across], random.standard_normal((3, n)), axis=1)
    return direction * slow + fast - direction * (direction * fast).sum(axis=0), direction


def test_what_is_left_is_white_along_and_across_the_field() -> None:
    innovation, direction = _innovations(2000, 0.9, 0.3)
    noise = ColouredNoise.of(innovation, direction)
    left = noise.whiten(innovation)
    along = (direction * left).sum(axis=0)
    across = left - direction * along
    assert along.var() == pytest.approx(1.0, abs=0.1)
    assert (across**2).sum() == pytest.approx(2 * 2000, rel=1e-3)
    assert abs(np.corrcoef(along[1:], along[:-1])[0, 1]) < 0.05
    assert abs(np.vdot(across[:, 1:], across[:, :-1]) / (across**2).sum()) < 0.05
    assert noise.nats(innovation) > 100
    fast, _ = _innovations(2000, 0.5, 0.5)
    common = ColouredNoise.of(fast, direction)
    assert common.along is common.across
    white = np.random.default_rng(1).standard_normal((3, 2000))
    assert ColouredNoise.of(white, direction).nats(white) < 0


@pytest.mark.parametrize(("along", "across", "common"), [(0.5, 0.5, True), (0.8, 0.4, False)])
def test_the_evidence_is_that_of_the_noise_as_a_density(along: float, across: float, common: bool) -> None:
    """Its log-likelihood is that of the covariance which the whitening has, less the penalty."""
    innovation, direction = _innovations(40, along, across)
    noise = ColouredNoise.of(innovation, direction)
    assert (noise.along is noise.across) == common
    matrix = noise.whiten(np.eye(120).reshape(120, 3, 40)).reshape(120, 120).T
    flat = innovation.ravel()
    np.testing.assert_allclose(matrix @ flat, noise.whiten(innovation).ravel(), atol=1e-12)
    log = 0.5 * (flat @ flat - flat @ matrix.T @ matrix @ flat) + np.linalg.slogdet(matrix)[1]
    parts = ((noise.along, 3),) if noise.along is noise.across else ((noise.along, 1), (noise.across, 2))
    penalty = sum(0.5 * len(part.polynomial) * np.log(count * 40) for part, count in parts)
    assert noise.nats(innovation) == pytest.approx(log - penalty)


def _coloured_problem(seed: int) -> tuple[Problem, Twin]:
    recording = mg.simulate("wide", 120, seed=seed, effects=("coloured-noise",)).recording
    twin = base_model(recording, None, short_term_noise(recording)).twin
    noise = ColouredNoise.of(twin.innovations(), twin.along_field)
    return replace(twin.problem, colour=noise), twin


def test_a_model_is_fitted_by_the_whitened_innovations() -> None:
    """Its cost, its regressors and its minimum are those of the whitened innovations."""
    problem, white = _coloured_problem(5)
    result = refit(problem, white.model, None)
    twin = result.twin
    assert result.converged
    np.testing.assert_allclose(twin.residual(), problem.colour.whiten(twin.innovations()))  # type: ignore[union-attr]
    assert twin.cost == pytest.approx(0.5 * (twin.residual() ** 2).sum())
    assert twin.cost < Twin.of(problem, white.model).cost
    sigma = np.sqrt(np.diag(result.covariance))
    for index in (7, 10):  # of hard iron and bias
        ends = []
        for side in (1, -1):
            parameters = twin.model.parameters.copy()
            parameters[index] += side * 0.1 * sigma[index]
            moved = Twin.of(problem, replace(twin.model, parameters=parameters), twin)
            ends.append(moved.residual().ravel())
        slope = (ends[0] - ends[1]) / (0.2 * sigma[index])
        column = twin.base_columns[index]
        assert np.linalg.norm(slope - column) < 0.02 * np.linalg.norm(column)


def test_the_order_is_that_of_the_noise() -> None:
    random = np.random.default_rng(2)
    rows = lfilter([1.0], [1.0, -1.2, 0.6], random.standard_normal((3, 3000)), axis=1)
    found = Autoregression.of(rows, 3)
    np.testing.assert_allclose(found.polynomial, [1.0, -1.2, 0.6], atol=0.05)
    assert found.level == pytest.approx(1.0, rel=0.03)
    assert found.nats(rows, 3) == pytest.approx(ColouredNoise.of(rows, _turning(3000)).nats(rows))


def test_an_effect_beside_coloured_noise_is_named() -> None:
    """By white noise the sets follow the noise, and the effect is in none of them."""
    effects = (("coloured-noise", 1.0), ("load-soft-iron", 1.5))
    recording = mg.simulate("wide", 240, seed=0, effects=effects, channels=("current",)).recording
    others = ("motor-current", "gain-drift", "soft-iron-step", "hard-iron-step", "timing")
    gap = mg.find_gap(recording, candidates=[name for name, _ in effects] + list(others))
    assert gap.verdict == "closed"
    assert {effect.name for effect in gap.effects} == {"coloured-noise", "load-soft-iron"}
    assert "in a varying field or correlated noise the correction does not improve" in gap.sentence


def test_what_is_in_no_catalogue_is_not_taken_for_coloured_noise() -> None:
    """A loose magnet leaves coloured innovations, too, but depends on the attitude, which explains more."""
    name = "foreign-wide-loose-magnet-x1-00"
    gap = mg.find_gap(
        generate(Scenario(name, "foreign", "wide", seed_of(name, 405), (("loose-magnet", 1.0),))).recording
    )
    assert gap.verdict == "unknown"
    assert gap.probabilities[UNKNOWN] > 0.95
    assert all(gap.probabilities.get(name, 0.0) < 0.5 for name in TERMS)


def test_an_effect_that_explains_nothing_beside_later_ones_is_left_out() -> None:
    """A drift stands for a scale that grows with the rate, until that is found; by itself it had 0.98."""
    name = "pair-moderate-gyro-quadratic+temperature-gyro-022"
    effects = (("gyro-quadratic", 1.0), ("temperature-gyro", 1.0))
    gap = mg.find_gap(generate(Scenario(name, "pair", "moderate", seed_of(name, 409), effects)).recording)
    assert set(gap.names) == {"gyro-quadratic", "temperature-gyro"}


@pytest.mark.parametrize(("motion", "seed"), [("wide", 43), ("moderate", 45)])
def test_an_axis_with_more_noise_is_no_effect(motion: str, seed: int) -> None:
    """Half as much again on z, as of many sensors, was an unknown effect with a probability of 1, or wrong samples."""
    recording = mg.simulate(motion, 600, seed=seed).recording
    # The seed is another one than that of the simulation, whose noise would be the same numbers some samples later.
    more = np.random.default_rng(9000 + seed).standard_normal((len(recording.time), 3)) * [0.0, 0.0, 1.1e-6]
    gap = mg.find_gap(replace(recording, magnetic_field=recording.magnetic_field + more))
    assert gap.names == ()
    assert gap.probabilities[UNKNOWN] < 0.5
    assert gap.calibration.trusted, gap.calibration.message
