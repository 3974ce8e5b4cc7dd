"""Residual (7), its exact compression, and the priors."""

import gtsam
import numpy as np
import pytest

from magyc_gtsam.factors import CompressedGyroDerivative, gyro_derivative_factor, unvech, vech
from magyc_gtsam.factors.gyro_derivative import derivative_samples, gyro_derivative_error
from magyc_gtsam.factors.priors import determinant_error, norm_error

KEYS = [gtsam.symbol(c, 0) for c in "ldb"]
RNG = np.random.default_rng(3)
L, D, B = np.array([1.1, 0.1, -0.2, 0.9, 0.3, 1.2]), RNG.normal(size=3), 0.1 * RNG.normal(size=3)


def samples(n, seed=0):
    return tuple(np.random.default_rng(seed).normal(size=(3, n, 3)))


def sum_over_samples(m, derivative, w, l, d, b):  # noqa: E741
    """Written as in the paper, one sample at a time."""
    c, total = unvech(l), 0.0
    for m_i, derivative_i, w_i in zip(m, derivative, w, strict=True):
        r = np.cross(w_i - b, c @ m_i - d) + c @ derivative_i
        total += r @ r
    return total


def values_at(l, d, b):  # noqa: E741
    values = gtsam.Values()
    for key, value in zip(KEYS, (l, d, b), strict=True):
        values.insert(key, value)
    return values


def test_vech_runs_along_the_rows_of_the_upper_triangle():
    np.testing.assert_array_equal(unvech([1, 2, 3, 4, 5, 6]), [[1, 2, 3], [2, 4, 5], [3, 5, 6]])
    np.testing.assert_array_equal(vech(unvech(L)), L)
    assert unvech(np.ones((4, 5, 6))).shape == (4, 5, 3, 3)


def test_priors():
    assert norm_error(L)[0] == pytest.approx([np.linalg.norm(L) - 1])
    assert determinant_error(L)[0] == pytest.approx([np.linalg.det(unvech(L)) - 1])
    np.testing.assert_array_equal(determinant_error(np.zeros(6), True)[1][0], np.zeros((1, 6)))


def test_residual_is_the_papers():
    m, derivative, w = samples(7)
    residual, _ = gyro_derivative_error(derivative_samples(m, derivative, w), L, D, B)
    assert np.sum(residual**2) == pytest.approx(sum_over_samples(m, derivative, w, L, D, B), rel=1e-13)


def test_residual_vanishes_for_a_field_fixed_in_the_world():
    """m = A Rᵀf + h, ṁ = −A [ω]× Rᵀf, w = ω + b."""
    inverse = unvech(L)
    field, rate, h = *samples(6)[:2], np.array([0.3, -0.2, 0.1])
    m = field @ np.linalg.inv(inverse) + h
    derivative = -np.cross(rate, field) @ np.linalg.inv(inverse)
    residual, _ = gyro_derivative_error((m, derivative, rate + B), L, inverse @ h, B)
    np.testing.assert_allclose(residual, 0, atol=1e-14)


@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_compressed_is_the_sum_over_samples(scale):
    m, derivative, w = samples(200)
    m, derivative, d = m * scale, derivative * scale, D * scale
    compressed = CompressedGyroDerivative.from_samples(m, derivative, w)
    assert compressed.samples == 200
    for l, b in ((L, B), (L * 0.1, 10 * B), (-L, -B)):  # noqa: E741
        expected = sum_over_samples(m, derivative, w, l, d, b)
        assert compressed.cost(l, d, b) == pytest.approx(expected, rel=1e-12)


def test_compressed_in_parts_in_any_order():
    m, derivative, w = samples(100)
    whole = CompressedGyroDerivative.from_samples(m, derivative, w)
    expected = whole.cost(L, D, B)
    order = np.random.default_rng(1).permutation(100)
    shuffled = CompressedGyroDerivative.from_samples(m[order], derivative[order], w[order])
    one_by_one = CompressedGyroDerivative.empty()
    for i in range(100):
        one_by_one = one_by_one.update(m[i], derivative[i], w[i])
    for other in (shuffled, one_by_one):
        assert other.samples == 100
        assert other.cost(L, D, B) == pytest.approx(expected, rel=1e-12)
        np.testing.assert_allclose(other.triangular, whole.triangular, atol=1e-11)


def test_compressed_blocks_do_not_show():
    m, derivative, w = samples(9000)
    residual, _ = gyro_derivative_error((m, derivative, w), L, D, B)
    compressed = CompressedGyroDerivative.from_samples(m, derivative, w)
    assert compressed.cost(L, D, B) == pytest.approx(np.sum(residual**2), rel=1e-12)


def test_compressed_is_saved_as_its_two_fields(tmp_path):
    whole = CompressedGyroDerivative.from_samples(*samples(50))
    np.savez(tmp_path / "state.npz", triangular=whole.triangular, samples=whole.samples)
    state = np.load(tmp_path / "state.npz")
    again = CompressedGyroDerivative(state["triangular"], int(state["samples"]))
    assert again.update(*samples(5, 1)).cost(L, D, B) == whole.update(*samples(5, 1)).cost(L, D, B)


def test_stacked_single_and_compressed_factors_have_the_same_error_and_hessian():
    m, derivative, w = samples(40)
    values = values_at(L, D, B)
    singles = gtsam.NonlinearFactorGraph()
    for i in range(40):
        singles.add(gyro_derivative_factor(*KEYS, m[i], derivative[i], w[i], 0.3))
    expected = singles.linearize(values).hessian()
    for factor in (
        gyro_derivative_factor(*KEYS, m, derivative, w, 0.3),
        CompressedGyroDerivative.from_samples(m, derivative, w).factor(*KEYS, 0.3),
    ):
        assert factor.error(values) == pytest.approx(singles.error(values), rel=1e-12)
        graph = gtsam.NonlinearFactorGraph()
        graph.add(factor)
        for ours, theirs in zip(graph.linearize(values).hessian(), expected, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-9)
