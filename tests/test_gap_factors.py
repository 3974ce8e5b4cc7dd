"""Effects as variables of a graph."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, H, S, V, X
from scipy.spatial.transform import Rotation
from test_factors_jacobians import derivative

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import preintegrate
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.factors.effects.factor import (
    effect_chain_factor,
    effect_magnetometer_factor,
    semidefinite_root,
)
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.runners.batch import optimize
from magyc_gtsam.runners.incremental import Incremental

SOFT = np.array([[1.05, 0.04, 0.0], [0.04, 0.95, 0.02], [0.0, 0.02, 1.01]])
HARD = np.array([2e-6, -12e-6, 9e-6])


def test_an_effect_is_a_variable_of_a_graph() -> None:
    """The current's coefficient, found by GTSAM beside the twelve parameters."""
    simulation = mg.simulate("wide", duration=300, seed=2)
    recording = simulation.recording
    current = 3.0 * (np.sin(recording.time / 11.0) > 0.3) + 0.2 * np.sin(recording.time)
    value = np.array([3e-7, -1e-7, 2e-7])
    samples = preintegrate(recording, 1.0)
    object.__setattr__(samples, "magnetic_field", samples.magnetic_field + current[:, None] * value)
    count = np.diff(np.append(samples.starts, len(current)))
    mean = np.add.reduceat(current, samples.starts) / count
    columns = np.eye(3)[:, :, None] * mean * 1e-6  # value in µT per unit
    noise = SensorNoise(1e-6, 5e-3)
    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(effect_chain_factor(S(0), H(0), B(0), X(0), samples, columns, noise))
    truth = simulation.truth
    strength = truth.field_strength
    assert strength is not None
    initial.insert(S(0), vech(np.eye(3)) * strength * 1e6)
    initial.insert(H(0), gtsam.Point3(0, 0, 0))
    initial.insert(B(0), gtsam.Point3(0, 0, 0))
    initial.insert(X(0), np.zeros(3))
    result = optimize(graph, initial)
    assert result.converged, result.message
    sigma = np.sqrt(np.diag(gtsam.Marginals(graph, result.values).marginalCovariance(X(0))))
    found = result.values.atVector(X(0))
    assert np.all(np.abs(found - value * 1e6) < 4 * sigma)
    assert np.all(sigma < 0.05)
    with pytest.raises(mg.MagycError, match="columns"):
        effect_chain_factor(S(0), H(0), B(0), X(0), samples, columns[:, :, 1:], noise)


@pytest.mark.parametrize("side", ["magnetometer", "gyroscope"])
def test_the_factors_jacobians(side: Literal["magnetometer", "gyroscope"]) -> None:
    simulation = mg.simulate("wide", duration=40, seed=3)
    samples = preintegrate(simulation.recording, 1.0)
    if side == "gyroscope":
        columns = FORMS["gyro-scale"].columns(Signals(samples.gyroscope_time, rate=samples.angular_rate.T), {})
    else:
        columns = np.eye(3)[:, :, None] * np.linspace(-1, 1, len(samples.starts)) * 1e-6
    factor = effect_chain_factor(S(0), H(0), B(0), X(0), samples, columns, SensorNoise(1e-6, 5e-3), side=side)
    size = 12 + len(columns)
    # Away from zero: the effect is taken out before anything is integrated.
    value = np.linspace(-1, 1, len(columns)) * (0.02 if side == "gyroscope" else 1.0)
    truth = simulation.truth
    assert truth.field_strength is not None
    assert truth.gyro_bias is not None

    def at(step: np.ndarray) -> gtsam.Values:
        values = gtsam.Values()
        values.insert(S(0), vech(truth.soft_iron) * truth.field_strength * 1e6 + step[:6])
        values.insert(H(0), gtsam.Point3(*(truth.hard_iron * 1e6 + step[6:9])))
        values.insert(B(0), gtsam.Point3(*(truth.gyro_bias + step[9:12])))
        values.insert(X(0), value + step[12:])
        return values

    jacobian, right = factor.linearize(at(np.zeros(size))).jacobian()
    gradient = -jacobian.T @ right
    for index in range(size):
        step = np.zeros(size)
        step[index] = 1e-5 if 9 <= index < 12 or (side == "gyroscope" and index >= 12) else 1e-3
        slope = (factor.error(at(step)) - factor.error(at(-step))) / (2 * step[index])
        assert slope == pytest.approx(gradient[index], rel=3e-3, abs=3e-3 * np.abs(gradient[[index]]).max() + 1e-3)


