"""Field directions: links against GTSAM's preintegration, and a whole graph against simulated truth."""

import gtsam
import numpy as np
import pytest
from scipy.linalg import expm

from magyc_gtsam.factors import field_link_factor, preintegrate, sphere_factor, unvech, vech
from magyc_gtsam.factors.chain.rotations import skew
from magyc_gtsam.runners import optimize
from magyc_gtsam.simulation import simulate

MICROTESLA = 1e-6


def test_preintegration_is_gtsams():
    rng = np.random.default_rng(0)
    time, rate, bias = np.sort(rng.uniform(0, 1, 50)), rng.normal(size=(50, 3)), np.array([0.1, -0.2, 0.3])
    link = preintegrate(time, rate, time[3], time[40], bias, interval_mean=True)
    theirs = gtsam.PreintegratedRotation(gtsam.PreintegratedRotationParams())
    for k in range(3, 40):
        theirs.integrateGyroMeasurement(rate[k + 1], bias, time[k + 1] - time[k])
    np.testing.assert_allclose(link.rotation, theirs.deltaRij().matrix(), atol=1e-13)
    # GTSAM's derivative is on the right, ΔR Exp(D δ) = Exp(ΔR D δ) ΔR.
    np.testing.assert_allclose(link.lever, link.rotation @ theirs.delRdelBiasOmega(), atol=1e-13)
    assert link.squared_time == pytest.approx(np.sum(np.diff(time[3:41]) ** 2))


def test_bias_correction_is_first_order():
    rng = np.random.default_rng(0)
    time, rate, direction = np.linspace(0, 1, 101), rng.normal(size=(101, 3)), np.array([0.6, 0.0, 0.8])
    at_zero = preintegrate(time, rate, 0, 1)
    errors = []
    for size in (1e-2, 1e-3):
        bias = size * np.array([1.0, -2.0, 3.0])
        turned = preintegrate(time, rate, 0, 1, bias).rotation.T @ direction
        errors.append(np.linalg.norm(at_zero.error(direction, turned, bias)[0]))
    assert errors[0] < 1e-3
    assert errors[1] < errors[0] / 80


@pytest.mark.parametrize("interval_mean", [False, True])
def test_link_turns_the_field_as_the_sensor_sees_it(interval_mean):
    """Constant rate ω: the field in the sensor follows u̇ = −[ω]× u."""
    rate, time = np.array([0.3, -0.5, 0.7]), np.linspace(0, 2, 21)
    link = preintegrate(time, np.tile(rate, (21, 1)), 0.33, 1.77, interval_mean=interval_mean)
    np.testing.assert_allclose(link.rotation.T, expm(-skew(rate) * 1.44), atol=1e-13)


def field_graph(simulation, step, gyroscope_noise, magnetometer_noise):
    """Every `step`-th sample a direction; links between them; bias as a `ConstantBias`."""
    recording = simulation.recording
    time, m, w = recording.time, recording.magnetic_field / MICROTESLA, recording.angular_rate
    k, h, b = (gtsam.symbol(c, 0) for c in "khb")
    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    rows = range(0, len(time), step)
    for i in rows:
        graph.add(sphere_factor(gtsam.symbol("x", i), k, h, m[i], magnetometer_noise / MICROTESLA))
        initial.insert(gtsam.symbol("x", i), gtsam.Unit3(m[i]))
    for i in rows[:-1]:
        link = preintegrate(time, w, time[i], time[i + step])
        graph.add(field_link_factor(gtsam.symbol("x", i), gtsam.symbol("x", i + step), b, link, gyroscope_noise))
    accelerometer = gtsam.noiseModel.Diagonal.Sigmas(np.array([1, 1, 1, 1e3, 1e3, 1e3]))
    graph.addPriorConstantBias(b, gtsam.imuBias.ConstantBias(), accelerometer)
    initial.insert(k, 50 * vech(np.eye(3)))
    initial.insertPoint3(h, np.zeros(3))
    initial.insert(b, gtsam.imuBias.ConstantBias())
    return graph, initial, (k, h, b)


@pytest.mark.parametrize("method", ["lm", "dogleg"])
def test_sphere_and_links_recover_the_truth(method):
    simulation = simulate("wide", duration=60, rate=50, seed=1, magnetometer_noise=1e-8, gyroscope_noise=1e-4)
    graph, initial, (k, h, b) = field_graph(simulation, 25, 1e-4, 1e-8)
    result = optimize(graph, initial, method)
    assert result.converged, result.message
    soft_iron = unvech(result.values.atVector(k))
    truth = simulation.truth
    np.testing.assert_allclose(soft_iron / np.cbrt(np.linalg.det(soft_iron)), truth.soft_iron, atol=1e-3)
    np.testing.assert_allclose(result.values.atPoint3(h) * MICROTESLA, truth.hard_iron, atol=2e-8)
    np.testing.assert_allclose(result.values.atConstantBias(b).gyroscope(), truth.gyro_bias, atol=5e-5)
    # Half the sum of squares: χ² of 3·120 + 2·119 measurements and 12 + 2·120 unknowns (the third row
    # of a chord carries none).
    assert 2 * min(result.errors) == pytest.approx(346, abs=5 * np.sqrt(2 * 346))
