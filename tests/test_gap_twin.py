"""The twin and the evidence beside it: equal to the field chain, to GTSAM's elimination, and to what they promise."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2, kstest

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import Candidates
from magyc_gtsam.gap.evidence.weighing import Weighed, weigh
from magyc_gtsam.gap.model.base import base_model, problem_of
from magyc_gtsam.gap.model.columns import Columns
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.projector import Projector
from magyc_gtsam.gap.model.refit import refit, with_term
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.outcome.worth import held_out_gain, interleaved
from magyc_gtsam.gap.samples.noise_effects import coloured_noise, quantisation, sample_hold, tone
from magyc_gtsam.gap.samples.wrong_samples import memory, spikes


@pytest.fixture(scope="module")
def twin() -> Twin:
    recording = mg.simulate("wide", duration=300, seed=5).recording
    return base_model(recording, None, short_term_noise(recording)).twin


def test_the_twins_likelihood_is_the_field_chains(twin: Twin) -> None:
    innovation = twin.residual()
    assert 0.5 * np.vdot(innovation, innovation) == pytest.approx(twin.reduced.cost, rel=1e-4)
    base = twin.base_columns
    information = twin.reduced.information[:12, :12]
    scale = np.sqrt(np.diag(information))
    np.testing.assert_allclose(
        base @ base.T / np.outer(scale, scale), information / np.outer(scale, scale), atol=1e-4
    )


def test_innovations_are_white_where_the_model_is_right(twin: Twin) -> None:
    innovation = twin.residual()
    assert memory(innovation) == 0
    assert kstest(innovation.ravel(), "norm").pvalue > 1e-3


@pytest.mark.parametrize("late", [0.0, 1e-4])
def test_an_integration_near_by_serves_for_another_bias_and_delay(twin: Twin, late: float) -> None:
    moved = twin.model.parameters.copy()
    moved[9:12] += 4e-4
    moved[12] += late
    model = replace(twin.model, parameters=moved)
    near, anew = Twin.of(twin.problem, model, twin), Twin.of(problem_of(twin.problem.recording), model)
    assert near._integrated is twin._integrated
    assert near.reduced.cost - twin.reduced.cost > 10
    assert near.reduced.cost == pytest.approx(anew.reduced.cost, abs=0.02)
    moved[9] += 2e-3
    assert Twin.of(twin.problem, replace(model, parameters=moved), twin)._integrated is not twin._integrated


def test_a_constant_error_of_the_rate_is_the_bias(twin: Twin) -> None:
    constant = np.eye(3)[:, :, None] * np.ones(len(twin.gyroscope.time))
    mine = twin.whiten(twin.on_gyroscope(constant))
    # The bias inside a window is to first order in the turn there.
    np.testing.assert_allclose(mine, twin.base_columns[9:12], atol=1e-4 * np.abs(mine).max())


def test_the_slow_form_of_a_rate_error_is_close_to_the_exact_one(twin: Twin) -> None:
    def profile(signals):  # type: ignore[no-untyped-def]
        return np.eye(3)[:, :, None] * signals.need("rate")

    exact, slow = twin.whiten(twin.of_profile(profile)), twin.whiten(twin.of_slow_profile(profile))
    assert np.linalg.norm(exact - slow) < 0.05 * np.linalg.norm(exact)


@pytest.mark.parametrize(
    "name", [k for k, form in FORMS.items() if form.side == "gyroscope" and "rate" in form.needs]
)
@pytest.mark.parametrize("size", [0.01, 0.9, -3.0, 100.0])
def test_a_gyroscope_term_of_any_size_has_a_finite_twin_or_is_refused(name: str, size: float) -> None:
    """A step of a fit may go anywhere; beyond what can be undone the rate ran away to values that are no numbers."""
    recording = mg.simulate("wide", duration=60, seed=5).recording
    base = base_model(recording, None, short_term_noise(recording)).twin
    columns = FORMS[name].columns(base.gyroscope, {})
    model = replace(base.model, terms=(Active(name, {}, np.full(len(columns), size)),))
    try:
        twin = Twin.of(base.problem, model)
    except mg.MagycError as refused:
        assert name in str(refused)  # noqa: PT017 - both ways are right
        return
    assert np.isfinite(twin.residual()).all()
    assert np.isfinite(twin.gyroscope.need("rate")).all()


def test_eliminating_the_candidate_last_in_gtsam_gives_the_same_statistic(twin: Twin) -> None:
    """The whole linear graph, every direction a variable; the candidate's conditional is [R, d]."""
    chain, reduced, n = twin.chain, twin.reduced, twin.n
    columns = twin.columns("motor-current", {}) if "current" in twin.windows.channels else None
    assert columns is None  # this recording has no such channel; a made-up one does
    profile = np.sin(twin.time / 7.0)
    columns = Columns(np.eye(3)[:, :, None] * profile * 1e-6, None)
    free = np.flatnonzero(twin.model.free)
    graph = gtsam.GaussianFactorGraph()
    residuals = chain.residuals(twin.state)
    base, value = gtsam.symbol("b", 0), gtsam.symbol("v", 0)
    unit = 1 / np.sqrt(np.diag(reduced.information)[free])
    model = gtsam.noiseModel.Unit.Create(3)
    on_bias = np.zeros((n - 1, 3, len(free)))
    turned = -np.cross(twin.state.direction.T[:-1, None], chain.windows.lever.transpose(2, 1, 0))
    on_bias[:, :, 9:12] = turned.transpose(0, 2, 1) * chain.link_scale[:, None, None]
    for k in range(n):
        graph.add(
            gtsam.JacobianFactor(
                *(gtsam.symbol("x", k), reduced.on_direction[:, :, k]),
                *(base, reduced.on_parameters[free, :, k].T * unit),
                *(value, (columns.window[:, :, k] * chain.window_scale[k]).T),
                -residuals.window[:, k] * chain.window_scale[k],
                model,
            )
        )
    for k in range(n - 1):
        s = chain.link_scale[k]
        graph.add(
            gtsam.JacobianFactor(
                *(gtsam.symbol("x", k), -reduced.basis[:, :, k] * s),
                *(gtsam.symbol("x", k + 1), reduced.basis[:, :, k + 1] * s),
                *(base, on_bias[k] * unit),
                -residuals.link[:, k] * s,
                model,
            )
        )
    ordering = gtsam.Ordering()
    for k in range(n):
        ordering.push_back(gtsam.symbol("x", k))
    ordering.push_back(base)
    ordering.push_back(value)
    last = graph.eliminateSequential(ordering).at(n + 1)
    rows = twin.whiten(columns)
    seen = Beside.of_model(twin).see(rows, np.zeros(len(rows)))
    value = np.linalg.solve(rows @ rows.T - seen.reach @ seen.reach.T, seen.score)
    assert last.d() @ last.d() == pytest.approx(seen.score @ value, rel=2e-3)
    np.testing.assert_allclose(np.linalg.solve(last.R(), last.d()), -value, rtol=2e-2, atol=1e-3)


