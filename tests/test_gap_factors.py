"""Effects as terms of a calibration and as variables of a graph."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, H, S, V, X
from scipy.spatial.transform import Rotation
from test_factors_jacobians import derivative

import magyc_gtsam as mg
from magyc_gtsam.estimators.chain_search import preintegrate
from magyc_gtsam.factors.effect_factor import (
    effect_chain_factor,
    effect_magnetometer_factor,
    semidefinite_root,
)
from magyc_gtsam.factors.effects import FORMS, Term
from magyc_gtsam.factors.field_chain import Noise
from magyc_gtsam.factors.signals import Signals, channels_by_kind
from magyc_gtsam.factors.soft_iron import vech
from magyc_gtsam.gap import term_factor
from magyc_gtsam.runners.batch import optimize
from magyc_gtsam.runners.incremental import Incremental

SOFT = np.array([[1.05, 0.04, 0.0], [0.04, 0.95, 0.02], [0.0, 0.02, 1.01]])
HARD = np.array([2e-6, -12e-6, 9e-6])
BIAS = np.array([4e-3, -5e-3, 2e-3])


def signals(n: int = 50) -> Signals:
    random = np.random.default_rng(1)
    return Signals(
        np.arange(n) * 0.1,
        field=random.standard_normal((3, n)) * 3e-5,
        field_rate=random.standard_normal((3, n)) * 1e-5,
        hard_iron=HARD,
        rate=random.standard_normal((3, n)) * 0.3,
        to_sensor=np.repeat(np.eye(3)[:, :, None], n, axis=2),
        acceleration=random.standard_normal((3, n)) + np.array([[0.0], [0.0], [-9.8]]),
        channels={kind: random.standard_normal((2, n)) for kind in ("current", "temperature", "position")},
    )


SETTINGS = {
    "hard-iron-step": {"time": 2.0},
    "hard-iron-drift": {"order": 2.0, "start": 0.0, "end": 5.0},
    "eddy-plane": {"x": 0.6, "y": 0.0, "z": 0.8},
    "local-anomaly": {"time": 2.0, "width": 1.0},
    "saturation": {"level": 3e-5},
    "hysteresis": {"width": 1e-5},
    "tone": {"frequency": 1.3},
}


@pytest.mark.parametrize("name", FORMS)
def test_a_form_is_its_columns_times_its_value(name: str) -> None:
    at, setting = signals(), SETTINGS.get(name, {})
    columns = FORMS[name].columns(at, setting)
    assert columns.shape[1:] == (3, 50)
    value = np.linspace(1, 2, len(columns)) * (1e-3 if FORMS[name].rotates else 1.0)
    added = FORMS[name].evaluate(at, value, setting)
    linear = np.tensordot(value, columns, axes=1)
    # A rotation of axes is exact, its columns are the first order of it.
    np.testing.assert_allclose(
        added, linear, atol=(np.abs(linear).max() * (3e-3 if FORMS[name].rotates else 1e-12))
    )


def test_channels_are_known_by_their_names() -> None:
    found = channels_by_kind({"battery_current": np.ones(4), "Temp": np.zeros(4), "position": np.ones((4, 3))})
    assert {kind: rows.shape for kind, rows in found.items()} == {
        "current": (1, 4),
        "temperature": (1, 4),
        "position": (3, 4),
    }


def calibration(*terms: Term) -> mg.Calibration:
    return mg.Calibration(SOFT, HARD, BIAS, terms=terms, field_strength=5e-5)


def test_terms_survive_saving(tmp_path: Path) -> None:
    term = Term("hard-iron-step", [1e-6, 2e-6, 3e-6], np.diag([1e-16] * 3), {"time": 41.5})
    calibration(term).save(tmp_path / "cal.yaml")
    (loaded,) = mg.Calibration.load(tmp_path / "cal.yaml").terms
    assert loaded.name == term.name
    assert loaded.setting == {"time": 41.5}
    np.testing.assert_array_equal(loaded.value, term.value)
    np.testing.assert_array_equal(loaded.covariance, term.covariance)


def test_apply_takes_a_current_out() -> None:
    random = np.random.default_rng(3)
    u = random.standard_normal((40, 3)) * 3e-5
    current = random.uniform(0, 5, 40)
    value = np.array([1e-7, -2e-7, 3e-7])
    m = u @ SOFT.T + HARD + current[:, None] * value
    cal = calibration(Term("motor-current", value, np.eye(3) * 1e-18))
    np.testing.assert_allclose(cal.apply(m, channels={"current": current}), u, atol=1e-18)
    with pytest.raises(mg.MagycError, match="current"):
        cal.apply(m)


def test_apply_takes_a_cubic_response_out_without_any_channel() -> None:
    u = np.random.default_rng(4).standard_normal((40, 3)) * 3e-5
    clean = u @ SOFT.T + HARD
    value = np.array([5e-7, -5e-7, 3e-7])
    m = clean + value * (clean / 50e-6) ** 3
    cal = calibration(Term("cubic", value, np.eye(3) * 1e-18))
    np.testing.assert_allclose(cal.apply(m), u, atol=2e-10)
    np.testing.assert_allclose(cal.apply(m[0]), u[0], atol=2e-10)


def test_apply_brings_the_field_to_the_axes_of_the_gyroscope() -> None:
    angle = np.array([0.02, -0.03, 0.05])
    turn = gtsam.Rot3.Expmap(angle).matrix()
    u = np.random.default_rng(5).standard_normal((20, 3)) * 3e-5
    # w − b = Exp(v) ω with ω in the magnetometer's axes; so the field in the gyroscope's is Exp(v) u.
    cal = calibration(Term("misalignment", angle, np.eye(3) * 1e-8))
    np.testing.assert_allclose(cal.apply(u @ SOFT.T + HARD), u @ turn.T, atol=1e-18)


def test_apply_gyroscope_takes_a_scale_out() -> None:
    rate = np.random.default_rng(6).standard_normal((30, 3)) * 0.5
    scale = np.array([0.02, -0.01, 0.015, 0.003, -0.002, 0.001])
    x, y, z = rate.T
    error = np.stack(
        [
            scale[0] * x + scale[3] * y + scale[4] * z,
            scale[1] * y + scale[3] * x + scale[5] * z,
            scale[2] * z + scale[4] * x + scale[5] * y,
        ],
        axis=1,
    )
    cal = calibration(Term("gyro-scale", scale, np.eye(6) * 1e-8))
    np.testing.assert_allclose(cal.apply_gyroscope(rate + error + BIAS), rate, atol=1e-9)


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
    noise = Noise(1e-6, 5e-3)
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
    factor = effect_chain_factor(S(0), H(0), B(0), X(0), samples, columns, Noise(1e-6, 5e-3), side=side)
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
        noise = Noise(1e-6, 5e-3)
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
    chain = effect_chain_factor(S(0), H(0), B(0), V(0), samples, columns, Noise(1e-6, 5e-3), soft_iron_unit=unit)
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
                [X(k), S(0), H(0), V(0)], reading, np.eye(3) * current[row] * 1e-6, 1e-6, field=field
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
        [X(0), S(0), H(0), V(0)],
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


@pytest.mark.parametrize("name", ["motor-current", "temperature-gyro"])
def test_what_gap_named_is_a_factor(name: str) -> None:
    """Two stretches of the log share it, and give the value that the search gave, one after the other on iSAM2."""
    simulation = mg.simulate("wide", duration=300, seed=2, effects=[(name, 2.0)])
    found = mg.find_gap(simulation.recording).calibration
    (term,) = found.terms
    truth, strength = simulation.truth, found.field_strength
    assert strength is not None
    initial = gtsam.Values()
    initial.insert(S(0), vech(truth.soft_iron) * strength * 1e6)
    initial.insert(H(0), gtsam.Point3(*(truth.hard_iron * 1e6)))
    initial.insert(B(0), gtsam.Point3(0, 0, 0))
    initial.insert(X(0), np.zeros(3))
    runner = Incremental()
    for first in (0, 150):
        stretch = simulation.recording.between(first, first + 150)
        graph = gtsam.NonlinearFactorGraph()
        graph.push_back(term_factor(stretch, found, term, (S(0), H(0), B(0), X(0))))
        result = runner.update(graph, initial if first == 0 else gtsam.Values())
        assert result.updated, result.message
    value = runner.values.atVector(X(0))
    assert np.all(np.abs(value - term.value) < 1.5 * term.sigma)
    with pytest.raises(mg.MagycError, match="field_chain_factor"):
        term_factor(simulation.recording, found, Term("timing", [0.01], [[1e-6]]), (S(0), H(0), B(0), X(0)))


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
        Noise(1e-6, 5e-3),
        side=["magnetometer", "gyroscope", "magnetometer"],
        delay_key=V(0),
        part=part,
    )
    assert list(factor.keys()) == [S(0), H(0), B(0), V(0), X(0), X(1), X(2)]
    base = chained(simulation)
    base.insert(V(0), np.array([0.02]))
    base.insert(X(0), np.array([0.5, -1.0, 1.0]))
    base.insert(X(1), np.linspace(-0.02, 0.02, 6))
    base.insert(X(2), np.array([1.0, 0.3, -0.5]))
    jacobian, right = factor.linearize(base).jacobian()
    sizes = [6, 3, 3, 1, 3, 6, 3]
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
    columns = FORMS[name].columns(Signals(windows.time, to_sensor=windows.rotation), setting) * 1e-6
    edges = np.linspace(0, len(windows), 5).astype(int)
    keys, noise = (S(0), H(0), B(0), X(0)), Noise(1e-6, 5e-3)
    stretches = gtsam.NonlinearFactorGraph()
    for part in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        stretches.push_back(effect_chain_factor(*keys, samples, columns, noise, part=part))
    samples.linked[edges[1:-1] - 1] = False
    whole = gtsam.NonlinearFactorGraph()
    whole.push_back(effect_chain_factor(*keys, samples, columns, noise))
    values = chained(simulation)
    values.insert(X(0), np.linspace(-0.5, 0.5, len(columns)))
    assert stretches.error(values) == pytest.approx(whole.error(values), rel=1e-6)
    order = gtsam.Ordering()
    for key in keys:
        order.push_back(key)
    (information, gradient), (expected, pull) = (
        graph.linearize(values).hessian(order) for graph in (stretches, whole)
    )
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(information / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5)
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
    noise = Noise(1e-6, 5e-3)
    with pytest.raises(mg.MagycError, match="2 value keys, 1 columns"):
        effect_chain_factor(S(0), H(0), B(0), [X(0), X(1)], samples, [columns], noise)
    with pytest.raises(mg.MagycError, match="windows 4 to 6 of"):
        effect_chain_factor(S(0), H(0), B(0), X(0), samples, columns, noise, part=(4, 6))
    with pytest.raises(mg.MagycError, match="neither"):
        effect_chain_factor(S(0), H(0), B(0), X(0), samples, columns, noise, side="both")  # type: ignore[arg-type]


def deviations(
    recording: mg.Recording, found: mg.Calibration, length: float
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """What a graph of stretches of this length finds of all terms: its difference, in sigmas, and its sigmas."""
    terms = found.terms
    keys = [S(0), H(0), B(0), *(X(i) for i in range(len(terms)))]
    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for start in np.arange(0, recording.duration, length):
        graph.push_back(term_factor(recording, found, terms, keys, between=(start, start + length)))
    assert found.field_strength is not None
    assert found.gyro_bias is not None
    initial.insert(S(0), vech(found.soft_iron) * found.field_strength * 1e6)
    initial.insert(H(0), gtsam.Point3(*(found.hard_iron * 1e6)))
    initial.insert(B(0), gtsam.Point3(*found.gyro_bias))
    for i, term in enumerate(terms):
        initial.insert(X(i), np.zeros(len(term.value)))
    result = optimize(graph, initial)
    assert result.converged, result.message
    marginals = gtsam.Marginals(graph, result.values)
    return (
        [(result.values.atVector(X(i)) - term.value) / term.sigma for i, term in enumerate(terms)],
        [np.sqrt(np.diag(marginals.marginalCovariance(X(i)))) / term.sigma for i, term in enumerate(terms)],
    )


@pytest.mark.parametrize(
    "name", ["temperature-hard-iron", "temperature-gyro", "hard-iron-step", "hard-iron-drift", "local-anomaly"]
)
def test_stretches_of_a_minute_share_what_was_found_in_the_whole(name: str) -> None:
    """What acts late, once, or over the whole recording: the value is the one of the whole but for the links lost."""
    recording = mg.simulate("wide", duration=300, seed=2, effects=[(name, 2.0)]).recording
    found = mg.find_gap(recording).calibration
    assert [term.name for term in found.terms] == [name]
    (difference,), (sigma,) = deviations(recording, found, 60.0)
    assert np.all(np.abs(difference) < 0.7)
    assert np.all(np.abs(sigma - 1) < 0.1)


@pytest.mark.parametrize("length", [600.0, 100.0])
def test_two_effects_of_one_recording_are_one_factor(length: float) -> None:
    effects = [("motor-current", 2.0), ("misalignment", 2.0)]
    recording = mg.simulate("wide", duration=600, seed=2, effects=effects, channels=["current"]).recording
    found = mg.find_gap(recording).calibration
    assert {term.name for term in found.terms} == {"motor-current", "misalignment"}
    differences, sigmas = deviations(recording, found, length)
    for difference, sigma in zip(differences, sigmas, strict=True):
        assert np.all(np.abs(difference) < 1.0)
        assert np.all(np.abs(sigma - 1) < 0.05)


def test_a_timing_beside_another_effect_is_the_delay_of_their_factor() -> None:
    effects = [("motor-current", 2.0), ("timing", 4.0)]
    recording = mg.simulate("wide", duration=300, rate=20, seed=2, effects=effects).recording
    found = mg.find_gap(recording).calibration
    assert {term.name for term in found.terms} == {"motor-current", "timing"}
    differences, _ = deviations(recording, found, 300.0)
    assert np.all(np.abs(np.concatenate(differences)) < 0.1)


def test_what_is_no_variable_of_a_factor_is_refused() -> None:
    recording = mg.simulate("wide", duration=60, seed=2).recording
    cal = calibration()
    keys = (S(0), H(0), B(0), X(0))
    tone = Term("tone", np.ones(6) * 1e-7, np.eye(6), {"frequency": 1.5})
    with pytest.raises(mg.MagycError, match=r"silenced\(recording"):
        term_factor(recording, cal, tone, keys)
    step = Term("hard-iron-step", np.zeros(3), np.eye(3), {"time": 20.0})
    with pytest.raises(mg.MagycError, match="4 keys for 2 terms, expected 5"):
        term_factor(recording, cal, [step, step], keys)
    with pytest.raises(mg.MagycError, match="lacks field strength or noise"):
        term_factor(recording, cal, step, keys)
    with pytest.raises(mg.MagycError, match="at least 3"):
        term_factor(
            recording,
            replace(cal, noise={"magnetic_field": 1e-6, "angular_rate": 5e-3}),
            step,
            keys,
            between=(58, 59),
        )