def test_an_effect_of_the_gyroscope_in_batch_and_incremental_graphs() -> None:
    """Four stretches of a log share the calibration and a scale of the gyroscope; the bias is an inertial graph's."""
    simulation = mg.simulate("wide", duration=240, seed=5)
    recording, truth = simulation.recording, simulation.truth
    assert recording.angular_rate is not None
    assert truth.gyro_bias is not None
    assert truth.field_strength is not None
    scale = np.array([0.03, -0.02, 0.025])
    rate = recording.angular_rate + (recording.angular_rate - truth.gyro_bias) * scale
    recording = replace(recording, angular_rate=rate)
    factors = []
    for start in range(0, 240, 60):
        samples = preintegrate(recording.between(start, start + 60), 1.0)
        signals = Signals(samples.gyroscope_time, rate=(samples.angular_rate - truth.gyro_bias).T / 1.01)
        columns = FORMS["gyro-scale"].columns(signals, dict.fromkeys("xyz", 1.0))
        noise = SensorNoise(1e-6, 5e-3)
        factors.append(
            effect_chain_factor(
                S(0), H(0), B(0), X(0), samples, columns, noise, side="gyroscope", soft_iron_unit=50e-6
            )
        )
    initial = gtsam.Values()
    initial.insert(S(0), vech(np.eye(3)))
    initial.insert(H(0), gtsam.Point3(0, 0, 0))
    initial.insert(B(0), gtsam.imuBias.ConstantBias())
    initial.insert(X(0), np.zeros(3))
    # What an inertial graph knows of its accelerometer's bias.
    prior = gtsam.PriorFactorConstantBias(
        B(0), gtsam.imuBias.ConstantBias(), gtsam.noiseModel.Diagonal.Sigmas([1e-3] * 3 + [1.0] * 3)
    )
    graph = gtsam.NonlinearFactorGraph()
    for factor in (prior, *factors):
        graph.add(factor)
    batch = optimize(graph, initial)
    assert batch.converged, batch.message
    sigma = np.sqrt(np.diag(gtsam.Marginals(graph, batch.values).marginalCovariance(X(0))))
    assert np.all(np.abs(batch.values.atVector(X(0)) - scale) < 4 * sigma + 0.02 * np.abs(scale))
    assert np.all(sigma < 0.005)
    online = Incremental()
    online.update([prior, factors[0]], initial, steps=20)
    for factor in factors[1:]:
        assert online.update([factor], steps=20).updated
    found = online.values.atVector(X(0))
    np.testing.assert_allclose(found, batch.values.atVector(X(0)), atol=0.02 * sigma.max())
    with pytest.raises(mg.MagycError, match="gyroscope sample"):
        effect_chain_factor(S(0), H(0), B(0), X(0), samples, columns[:, :, 1:], noise, side="gyroscope")


def pose_graph(
    current: np.ndarray, value: np.ndarray
) -> tuple[list[gtsam.NonlinearFactor], gtsam.Values, mg.Calibration]:
    """Sixty poses with attitudes known to a milliradian, a reading at each, and the chain of the whole log."""
    simulation = mg.simulate("wide", duration=120, seed=6)
    recording, truth = simulation.recording, simulation.truth
    assert recording.attitude is not None
    assert truth.field_strength is not None
    added = current[:, None] * value
    samples = preintegrate(replace(recording, magnetic_field=recording.magnetic_field + added), 1.0)
    count = np.diff(np.append(samples.starts, len(current)))
    columns = np.eye(3)[:, :, None] * (np.add.reduceat(current, samples.starts) / count) * 1e-6
    unit = truth.field_strength
    chain = effect_chain_factor(
        S(0), H(0), B(0), V(0), samples, columns, SensorNoise(1e-6, 5e-3), soft_iron_unit=unit
    )
    clean = truth.apply(recording.magnetic_field)
    turn = Rotation.from_quat(recording.attitude)
    field = turn.apply(clean).mean(axis=0)
    factors: list[gtsam.NonlinearFactor] = [chain]
    initial = gtsam.Values()
    for k, row in enumerate(range(0, len(current), 20)):
        pose = gtsam.Pose3(gtsam.Rot3(turn[row].as_matrix()), np.zeros(3))
        initial.insert(X(k), pose)
        factors.append(gtsam.PriorFactorPose3(X(k), pose, gtsam.noiseModel.Isotropic.Sigma(6, 1e-3)))
        reading = recording.magnetic_field[row] + added[row]
        factors.append(
            effect_magnetometer_factor(
                X(k), S(0), H(0), V(0), reading, np.eye(3) * current[row] * 1e-6, 1e-6, field=field
            )
        )
    initial.insert(S(0), vech(np.eye(3)))
    initial.insert(H(0), gtsam.Point3(0, 0, 0))
    initial.insert(B(0), gtsam.Point3(0, 0, 0))
    initial.insert(V(0), np.zeros(3))
    return factors, initial, truth


