"""Every factor's Jacobian on every key, through `linearize()`, against central differences."""

import gtsam
import numpy as np
import pytest

from magyc_gtsam.factors import (
    KERNELS,
    CompressedGyroDerivative,
    determinant_prior,
    field_link_factor,
    gyro_derivative_factor,
    norm_prior,
    preintegrate,
    robust_noise,
    sphere_factor,
)
from magyc_gtsam.factors.field_link import left_jacobian

SOFT, HARD, BIAS, FIRST, SECOND, FULL = (gtsam.symbol(c, 0) for c in "ldbxyk")
RNG = np.random.default_rng(1)
SAMPLES = RNG.normal(size=(3, 5, 3))
LINK = preintegrate(np.linspace(0, 1, 11), RNG.normal(size=(11, 3)), 0.05, 0.93, [0.1, -0.2, 0.3])

# A ConstantBias' accelerometer part must not matter.
BIASES = {
    "vector": lambda v, b: v.insert(BIAS, b),
    "Point3": lambda v, b: v.insertPoint3(BIAS, b),
    "ConstantBias": lambda v, b: v.insert(BIAS, gtsam.imuBias.ConstantBias(np.array([1.0, 2.0, 3.0]), b)),
}
FACTORS = {
    "norm prior": lambda: norm_prior(SOFT, 0.1),
    "determinant prior": lambda: determinant_prior(SOFT, 0.1),
    "gyro derivative, one": lambda: gyro_derivative_factor(SOFT, HARD, BIAS, *SAMPLES[:, 0], 0.1),
    "gyro derivative, stacked": lambda: gyro_derivative_factor(SOFT, HARD, BIAS, *SAMPLES, 0.1),
    "gyro derivative, compressed": lambda: CompressedGyroDerivative.from_samples(*SAMPLES).factor(
        SOFT, HARD, BIAS, 0.1
    ),
    **{
        f"gyro derivative, {name}": lambda name=name: gyro_derivative_factor(
            SOFT, HARD, BIAS, *SAMPLES, 0.5, robust=name
        )
        for name in KERNELS
    },
    "sphere, symmetric": lambda: sphere_factor(FIRST, SOFT, HARD, SAMPLES[0, 0], 0.1),
    "sphere, triangular": lambda: sphere_factor(FIRST, SOFT, HARD, SAMPLES[0, 0], 0.1, shape="triangular"),
    "sphere, full": lambda: sphere_factor(FIRST, FULL, HARD, SAMPLES[0, 0], 0.1, shape="full"),
    "field link": lambda: field_link_factor(FIRST, SECOND, BIAS, LINK, 0.01),
    "field link, noise model": lambda: field_link_factor(
        FIRST, SECOND, BIAS, LINK, gtsam.noiseModel.Isotropic.Sigma(3, 0.01)
    ),
}


def point(bias="vector"):
    rng = np.random.default_rng(2)
    values = gtsam.Values()
    values.insert(SOFT, np.array([1.1, 0.1, -0.2, 0.9, 0.3, 1.2]))
    values.insert(FULL, rng.normal(size=9))
    values.insert(HARD, rng.normal(size=3))
    values.insert(FIRST, gtsam.Unit3(rng.normal(size=3)))
    values.insert(SECOND, gtsam.Unit3(rng.normal(size=3)))
    BIASES[bias](values, np.array([0.3, 0.1, -0.4]))
    return values


def derivative(function, values, keys):
    """Central differences of function(values) along every tangent direction of every key, in columns."""
    columns = []
    for key in keys:
        for unit in np.eye(values.zeroVectors().at(key).size):
            up, down = (gtsam.VectorValues() for _ in range(2))
            up.insert(key, 1e-5 * unit)
            down.insert(key, -1e-5 * unit)
            columns.append((function(values.retract(up)) - function(values.retract(down))) / 2e-5)
    return np.array(columns).T


@pytest.mark.parametrize("bias", BIASES)
@pytest.mark.parametrize("name", FACTORS)
def test_jacobian_is_the_derivative(name, bias):
    factor, values = FACTORS[name](), point(bias)
    jacobian, right = factor.linearize(values).jacobian()
    np.testing.assert_allclose(-right, factor.whitenedError(values), atol=1e-12)
    numeric = derivative(factor.whitenedError, values, factor.keys())
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())


@pytest.mark.parametrize("name", KERNELS)
def test_gradient_under_gtsams_robust_models(name):
    factor, values = (
        gyro_derivative_factor(SOFT, HARD, BIAS, *SAMPLES[:, 0], robust_noise(name, 0.5)),
        point(),
    )
    jacobian, right = factor.linearize(values).jacobian()
    numeric = derivative(factor.error, values, factor.keys())
    np.testing.assert_allclose(-jacobian.T @ right, numeric, rtol=1e-5, atol=1e-6)


def test_left_jacobian_is_gtsams():
    vectors = np.vstack([np.zeros(3), 1e-6 * RNG.normal(size=(2, 3)), 1e-3 * np.ones(3), RNG.normal(size=(4, 3))])
    expected = [gtsam.Rot3.ExpmapDerivative(-v) for v in vectors]
    np.testing.assert_allclose(left_jacobian(vectors), expected, atol=1e-13)