def weighed(twin: Twin, name: str) -> Weighed:
    return weigh(Candidates.at(twin, name, [{}]), Beside.of_model(twin))[name]


def test_the_estimate_beside_the_model_is_what_the_refit_finds() -> None:
    simulation = mg.simulate("wide", duration=300, seed=6, delay=0.02)
    short_term = short_term_noise(simulation.recording)
    base = base_model(simulation.recording, None, short_term)
    promised = float(weighed(base.twin, "timing").estimate[0][0]) * TERMS["timing"].matters
    found = refit(base.twin.problem, with_term(base.model, Active("timing", {}, np.zeros(1))), short_term)
    value, covariance = found.value_of(0)
    assert value[0] == pytest.approx(0.02, abs=4 * np.sqrt(covariance[0, 0]))
    assert value[0] == pytest.approx(promised, abs=2e-3)


def test_the_gyroscopes_noise_pulls_no_scale() -> None:
    """Without its expected score, a scale on a motion of small tilt would be named at nine sigmas."""
    statistics = []
    for seed in range(6):
        recording = mg.simulate("moderate", duration=300, seed=seed).recording
        twin = base_model(recording, None, short_term_noise(recording)).twin
        statistics.append(weighed(twin, "gyro-scale").statistic)
    assert np.mean(statistics) < 11  # of χ² with 6 degrees of freedom
    assert max(statistics) < chi2.isf(1e-4, 6)


