"""MAGYC-BFG against simulated truth and against its own variants."""

import gtsam
import numpy as np
import pytest

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.magyc.derivative_windows import GAUSS, derivative_windows
from magyc_gtsam.estimators.magyc.magyc_bfg import calibrate_magyc_bfg
from magyc_gtsam.estimators.magyc.state import KEYS, MagycState
from magyc_gtsam.factors import (
    CompressedGyroDerivative,
    MagycError,
    gyro_derivative_factor,
    norm_prior,
    unvech,
    vech,
)
from magyc_gtsam.factors.gyro_derivative import gyro_derivative_error
from magyc_gtsam.recording import Recording
from magyc_gtsam.runners import optimize
from magyc_gtsam.simulation import simulate

MILLIGAUSS = 1e-7


@pytest.fixture(scope="module")
def wide():
    return simulate("wide", duration=600, rate=10, seed=0)


def same(one, other, tolerance=1e-9):
    np.testing.assert_allclose(one.soft_iron, other.soft_iron, atol=tolerance)
    np.testing.assert_allclose(one.hard_iron, other.hard_iron, atol=tolerance * GAUSS)
    np.testing.assert_allclose(one.gyro_bias, other.gyro_bias, atol=tolerance)


def test_without_noise_only_the_window_limits_the_accuracy():
    """Averages over a window are wrong by its square."""
    simulation = simulate("wide", duration=200, rate=100, seed=2, magnetometer_noise=0, gyroscope_noise=0)
    errors = {}
    for window in (1.0, 0.2, 0.05):
        calibration = calibrate_magyc_bfg(simulation.recording, window=window)
        assert calibration.converged
        errors[window] = np.linalg.norm(calibration.hard_iron - simulation.truth.hard_iron) / MILLIGAUSS
    assert errors[0.2] < 0.06 * errors[1.0]
    assert errors[0.05] < 0.09 * errors[0.2]
    assert errors[0.05] < 0.01
    np.testing.assert_allclose(calibration.soft_iron, simulation.truth.soft_iron, atol=1e-4)
    np.testing.assert_allclose(calibration.gyro_bias, simulation.truth.gyro_bias, atol=1e-6)


def test_with_the_papers_noise(wide):
    calibration = calibrate_magyc_bfg(wide.recording)
    assert calibration.converged, calibration.message
    assert calibration.method == "magyc-bfg"
    assert calibration.covariance is None
    assert calibration.diagnostics["windows"] == 600
    assert np.linalg.det(calibration.soft_iron) == pytest.approx(1)
    np.testing.assert_allclose(calibration.soft_iron, wide.truth.soft_iron, atol=0.03)
    np.testing.assert_allclose(calibration.hard_iron, wide.truth.hard_iron, atol=20 * MILLIGAUSS)
    np.testing.assert_allclose(calibration.gyro_bias, wide.truth.gyro_bias, atol=3e-3)
    assert Calibration.from_dict(calibration.to_dict()).configuration["optimizer"] == "dogleg"


def test_every_optimizer_and_the_compressed_factor_find_the_same(wide):
    reference = calibrate_magyc_bfg(wide.recording, tolerance=1e-12)
    for options in ({"compressed": True}, {"optimizer": "lm"}, {"optimizer": "gauss-newton"}):
        same(calibrate_magyc_bfg(wide.recording, tolerance=1e-12, **options), reference)
    determinant = calibrate_magyc_bfg(wide.recording, prior="determinant", tolerance=1e-12)
    same(
        calibrate_magyc_bfg(wide.recording, prior="determinant", compressed=True, tolerance=1e-12),
        determinant,
    )
    same(determinant, reference, 0.05)


