"""Kernels: their calculus, their constants, and stacked samples against GTSAM's own robust factors."""

import gtsam
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi

from magyc_gtsam.factors import KERNELS, gyro_derivative_factor, robust_noise
from magyc_gtsam.factors.kernels import robustify, tuning_constant

E = np.array([1e-6, 0.1, 0.5, 1.0, 1.7, 3.0, 10.0, 100.0])


@pytest.mark.parametrize("name", KERNELS)
def test_weight_is_the_slope_of_the_loss(name):
    kernel, k, step = KERNELS[name], tuning_constant(name, 3), 1e-6
    e = E[1:]
    slope = (kernel.loss(e + step, k) - kernel.loss(e - step, k)) / (2 * step)
    np.testing.assert_allclose(kernel.weight(e, k) * e, slope, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["huber", "cauchy", "geman-mcclure"])
def test_small_errors_cost_as_least_squares(name):
    np.testing.assert_allclose(KERNELS[name].loss(E[:2], 2.0), 0.5 * E[:2] ** 2, rtol=5e-3)


@pytest.mark.parametrize(
    ("name", "paper"),
    [
        ("l1", lambda s, tau: 2 * np.sqrt(s)),
        ("huber", lambda s, tau: np.where(s <= tau**2, s, 2 * tau * np.sqrt(s) - tau**2)),
        ("cauchy", lambda s, tau: tau**2 * np.log(1 + s / tau**2)),
        ("geman-mcclure", lambda s, tau: tau**2 - tau**4 / (tau**2 + s)),
    ],
)
def test_losses_are_the_papers(name, paper):
    """Eqs. (9) to (12) as meant, ρ_paper(s) = 2 ρ(√s); L1 up to its factor and its rounded tip."""
    tau = 1e-9 if name == "l1" else 1.3
    loss = KERNELS[name].loss(E, tau)
    np.testing.assert_allclose(2 * loss, paper(E**2, tau), rtol=1e-3 if name == "l1" else 1e-9, atol=1e-15)


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("name", ["huber", "cauchy", "geman-mcclure"])
def test_tuning_constants_give_95_percent_efficiency(name, dimension):
    """Asymptotic efficiency of the location M-estimate under N(0, I): E[ψ']²/(E[ψ²]/d), ψ = weight·e."""
    kernel, k, step = KERNELS[name], KERNELS[name].tuning[dimension], 1e-5

    def psi(e):
        return float(kernel.weight(np.float64(e), k) * e)

    def slope(e):
        return (psi(e + step) - psi(e - step)) / (2 * step)

    def expectation(f):
        return sum(
            quad(lambda e: f(e) * chi(dimension).pdf(e), a, b, limit=200)[0] for a, b in ((1e-4, k), (k, 12))
        )

    d = dimension
    sharpness = expectation(lambda e: (1 - 1 / d) * psi(e) / e + slope(e) / d)
    assert sharpness**2 / expectation(lambda e: psi(e) ** 2 / d) == pytest.approx(0.95, abs=1e-3)


@pytest.mark.parametrize("name", KERNELS)
def test_stacked_samples_equal_single_factors_under_gtsams_models(name):
    rng = np.random.default_rng(4)
    keys = [gtsam.symbol(c, 0) for c in "ldb"]
    m, derivative, w = rng.normal(size=(3, 30, 3)) * np.geomspace(1e-3, 30, 30)[:, None]
    values = gtsam.Values()
    for key, value in zip(keys, ([1.1, 0.1, -0.2, 0.9, 0.3, 1.2], [0.01, 0.02, 0.03], [0.1, 0, 0]), strict=True):
        values.insert(key, np.array(value, dtype=float))
    stacked, singles = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
    stacked.add(gyro_derivative_factor(*keys, m, derivative, w, 0.2, robust=name))
    for i in range(30):
        singles.add(gyro_derivative_factor(*keys, m[i], derivative[i], w[i], robust_noise(name, 0.2)))
    assert stacked.error(values) == pytest.approx(singles.error(values), rel=1e-9)
    ours, theirs = (g.linearize(values).hessian()[1] for g in (stacked, singles))
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("name", KERNELS)
def test_a_zero_residual_stays_finite(name):
    residual, jacobians = robustify(name, np.zeros((2, 3)), [np.ones((2, 3, 4))])
    assert not residual.any()
    assert np.isfinite(jacobians[0]).all()


@pytest.mark.parametrize("name", KERNELS)
def test_robust_kernels_recover_what_outliers_spoil(name):
    """A fifth of the samples with a wrong derivative: least squares is off, the kernel is not."""
    rng = np.random.default_rng(5)
    keys = [gtsam.symbol(c, 0) for c in "ldb"]
    field, rate = rng.normal(size=(2, 400, 3))
    field /= np.linalg.norm(field, axis=1)[:, None]
    d, b, noise = np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.03]), 0.01
    derivative = -np.cross(rate, field) + noise * rng.normal(size=(400, 3))
    derivative[::5] += rng.uniform(0, 2, size=(80, 3))
    soft_iron = np.array([1.0, 0, 0, 1, 0, 1])
    initial = gtsam.Values()
    for key, value in zip(keys, (soft_iron, np.zeros(3), np.zeros(3)), strict=True):
        initial.insert(key, value)
    wrong = {}
    for kernel in (None, name):
        graph = gtsam.NonlinearFactorGraph()
        graph.add(gyro_derivative_factor(*keys, field + d, derivative, rate + b, noise, robust=kernel))
        graph.addPriorVector(keys[0], soft_iron, gtsam.noiseModel.Isotropic.Sigma(6, 1e-6))
        result = gtsam.LevenbergMarquardtOptimizer(graph, initial).optimize()
        wrong[kernel] = np.linalg.norm(result.atVector(keys[1]) - d)
    assert wrong[None] > 0.03
    assert wrong[name] < 0.006