def test_an_effect_in_a_pose_graph() -> None:
    """Poses, calibration and the coefficient of a current in one graph, in batch and step by step."""
    time = np.arange(1200) / 10
    value = np.array([3e-7, -1e-7, 2e-7])
    factors, initial, truth = pose_graph(3.0 * (np.sin(time / 7) > 0.3) + 0.2 * np.sin(time), value)
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    batch = optimize(graph, initial)
    assert batch.converged, batch.message
    sigma = np.sqrt(np.diag(gtsam.Marginals(graph, batch.values).marginalCovariance(V(0))))
    found = batch.values.atVector(V(0))
    assert np.all(np.abs(found - value * 1e6) < 4 * sigma)
    assert np.all(sigma < 0.1)
    assert np.all(np.abs(batch.values.atPoint3(H(0)) - truth.hard_iron * 1e6) < 1.0)
    online = Incremental()
    for first in range(0, len(factors), 41):
        assert online.update(factors[first : first + 41], initial, steps=20).updated
    np.testing.assert_allclose(online.values.atVector(V(0)), found, atol=0.02 * sigma.max())


def test_jacobians_of_a_reading_with_an_effect() -> None:
    columns = np.random.default_rng(7).standard_normal((2, 3)) * 1e-6
    factor = effect_magnetometer_factor(
        X(0),
        S(0),
        H(0),
        V(0),
        [1e-5, 2e-5, -3e-5],
        columns,
        1e-6,
        field=[2e-5, 0, 4e-5],
        body_R_sensor=gtsam.Rot3.RzRyRx(0.1, 0.5, -0.7),
    )
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.4, 2.0), np.array([1.0, 2, 3])))
    values.insert(S(0), vech(SOFT))
    values.insert(H(0), HARD * 1e6)
    values.insert(V(0), np.array([0.5, -2.0]))
    jacobian, _ = factor.linearize(values).jacobian()
    numeric = derivative(factor.whitenedError, values, factor.keys())
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())


def chained(simulation: mg.Simulation) -> gtsam.Values:
    """The truth as the variables of a chain, in µT and rad/s."""
    truth, values = simulation.truth, gtsam.Values()
    assert truth.field_strength is not None
    assert truth.gyro_bias is not None
    values.insert(S(0), vech(truth.soft_iron) * truth.field_strength * 1e6)
    values.insert(H(0), gtsam.Point3(*(truth.hard_iron * 1e6)))
    values.insert(B(0), gtsam.Point3(*truth.gyro_bias))
    return values


@pytest.mark.parametrize("part", [None, (5, 30)])
def test_the_gradient_of_several_effects_and_a_delay_on_every_key(part: tuple[int, int] | None) -> None:
    simulation = mg.simulate("wide", duration=40, seed=3)
    samples = preintegrate(simulation.recording, 1.0)
    n = len(samples.starts)
    current = np.eye(3)[:, :, None] * np.linspace(-1, 1, n) * 1e-6
    step = np.eye(3)[:, :, None] * (np.arange(n) > 12) * 1e-6
    scale = FORMS["gyro-scale"].columns(Signals(samples.gyroscope_time, rate=samples.angular_rate.T), {})
    factor = effect_chain_factor(
        S(0),
        H(0),
        B(0),
        [X(0), X(1), X(2)],
        samples,
        [current, scale, step],
        SensorNoise(1e-6, 5e-3),
        side=["magnetometer", "gyroscope", "magnetometer"],
        delay_key=V(0),
        part=part,
    )
    assert list(factor.keys()) == [S(0), H(0), B(0), X(0), X(1), X(2), V(0)]
    base = chained(simulation)
    base.insert(V(0), np.array([0.02]))
    base.insert(X(0), np.array([0.5, -1.0, 1.0]))
    base.insert(X(1), np.linspace(-0.02, 0.02, 6))
    base.insert(X(2), np.array([1.0, 0.3, -0.5]))
    jacobian, right = factor.linearize(base).jacobian()
    sizes = [6, 3, 3, 3, 6, 3, 1]
    assert 0.5 * right @ right == pytest.approx(factor.error(base), rel=1e-9)
    gradient = dict(zip(factor.keys(), np.split(-jacobian.T @ right, np.cumsum(sizes)[:-1]), strict=True))
    for key, size in zip(factor.keys(), sizes, strict=True):
        small = 1e-5 if key in (B(0), V(0), X(1)) else 1e-3
        for index in range(size):
            slope = 0.0
            for sign in (1, -1):
                change, moved = np.zeros(size), gtsam.Values(base)
                change[index] = sign * small
                is_point = key in (H(0), B(0))
                moved.update(key, (base.atPoint3(key) if is_point else base.atVector(key)) + change)
                slope += sign * factor.error(moved) / (2 * small)
            assert slope == pytest.approx(gradient[key][index], rel=3e-3, abs=2e-2), (key, index)