def test_it_is_the_papers_graph_of_two_factors_per_window(wide):
    windows = derivative_windows(wide.recording)
    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for m, derivative, w in zip(windows.magnetic_field, windows.derivative, windows.angular_rate, strict=True):
        graph.add(gyro_derivative_factor(*KEYS, m / GAUSS, derivative / GAUSS, w, 1e-3))
        graph.add(norm_prior(KEYS[0], 1e-2))
    for key, value in zip(KEYS, (vech(np.eye(3)), np.zeros(3), np.zeros(3)), strict=True):
        initial.insert(key, value)
    result = optimize(graph, initial, "dogleg", relative_tolerance=1e-12)
    calibration = calibrate_magyc_bfg(wide.recording, tolerance=1e-12)
    assert calibration.diagnostics["error"] == pytest.approx(min(result.errors), rel=1e-10)
    c = unvech(result.values.atVector(KEYS[0]))
    np.testing.assert_allclose(
        np.linalg.solve(c, result.values.atVector(KEYS[1])) * GAUSS, calibration.hard_iron, atol=1e-13
    )


def test_field_strength_scales_the_calibrated_field(wide):
    given = calibrate_magyc_bfg(wide.recording, field_strength=30e-6)
    assert np.linalg.norm(given.apply(wide.recording.magnetic_field), axis=1).mean() == pytest.approx(
        30e-6, rel=1e-3
    )
    free = calibrate_magyc_bfg(wide.recording)
    np.testing.assert_allclose(given.hard_iron, free.hard_iron)
    assert given.field_strength == 30e-6
    assert np.linalg.norm(free.apply(wide.recording.magnetic_field), axis=1).mean() == pytest.approx(
        free.field_strength, rel=1e-3
    )


def test_windows_are_averages_and_differences_of_their_own_samples():
    time = np.arange(100) / 10
    field = np.stack([3e-5 + 1e-6 * time, 2e-5 - 2e-6 * time, np.full(100, 1e-5)], axis=1)
    windows = derivative_windows(Recording(time, field, np.stack([time, 2 * time, 0 * time], axis=1)))
    assert len(windows.time) == 10
    np.testing.assert_allclose(windows.time, np.arange(10) + 0.45)
    np.testing.assert_allclose(windows.magnetic_field[:, 0], 3e-5 + 1e-6 * windows.time)
    np.testing.assert_allclose(windows.derivative, np.tile([1e-6, -2e-6, 0], (10, 1)), atol=1e-18)
    np.testing.assert_allclose(windows.angular_rate[:, 1], 2 * windows.time)


def test_sensors_with_rates_of_their_own_and_a_hole():
    rng = np.random.default_rng(0)
    time_m, time_w = np.arange(0, 20, 0.05), np.arange(0.003, 20, 0.01)
    time_m = time_m[(time_m < 7.2) | (time_m > 9.4)]
    field = 3e-5 + 1e-6 * np.stack([np.sin(time_m), np.cos(time_m), time_m], axis=1)
    recording = Recording.from_streams((time_m, field), (time_w, rng.normal(size=(len(time_w), 3))))
    windows = derivative_windows(recording)
    assert 16 <= len(windows.time) <= 18
    assert not ((windows.time > 7.5) & (windows.time < 9.2)).any()
    np.testing.assert_allclose(windows.derivative[:, 2], 1e-6, rtol=1e-9)


def test_interval_mean_rates_are_brought_to_their_stamps():
    simulation = simulate("wide", duration=300, rate=10, seed=3, magnetometer_noise=0, gyroscope_noise=0)
    at, w = simulation.recording, simulation.recording.angular_rate
    means = np.vstack([w[:1], 0.5 * (w[1:] + w[:-1])])
    late = Recording(at.time, at.magnetic_field, means, angular_rate_is="interval-mean")
    expected, found = derivative_windows(at), derivative_windows(late)
    np.testing.assert_allclose(found.angular_rate, expected.angular_rate, atol=5e-3)
    as_instants = derivative_windows(Recording(at.time, at.magnetic_field, means))
    wrong, right = (np.abs(x.angular_rate - expected.angular_rate).max() for x in (as_instants, found))
    assert right < 0.2 * wrong