def test_columns_are_derivatives_of_the_innovations(twin: Twin) -> None:
    """A rate error put into the data moves the innovations by its column."""
    size = np.array([0.0, 0.0, 2e-3, 0.0, 0.0, 0.0])
    error = np.tensordot(size, FORMS["gyro-scale"].columns(twin.gyroscope, {}), axes=1)
    recording = twin.problem.recording
    assert recording.angular_rate is not None
    moved = replace(recording, angular_rate=recording.angular_rate + error.T)
    other = Twin.of(problem_of(moved), twin.model)
    base = twin.base_columns
    change = Projector(base)((other.residual() - twin.residual()).reshape(1, -1))[0]
    column = Projector(base)(size[None] @ twin.whiten(twin.columns("gyro-scale", {})))[0]
    # The data have more of it, the residual is model less data.
    assert np.dot(change, -column) / np.dot(column, column) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("name", "setting", "value"),
    [
        ("saturation", {"level": 38e-6}, [0.7]),
        ("saturation", {"level": 38e-6, "fall": 4e-6}, [0.7]),
        ("saturation", {"level": 30e-6, "fall": 8e-6}, [0.4]),
        ("cubic", {}, [2e-6, -1e-6, 3e-6]),
    ],
)
def test_a_reading_that_bends_is_linearised_as_it_is_bent(
    twin: Twin, name: str, setting: dict[str, float], value: list[float]
) -> None:
    """The slope of the cost over the iron, with the directions at their best for each iron."""
    bent = with_term(twin.model, Active(name, setting, np.array(value)))
    at = Twin.of(twin.problem, bent)
    slope = at.base_columns @ at.residual().ravel()
    for place in (0, 2, 5, 6, 7, 8):
        step = 1e-3 if place < 6 else 1e-8
        step *= abs(bent.parameters[0]) if place < 6 else 1.0
        costs = []
        for sign in (1, -1):
            moved = bent.parameters.copy()
            moved[place] += sign * step
            costs.append(Twin.of(twin.problem, replace(bent, parameters=moved)).reduced.cost)
        assert slope[place] == pytest.approx(
            (costs[0] - costs[1]) / (2 * step), rel=0.03, abs=0.01 * abs(slope).max()
        )


def test_what_the_iron_had_followed_is_refitted() -> None:
    """On level turns a bent response and the hard iron trade places over several µT, where no straight step leads."""
    moved = []
    for seed in range(1, 4):
        hidden = Scenario("x", "pair", "moderate", seed, (("hard-iron-drift", 2.0), ("cubic", 2.0)))
        recording = generate(hidden).recording
        short_term = short_term_noise(recording)
        base = base_model(recording, None, short_term)
        drift = Active("hard-iron-drift", {"order": 9.0, "start": 0.2, "end": 599.45}, np.zeros(27))
        drifting = refit(base.twin.problem, with_term(base.model, drift), short_term)
        found = refit(base.twin.problem, with_term(drifting.model, Active("cubic", {}, np.zeros(3))), short_term)
        assert found.converged
        value, covariance = found.value_of(1)
        assert value @ np.linalg.solve(covariance, value) > chi2.isf(1e-8, 3)
        moved.append(np.linalg.norm(found.model.parameters[6:9] - drifting.model.parameters[6:9]))
    assert max(moved) > 3e-6


def test_held_out_data_veto_what_is_noise() -> None:
    random = np.random.default_rng(0)
    base, noise = random.standard_normal((12, 900)), random.standard_normal((20, 900))
    real = random.standard_normal((3, 900))
    residual = random.standard_normal(900) + 0.2 * real.sum(axis=0)
    block = interleaved(np.arange(300.0), 10.0)
    assert held_out_gain(base, noise, residual, block) < 0
    assert held_out_gain(base, real, residual, block) > 10


def test_noise_effects_are_found_and_told_apart() -> None:
    random = np.random.default_rng(1)
    white = random.standard_normal((3, 4000))
    time = np.arange(4000) / 10.0
    assert not tone(white, time, 1e-6, 8.0).significant
    assert not coloured_noise(white, 10.0, 1e-6, 8.0).significant
    assert not spikes(white, 1e-6, 8.0).significant
    found = tone(white + 0.3 * np.sin(2 * np.pi * 1.3 * time), time, 1e-6, 8.0)
    assert found.significant
    assert found.setting["frequency"] == pytest.approx(1.3, abs=0.01)
    coloured = white.copy()
    for k in range(1, 4000):
        coloured[:, k] += 0.6 * coloured[:, k - 1]
    assert coloured_noise(coloured / coloured.std(), 10.0, 1e-6, 8.0).significant
    wrong = white.copy()
    wrong[:, ::131] += 8.0
    assert spikes(wrong / wrong.std(), 1e-6, 8.0).setting["count"] == pytest.approx(31, abs=2)


def test_steps_and_holds_are_read_off_the_values() -> None:
    recording = mg.simulate("wide", duration=100, seed=1).recording
    assert not quantisation(recording, 1e-6).significant
    assert not sample_hold(recording).significant
    coarse = replace(
        recording, magnetic_field=np.round(recording.magnetic_field / 2e-6) * 2e-6, magnetic_field_fresh=None
    )
    assert quantisation(coarse, 1e-6).value[0] == pytest.approx(2e-6)
    assert not sample_hold(coarse).significant
    held = replace(
        recording, magnetic_field=np.repeat(recording.magnetic_field[::4], 4, axis=0), magnetic_field_fresh=None
    )
    assert sample_hold(held).setting["share"] == pytest.approx(0.75, abs=0.01)
