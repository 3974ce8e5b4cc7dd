"""What is known of θ beforehand: Jacobians, and the chain that takes it into account."""

import numpy as np
import pytest

from magyc_gtsam.factors.chain.chain_values import SKEW, SensorNoise, iron_matrix
from magyc_gtsam.factors.chain.facts import IronFact, LinearFact, StrengthFact, quadratic
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rotations import exponential_matrices, right_jacobian
from magyc_gtsam.simulation import simulate

UNIT = np.concatenate([np.full(9, 1e-6), np.full(3, 1e-3), [1e-3], np.full(3, 1e-2)])
THETA = np.concatenate([50e-6 * np.array([1.1, 0.1, -0.05, 0.9, 0.1, 1.2]), np.full(3, 4e-6), np.full(7, 2e-3)])
UNITS = np.r_[np.full(6, 2e-3), np.full(3, 1e-6)]
RNG = np.random.default_rng(3)
FACTS = [
    LinearFact(np.r_[6:9], np.array([1e-6, -2e-6, 5e-6]), RNG.normal(size=(3, 3)) * 1e6),
    LinearFact(np.r_[13:16], np.zeros(3), np.eye(3) / np.radians(1)),
    StrengthFact(51e-6, 150e-9),
    IronFact(np.array([1.0, 0.05, 0, 1.02, 0, 0.98]), np.zeros(3), RNG.normal(size=(7, 9)) / UNITS),
]


@pytest.mark.parametrize("fact", FACTS, ids=lambda fact: type(fact).__name__)
def test_the_jacobian_of_a_fact_is_its_numeric_derivative(fact):
    _, jacobian = fact.residual(THETA)
    for unit, column in zip(np.diag(UNIT) * 1e-3, jacobian.T, strict=True):
        numeric = (fact.residual(THETA + unit)[0] - fact.residual(THETA - unit)[0]) / (2 * unit.sum())
        np.testing.assert_allclose(numeric, column, rtol=1e-5, atol=1e-6 * np.abs(jacobian).max())


def test_the_scale_of_the_soft_iron_costs_its_shape_nothing():
    scaled = THETA.copy()
    scaled[:6] *= 1.3
    np.testing.assert_allclose(FACTS[3].residual(scaled)[0], FACTS[3].residual(THETA)[0], atol=1e-6)
    assert StrengthFact(50e-6, 1e-7).residual(scaled)[0] > StrengthFact(50e-6, 1e-7).residual(THETA)[0] + 100


def test_the_right_jacobian_carries_a_small_turn_through_a_large_one():
    rng = np.random.default_rng(0)
    for size in (1e-5, 1e-2, 1.0):
        vector, step = size * rng.normal(size=3), 1e-7 * rng.normal(size=3)
        turn, moved, small = (
            exponential_matrices(v[:, None])[:, :, 0]
            for v in (vector, vector + step, right_jacobian(vector) @ step)
        )
        np.testing.assert_allclose(moved, turn @ small, atol=1e-13)


def test_the_chain_adds_the_facts_to_its_normal_equations():
    recording = simulate("wide", duration=30, seed=4).recording
    windows = Preintegration(*recording.magnetometer, *recording.gyroscope).integrate()
    plain, informed = (FieldChain(windows, SensorNoise(1e-6, 5e-3), facts=facts) for facts in ((), tuple(FACTS)))
    state = plain.start(THETA)
    before, after = (chain.eliminate(state, chain.unweighted()) for chain in (plain, informed))
    cost, gradient, information = quadratic(FACTS, THETA)
    assert after.cost - before.cost == pytest.approx(cost)
    np.testing.assert_allclose(after.gradient, before.gradient + gradient, rtol=1e-9)
    np.testing.assert_allclose(after.information, before.information + information, rtol=1e-9)


def test_a_skew_turns_the_gyroscopes_axes_into_the_magnetometers():
    turned = THETA.copy()
    turned[SKEW] = 0.01, -0.02, 0.03
    turn = exponential_matrices(turned[SKEW, None])[:, :, 0]
    np.testing.assert_allclose(iron_matrix(turned), iron_matrix(THETA[:13]) @ turn)