def test_what_it_cannot_do_is_said(wide):
    with pytest.raises(MagycError, match="no angular rate"):
        calibrate_magyc_bfg(Recording(wide.recording.time, wide.recording.magnetic_field))
    with pytest.raises(MagycError, match="3 windows of 1 s"):
        calibrate_magyc_bfg(wide.recording.between(0, 2.9))
    with pytest.raises(MagycError, match="prior 'trace' unknown"):
        calibrate_magyc_bfg(wide.recording, prior="trace")
    with pytest.raises(MagycError, match="optimizer 'adam' unknown"):
        calibrate_magyc_bfg(wide.recording, optimizer="adam")
    with pytest.raises(MagycError, match="window: must be finite and above 0 s, got 0"):
        calibrate_magyc_bfg(wide.recording, window=0)
    limited = calibrate_magyc_bfg(wide.recording, max_iterations=1)
    assert not limited.converged
    assert "after 1 iterations" in limited.message


def test_motion_that_determines_too_little_is_not_called_converged():
    rng = np.random.default_rng(0)
    time = np.arange(0, 120, 0.1)
    heading = 0.5 * time
    level = np.stack([2e-5 * np.cos(heading), -2e-5 * np.sin(heading), np.full(len(time), 4e-5)], axis=1)
    rate = np.tile([0.0, 0.0, 0.5], (len(time), 1))
    for field, turning in ((level, rate), (level[:1] + 0 * level, 0 * rate)):
        m = field + 1e-6 * rng.normal(size=field.shape)
        calibration = calibrate_magyc_bfg(Recording(time, m, turning + 5e-3 * rng.normal(size=field.shape)))
        assert not calibration.converged
        assert "not observable" in calibration.message or "positive definite" in calibration.message


def test_indeterminate_motion_is_named():
    time = np.arange(0, 60, 0.1)
    still = np.tile([2e-5, 0.0, 4e-5], (600, 1))
    own = np.ones(600, dtype=bool)
    recording = Recording(time, still, np.zeros((600, 3)), magnetic_field_fresh=own, angular_rate_fresh=own)
    calibration = calibrate_magyc_bfg(recording)
    assert not calibration.converged
    assert "is not determined by the data" in calibration.message


def test_its_weakness_is_that_of_numeric_differences(wide):
    """The covariance behind the verdict, against the spread of A, h, b over perturbed (l, d, b)."""
    windows = derivative_windows(wide.recording)
    samples = windows.magnetic_field / GAUSS, windows.derivative / GAUSS, windows.angular_rate
    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gyro_derivative_factor(*KEYS, *samples, 1.0))
    graph.add(norm_prior(KEYS[0], 1e-3))
    for key, value in zip(KEYS, (vech(np.eye(3)), np.zeros(3), np.zeros(3)), strict=True):
        initial.insert(key, value)
    values = optimize(graph, initial).values
    l, d, b = (values.atVector(key) for key in KEYS)  # noqa: E741
    residual, _ = gyro_derivative_error(samples, l, d, b)
    marginal = gtsam.Marginals(graph, values).jointMarginalCovariance(gtsam.KeyVector(KEYS))
    blocks = np.block([[marginal.at(i, j) for j in KEYS] for i in KEYS])
    blocks *= np.sum(residual**2) / (residual.size - 12)

    def physical(x):
        inverse = np.linalg.inv(unvech(x[:6]))
        return np.concatenate([vech(inverse / np.cbrt(np.linalg.det(inverse))), inverse @ x[6:9] * GAUSS, x[9:]])

    x = np.concatenate([l, d, b])
    mapping = np.array([(physical(x + e) - physical(x - e)) / 2e-6 for e in 1e-6 * np.eye(12)]).T
    scale = np.diag(1 / np.repeat([1, GAUSS, 1], [6, 3, 3]))
    np.testing.assert_allclose(
        scale @ MagycState(l, d, b).covariance(CompressedGyroDerivative.from_samples(*samples)) @ scale,
        scale @ mapping @ blocks @ mapping.T @ scale,
        rtol=0.02,
        atol=1e-8,
    )


def test_progress_and_interrupt(wide):
    seen = []
    calibrate_magyc_bfg(wide.recording, progress=seen.append)
    assert len(seen) > 2
    assert seen == sorted(seen)
    assert seen[-1] == 1.0

    def stop(share):
        if share < 1:
            raise KeyboardInterrupt

    calibration = calibrate_magyc_bfg(wide.recording, progress=stop)
    assert not calibration.converged
    assert "interrupted" in calibration.message