@pytest.mark.parametrize(
    ("name", "setting"),
    [
        ("hard-iron-step", {"time": 70.0}),
        ("hard-iron-drift", {"start": 0.0, "end": 120.0, "order": 3.0}),
        ("local-anomaly", {"time": 55.0, "width": 3.0}),
    ],
)
def test_stretches_hold_what_the_whole_holds(name: str, setting: dict[str, float]) -> None:
    """Four stretches, none of which determines the value, are the whole but for the links between them."""
    simulation = mg.simulate("wide", duration=120, seed=7)
    samples = preintegrate(simulation.recording, 1.0)
    windows = samples.integrate()
    columns = (
        FORMS[name].columns(Signals(windows.time, to_sensor=windows.rotation, soft_iron=np.eye(3)), setting) * 1e-6
    )
    edges = np.linspace(0, len(windows), 5).astype(int)
    keys, noise = (S(0), H(0), B(0), X(0)), SensorNoise(1e-6, 5e-3)
    stretches = gtsam.NonlinearFactorGraph()
    for part in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        stretches.push_back(effect_chain_factor(*keys, samples, columns, noise, part=part))
    samples.linked[edges[1:-1] - 1] = False
    whole = gtsam.NonlinearFactorGraph()
    whole.push_back(effect_chain_factor(*keys, samples, columns, noise))
    values = chained(simulation)
    values.insert(X(0), np.linspace(-0.5, 0.5, len(columns)))
    assert stretches.error(values) == pytest.approx(whole.error(values), rel=1e-5)
    order = gtsam.Ordering()
    for key in keys:
        order.push_back(key)
    (information, gradient), (expected, pull) = (
        graph.linearize(values).hessian(order) for graph in (stretches, whole)
    )
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(information / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-4)
    np.testing.assert_allclose(gradient / scale, pull / scale, atol=1e-4 * np.abs(pull / scale).max())
    found, wanted = optimize(stretches, values), optimize(whole, values)
    assert found.converged, found.message
    sigma = np.sqrt(np.diag(gtsam.Marginals(whole, wanted.values).marginalCovariance(X(0))))
    assert np.all(np.abs(found.values.atVector(X(0)) - wanted.values.atVector(X(0))) < 0.02 * sigma)
    assert np.all(np.abs(wanted.values.atVector(X(0))) < 4 * sigma)


def test_a_root_of_what_is_not_determined() -> None:
    rows = np.random.default_rng(8).standard_normal((4, 6)) * [1, 1e6, 1, 1e-6, 1, 0]
    root, pull = semidefinite_root(rows.T @ rows, rows.T @ np.ones(4), np.linalg.norm(rows, axis=0))
    np.testing.assert_allclose(root.T @ root, rows.T @ rows, rtol=1e-9)
    np.testing.assert_allclose(root.T @ pull, rows.sum(axis=0), rtol=1e-6)
    assert pull @ pull == pytest.approx(4)  # four equations for six unknowns can all be met
    assert np.linalg.matrix_rank(root) == 4


def test_effects_of_one_factor_are_as_many_as_their_keys() -> None:
    samples = preintegrate(mg.simulate("wide", duration=20, seed=3).recording, 1.0)
    columns = np.ones((1, 3, len(samples.starts))) * 1e-6
    noise = SensorNoise(1e-6, 5e-3)
    with pytest.raises(mg.MagycError, match="2 value keys, 1 columns"):
        effect_chain_factor(S(0), H(0), B(0), [X(0), X(1)], samples, [columns], noise)
    with pytest.raises(mg.MagycError, match="windows 4 to 6 of"):
        effect_chain_factor(S(0), H(0), B(0), X(0), samples, columns, noise, part=(4, 6))
    with pytest.raises(mg.MagycError, match="neither"):
        effect_chain_factor(S(0), H(0), B(0), X(0), samples, columns, noise, side="both")  # type: ignore[arg-type]
