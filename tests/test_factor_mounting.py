"""The skew between the chips as a variable: one mounting key, of samples, field chains and chains with effects."""

import gtsam
import numpy as np
import pytest

from magyc_gtsam import calibrate
from magyc_gtsam.estimators.smoother.preparation import preintegrate
from magyc_gtsam.factors import (
    SensorNoise,
    effect_chain_factor,
    field_chain_factor,
    magnetometer_factor,
    mounting_prior,
    native_factor,
    vech,
)
from magyc_gtsam.study.known import skewed

SOFT, HARD, BIAS, MOUNTED, LATE, VALUE = (gtsam.symbol(c, 0) for c in "khbmtv")
NOISE = SensorNoise(1e-6, 5e-3)
STEP = {SOFT: 1e-2, HARD: 1e-2, BIAS: 1e-5, MOUNTED: 1e-4, LATE: 1e-4, VALUE: 1e-3}


@pytest.fixture(scope="module")
def misaligned():
    """Chips 1.2° misaligned on wide motion: simulation, samples in windows, ε."""
    simulation = skewed("wide", 1.2, 4)
    recording = simulation.recording.between(0, 200)
    axis = np.random.default_rng(4).normal(size=3)
    return simulation, recording, preintegrate(recording), np.radians(1.2) * axis / np.linalg.norm(axis)


def values_at(simulation, mounting, late=True):
    """Some sigmas off, so that no gradient is zero."""
    truth, values = simulation.truth, gtsam.Values()
    values.insert(SOFT, vech(truth.soft_iron) * truth.field_strength * 1e6 + 0.2)
    values.insertPoint3(HARD, truth.hard_iron * 1e6 + [-0.3, 0.4, 0.3])
    values.insertPoint3(BIAS, truth.gyro_bias + [2e-4, -1e-4, 2e-4])
    values.insert(MOUNTED, mounting)
    if late:
        values.insert(LATE, np.array([2e-3]))
    return values


def check_gradient(factor, values):
    jacobian, right = factor.linearize(values).jacobian()
    gradient, row = -jacobian.T @ right, 0
    assert 0.5 * right @ right == pytest.approx(factor.error(values), rel=1e-9)
    for key in list(factor.keys()):
        for unit in np.eye(values.zeroVectors().at(key).size):
            errors = []
            for sign in (1, -1):
                delta = gtsam.VectorValues()
                delta.insert(key, sign * STEP[key] * unit)
                errors.append(factor.error(values.retract(delta)))
            numeric = (errors[0] - errors[1]) / (2 * STEP[key])
            # Half a percent of the column's size: bias and delay are derivatives to first order only.
            size = np.linalg.norm(jacobian[:, row]) * np.sqrt(2 * factor.error(values))
            assert gradient[row] == pytest.approx(numeric, rel=5e-3, abs=2.5e-4 * size + 1e-4), (
                gtsam.DefaultKeyFormatter(key),
                unit,
            )
            row += 1
    assert row == jacobian.shape[1]


@pytest.mark.parametrize("delay_key", [LATE, None])
@pytest.mark.parametrize("turn", [0.0, 0.8])
def test_the_chains_gradient_is_the_derivative_of_its_error(misaligned, delay_key, turn):
    """Near the truth, and with a mounting so far off that its curvature counts."""
    simulation, _, samples, angle = misaligned
    factor = field_chain_factor(
        SOFT, HARD, BIAS, samples, NOISE, mounting_key=MOUNTED, delay_key=delay_key, delay=2e-3
    )
    assert list(factor.keys()) == [SOFT, HARD, BIAS, MOUNTED] + ([] if delay_key is None else [LATE])
    mounting = gtsam.Rot3.Expmap(-angle + [2e-3, -3e-3, 2e-3]).compose(gtsam.Rot3.Yaw(turn))
    check_gradient(factor, values_at(simulation, mounting, late=delay_key is not None))


@pytest.mark.parametrize("side", ["magnetometer", "gyroscope"])
def test_the_gradient_of_a_chain_with_an_effect(misaligned, side):
    simulation, _, samples, angle = misaligned
    rows = len(samples.starts) if side == "magnetometer" else len(samples.gyroscope_time)
    unit = 1e-6 if side == "magnetometer" else 1e-3
    columns = unit * np.sin(np.arange(3 * rows).reshape(1, 3, rows) / 50.0)
    factor = effect_chain_factor(
        SOFT, HARD, BIAS, VALUE, samples, columns, NOISE, side=side, mounting_key=MOUNTED, delay_key=LATE
    )
    assert list(factor.keys()) == [SOFT, HARD, BIAS, VALUE, MOUNTED, LATE]
    values = values_at(simulation, gtsam.Rot3.Expmap(-angle + [2e-3, -3e-3, 2e-3]))
    values.insert(VALUE, np.array([0.5]))
    check_gradient(factor, values)


def test_a_graph_with_the_mounting_is_the_smoother_with_the_skew(misaligned):
    """From no skew; the prior of 1° is that of `misalignment`."""
    simulation, recording, samples, angle = misaligned
    degree = np.radians(1.0)
    options = {"noise": NOISE, "robust": False, "delay": 0.0, "turn": samples.turn, "window": samples.length}
    expected = calibrate(recording, misalignment=degree, **options)
    graph = gtsam.NonlinearFactorGraph()
    factor = field_chain_factor(SOFT, HARD, BIAS, samples, NOISE, mounting_key=MOUNTED)
    graph.add(factor)
    graph.add(mounting_prior(MOUNTED, sigma=degree))
    tight = gtsam.LevenbergMarquardtParams()
    tight.setRelativeErrorTol(1e-12)
    values = gtsam.LevenbergMarquardtOptimizer(
        graph, values_at(simulation, gtsam.Rot3(), late=False), tight
    ).optimize()
    (term,) = expected.terms
    found = -gtsam.Rot3.Logmap(values.atRot3(MOUNTED))
    assert (np.abs(found + term.value) < 0.02 * term.sigma).all()
    assert (np.abs(found - angle) < 4 * term.sigma).all()
    off = (values.atPoint3(HARD) * 1e-6 - expected.hard_iron) / expected.sigma["hard_iron"]
    assert np.abs(off).max() < 0.02
    native = native_factor(factor, values)
    assert list(native.keys()) == list(factor.keys())
    assert native.error(values) == pytest.approx(factor.error(values), rel=1e-6)


def test_samples_take_the_same_variable(misaligned):
    """One key may be shared: the mounting of the chain's term fits a sample on an attitude."""
    simulation, recording, _, angle = misaligned
    calibration = calibrate(recording)
    (term,) = calibration.terms
    field = np.array([20e-6, 0.0, 40e-6])
    rotation = gtsam.Rot3.Ypr(0.3, -0.2, 0.5)
    turn = gtsam.Rot3.Expmap(angle).matrix()
    reading = simulation.truth.soft_iron @ turn @ rotation.matrix().T @ field + simulation.truth.hard_iron
    factor = magnetometer_factor(0, SOFT, HARD, reading, 1e-6, field=field, mounting_key=MOUNTED)
    values = gtsam.Values()
    values.insert(0, rotation)
    values.insert(SOFT, vech(simulation.truth.soft_iron))
    values.insertPoint3(HARD, simulation.truth.hard_iron * 1e6)
    errors = []
    for mounting in (gtsam.Rot3.Expmap(-angle), gtsam.Rot3.Expmap(term.value), gtsam.Rot3()):
        values.insert_or_assign(MOUNTED, mounting)
        errors.append(factor.error(values))
    assert errors[0] < 1e-12
    assert errors[1] < 0.02 * errors[2]
