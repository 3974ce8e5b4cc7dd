"""The measures of the papers, each against its definition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from magyc_gtsam import Calibration, MagycError, metrics
from magyc_gtsam.closest_point import closest_points
from magyc_gtsam.study.review import bound, draw

MATRIX = np.array([[1.10, 0.10, 0.04], [0.10, 0.88, 0.02], [0.04, 0.02, 1.22]])
OFFSET = np.array([0.1, -0.2, 0.3])


@pytest.fixture
def random():
    return np.random.default_rng(0)


def test_the_model_of_a_calibration_is_in_tesla():
    matrix, offset = metrics.model(Calibration(MATRIX, OFFSET * 1e-6, field_strength=50e-6))
    np.testing.assert_allclose(matrix, 50e-6 * MATRIX)
    np.testing.assert_allclose(offset, OFFSET * 1e-6)
    with pytest.raises(MagycError, match="no field strength"):
        metrics.model(Calibration(MATRIX, OFFSET * 1e-6))


def test_normalised_model_error_is_relative():
    assert metrics.normalised_model_error(MATRIX, OFFSET, MATRIX, OFFSET) == 0
    assert metrics.normalised_model_error(1.01 * MATRIX, 1.01 * OFFSET, MATRIX, OFFSET) == pytest.approx(0.01)
    moved = metrics.normalised_model_error(MATRIX, OFFSET + [0.3, 0, 0], MATRIX, OFFSET)
    assert moved == pytest.approx(0.3 / np.sqrt(np.sum(MATRIX**2) + np.sum(OFFSET**2)))


def test_sensor_estimation_error_is_the_noise_across_the_surface(random):
    x = random.normal(size=(20_000, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    samples = x @ MATRIX.T + OFFSET
    assert metrics.sensor_estimation_error(MATRIX, OFFSET, samples) < 1e-12
    noisy = samples + 0.01 * random.normal(size=samples.shape)
    assert metrics.sensor_estimation_error(MATRIX, OFFSET, noisy) == pytest.approx(0.01, rel=0.03)


def test_matrix_error_does_not_see_rotations_and_mirrors(random):
    for rotation in Rotation.random(5, random_state=1).as_matrix():
        for mirror in (1, -1):
            assert metrics.matrix_error(MATRIX @ rotation * mirror, MATRIX) < 1e-14
    other = MATRIX + 0.05 * random.normal(size=(3, 3))
    tried = [np.linalg.norm(other - MATRIX @ r) for r in Rotation.random(500, random_state=2).as_matrix()]
    found = metrics.matrix_error(other, MATRIX)
    assert found <= min(tried)
    near = [expm(np.cross(np.eye(3), 1e-3 * random.normal(size=3))) for _ in range(100)]
    left, _, right = np.linalg.svd(MATRIX.T @ other)
    assert all(found <= np.linalg.norm(other - MATRIX @ left @ right @ r) for r in near)


def test_model_cost_is_the_sum_of_squares():
    assert metrics.offset_error(OFFSET, [0, 0, 0]) == pytest.approx(np.linalg.norm(OFFSET))
    cost = metrics.model_cost(MATRIX, OFFSET, np.eye(3), np.zeros(3))
    assert cost == pytest.approx(OFFSET @ OFFSET + metrics.matrix_error(MATRIX, np.eye(3)) ** 2)


def test_scores_count_the_runs_that_beat_no_calibration():
    scores = metrics.scores([0.1, 0.3, 2.0, np.inf], [1.0, 1.0, 1.0, 1.0], [1.0, 3.0, 100.0, 100.0])
    assert scores.robustness == 0.5
    assert scores.accuracy == pytest.approx(5.0)
    assert scores.time == pytest.approx(2.0)
    strict = metrics.scores([0.1, 0.3, 2.0, np.inf], [1.0, 1.0, 1.0, 1.0], [1.0, 3.0, 100.0, 100.0], delta=0.2)
    assert strict.robustness == 0.25
    none = metrics.scores([2.0], [1.0], [1.0])
    assert none.robustness == 0
    assert np.isnan(none.accuracy)


def test_real_data_cost_needs_no_truth(random):
    x = random.normal(size=(500, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    assert metrics.real_data_cost(MATRIX, OFFSET, x @ MATRIX.T + OFFSET) < 1e-28
    assert metrics.real_data_cost(MATRIX, OFFSET, 1.1 * x @ MATRIX.T + OFFSET) == pytest.approx(0.21**2)


def test_heading_error_is_the_turn_of_the_field_about_the_vertical():
    attitude = Rotation.from_euler("ZYX", np.random.default_rng(3).uniform(-1, 1, (200, 3)))
    north_east = np.array([20e-6, 5e-6, 40e-6])
    field = attitude.inv().apply(north_east)
    quaternion = attitude.as_quat()
    quaternion[7] = np.nan
    error = metrics.heading_error(field, quaternion)
    assert np.isnan(error[7])
    np.testing.assert_allclose(np.delete(error, 7), 0, atol=1e-12)
    declination = np.arctan2(5, 20)
    turned = attitude.inv().apply(Rotation.from_euler("z", 0.2).apply(north_east))
    np.testing.assert_allclose(np.delete(metrics.heading_error(turned, quaternion, declination), 7), 0.2)


def test_the_bound_is_that_of_numeric_derivatives():
    """The trace of the bound on T modulo rotation and h, from derivatives of the distance of a sample."""
    data = draw(3, samples=60)
    matrix, offset = data.matrix, data.offset

    def distances(x):
        directions = closest_points(x[:9].reshape(3, 3), x[9:], clean.T).direction.T
        residual = clean - x[9:] - directions @ x[:9].reshape(3, 3).T
        return np.einsum("ni,ni->n", residual, normal)

    clean = data.field @ matrix.T + offset
    normal = data.field @ np.linalg.inv(matrix)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    x = np.concatenate([matrix.ravel(), offset])
    jacobian = np.array([(distances(x + d) - distances(x - d)) / 2e-6 for d in 1e-6 * np.eye(12)]).T
    values = np.linalg.eigvalsh(jacobian.T @ jacobian)
    assert (values[:3] < 1e-6 * values[-1]).all()  # the rotation
    assert bound(data) == pytest.approx(np.sum(1 / values[3:]) * data.noise**2, rel=1e-4)
