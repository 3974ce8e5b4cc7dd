"""What would crash or mislead GTSAM is an exception, also from inside its optimisers."""

import gtsam
import numpy as np
import pytest

from magyc_gtsam.factors import (
    CompressedGyroDerivative,
    KeyframeBuffer,
    MagycError,
    NativeFactors,
    NonFiniteError,
    custom_factor,
    delay_prior,
    gyro_derivative_factor,
    hard_iron_walk,
    keyframe_field_factor,
    norm_prior,
    preintegrate,
    robust_noise,
    sphere_factor,
)
from magyc_gtsam.factors.chain.vech import unvech, vech
from magyc_gtsam.factors.guard import factor_details
from magyc_gtsam.factors.kernels import kernel
from magyc_gtsam.factors.variables import choose, direction, gyro_bias, vector

X, Y = gtsam.symbol("x", 0), gtsam.symbol("y", 0)
OPTIMIZERS = [gtsam.LevenbergMarquardtOptimizer, gtsam.DoglegOptimizer, gtsam.GaussNewtonOptimizer]


def graph_of(error, variable=None):
    graph = gtsam.NonlinearFactorGraph()
    graph.add(custom_factor("test", 1.0, [X], [variable or vector(3)], 3, error))
    values = gtsam.Values()
    values.insert(X, np.ones(3))
    return graph, values


WRONG = {
    "too few rows": (
        lambda x, want: (x, [np.eye(3)[:2]]),
        MagycError,
        r"\(2, 3\), expected float64 \(3, 3\)",
    ),
    "too many columns": (lambda x, want: (x, [np.ones((3, 4))]), MagycError, r"\(3, 4\)"),
    "one dimension": (lambda x, want: (x, [np.ones(3)]), MagycError, "Jacobian on x0"),
    "missing Jacobian": (lambda x, want: (x, []), MagycError, "0 Jacobians for 1 keys"),
    "integers": (lambda x, want: (x, [np.eye(3, dtype=int)]), MagycError, "int64"),
    "a list": (lambda x, want: ([1.0, 2.0, 3.0], [np.eye(3)]), MagycError, "residual is list"),
    "residual of a matrix": (lambda x, want: (x[:, None], [np.eye(3)]), MagycError, r"\(3, 1\)"),
    "NaN residual": (lambda x, want: (x * np.nan, [np.eye(3)]), NonFiniteError, "residual is nan"),
    "infinite Jacobian": (
        lambda x, want: (x, [np.full((3, 3), np.inf)]),
        NonFiniteError,
        "Jacobian on x0 is inf",
    ),
}


@pytest.mark.parametrize("optimizer", OPTIMIZERS)
@pytest.mark.parametrize("name", WRONG)
def test_wrong_error_functions_raise_through_the_optimizer(name, optimizer):
    error, kind, message = WRONG[name]
    graph, values = graph_of(error)
    with pytest.raises(kind, match=message):
        optimizer(graph, values).optimize()


def test_wrong_error_function_raises_through_isam2():
    graph, values = graph_of(WRONG["too few rows"][0])
    with pytest.raises(MagycError, match="test: Jacobian on x0"):
        gtsam.ISAM2().update(graph, values)


def test_exceptions_of_the_error_function_keep_their_type_and_text():
    def error(x, want_jacobians):
        raise ZeroDivisionError("as it was")

    graph, values = graph_of(error)
    with pytest.raises(ZeroDivisionError, match="as it was"):
        gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()


def test_variables_that_do_not_fit():
    graph, _ = graph_of(lambda x, want: (x, [np.eye(3)]))
    empty = gtsam.Values()
    with pytest.raises(MagycError, match=r"test: x0 has no value"):
        graph.error(empty)
    other = gtsam.Values()
    other.insert(X, gtsam.Rot3())
    with pytest.raises(MagycError, match="test: x0 holds a Rot3; accepted: Point3 or 3-vector"):
        graph.error(other)
    nan = gtsam.Values()
    nan.insert(X, np.array([1.0, np.nan, 0.0]))
    with pytest.raises(NonFiniteError, match="variable x0 is nan"):
        graph.error(nan)
    graph, values = graph_of(lambda x, want: (x[:3], [np.eye(3, 6)]), vector(6))
    with pytest.raises(MagycError, match="x0 holds 3 numbers, 6 are expected"):
        graph.error(values)


def test_construction_checks():
    def error(x, want_jacobians):
        return x, [np.eye(3)]

    with pytest.raises(MagycError, match="2 different keys"):
        custom_factor("test", 1.0, [X], [vector(3), vector(3)], 3, error)
    with pytest.raises(MagycError, match="2 different keys"):
        custom_factor("test", 1.0, [X, X], [vector(3), vector(3)], 3, error)
    with pytest.raises(MagycError, match="dimension 2 for a residual of 3"):
        custom_factor("test", gtsam.noiseModel.Unit.Create(2), [X], [vector(3)], 3, error)
    for sigma in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(MagycError, match="standard deviation"):
            custom_factor("test", sigma, [X], [vector(3)], 3, error)


def test_readers():
    values = gtsam.Values()
    values.insert(X, gtsam.Unit3(np.array([1.0, 2.0, 2.0])))
    values.insert(Y, gtsam.imuBias.ConstantBias(np.ones(3), np.array([4.0, 5.0, 6.0])))
    x, basis = choose("test", direction, values, X)(values, X)
    np.testing.assert_allclose(x, [1 / 3, 2 / 3, 2 / 3])
    np.testing.assert_allclose(basis.T @ x, 0, atol=1e-15)
    b, part = choose("test", gyro_bias, values, Y)(values, Y)
    np.testing.assert_allclose(b, [4, 5, 6])
    np.testing.assert_allclose(part @ np.arange(6.0), [3, 4, 5])


def test_a_factor_follows_its_key_into_a_graph_of_another_type():
    """The type is looked up once, and again where the same factor meets another."""
    factor = custom_factor("test", 1.0, [X], [gyro_bias], 3, lambda b, want: (b, [np.eye(3)]))
    for value in (np.ones(3), gtsam.imuBias.ConstantBias(np.zeros(3), np.ones(3)), np.ones(3)):
        values = gtsam.Values()
        values.insert(X, value)
        assert factor.error(values) == 1.5
        assert factor.linearize(values).jacobian()[0].shape[1] == values.dim()


def test_details_are_found_in_a_graph():
    details = object()
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(custom_factor("test", 1.0, [X], [vector(3)], 3, lambda x, want: (x, []), details=details))
    graph.push_back(
        gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [X], lambda this, values, h: values.atVector(X)[:1])
    )
    graph.addPriorVector(X, np.zeros(3), gtsam.noiseModel.Unit.Create(3))
    graph.push_back(custom_factor("plain", 1.0, [X], [vector(3)], 3, lambda x, want: (x, [])))
    assert [factor_details(graph.at(i)) for i in range(4)] == [details, None, None, "plain"]
    with pytest.raises(MagycError, match="x0 has no value"):
        graph.at(0).error(gtsam.Values())


GOOD = np.ones((4, 3))
KEYS = [gtsam.symbol(c, 0) for c in "ldb"]
WORLD = [20e-6, 0.0, 40e-6]  # T


def filled_buffer():
    buffer = KeyframeBuffer()
    buffer.add_rate(np.arange(0, 2, 0.01), np.full((200, 3), 0.1))
    buffer.add_field(np.arange(0, 2, 0.02), np.tile(WORLD, (100, 1)))
    return buffer


def block_alone():
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(keyframe_field_factor(*KEYS, filled_buffer().close(1.0), 1e-6, field=WORLD))
    return graph


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: gyro_derivative_factor(*KEYS, GOOD, GOOD[:3], GOOD, 1.0), "derivative: shape"),
        (lambda: gyro_derivative_factor(*KEYS, GOOD.T, GOOD, GOOD, 1.0), "magnetic_field: shape"),
        (
            lambda: gyro_derivative_factor(*KEYS, GOOD, GOOD, GOOD * np.nan, 1.0),
            "angular_rate: not finite in row 0",
        ),
        (lambda: gyro_derivative_factor(KEYS[0], KEYS[1], KEYS[1], GOOD, GOOD, GOOD, 1.0), "3 different keys"),
        (lambda: gyro_derivative_factor(*KEYS, GOOD, GOOD, GOOD, 1.0, robust="median"), "'median' unknown"),
        (
            lambda: gyro_derivative_factor(*KEYS, GOOD, GOOD, GOOD, robust_noise("huber", 1, 12, 2), robust="l1"),
            "one standard deviation",
        ),
        (lambda: gyro_derivative_factor(*KEYS, GOOD, GOOD, GOOD, -1.0, robust="l1"), "standard deviation"),
        (
            lambda: gyro_derivative_factor(*KEYS, GOOD, GOOD, GOOD, 1.0, robust="l1", tuning=0),
            "tuning constant 0",
        ),
        (lambda: sphere_factor(1.5, KEYS[1], KEYS[2], np.ones(3), 1.0), "sphere: 1.5 is not a key"),
        (lambda: sphere_factor(*KEYS, ["x", 0, 0], 1.0), "measurement: not an array of numbers"),
        (lambda: sphere_factor(*KEYS, np.ones(3), "x"), "standard deviation 'x'"),
        (lambda: hard_iron_walk(KEYS[0], KEYS[0], 1.0, 1e-7), "both keys are the same"),
        (lambda: hard_iron_walk(*KEYS[:2], "x", 1e-7), "over 'x' s"),
        (lambda: delay_prior(KEYS[0], sigma="x"), "standard deviation 'x'"),
        (lambda: KeyframeBuffer(delay=np.nan), "delay nan; it must be a finite number"),
        (lambda: filled_buffer().close(2.5), "add the gyroscope's samples up to the one after the keyframe"),
        (lambda: filled_buffer().close("x"), "the keyframe at 'x'"),
        (lambda: filled_buffer().close(1.0, [100.0, 0, 0]), "bias: an angular rate of 100 rad/s"),
        (lambda: keyframe_field_factor(*KEYS, None, 1e-6, field=WORLD), "`block` is a NoneType"),
        (lambda: NativeFactors(tolerance="x"), "tolerance 'x' must be above 0"),
        (lambda: NativeFactors().solve(block_alone(), gtsam.Values()), "no value for b0, d0, l0; insert one"),
        (lambda: CompressedGyroDerivative(np.ones((21, 21)), 1), "below the diagonal"),
        (lambda: CompressedGyroDerivative(np.ones((3, 21)), 1), r"shape \(3, 21\)"),
        (lambda: sphere_factor(*KEYS, np.ones(2), 1.0), "measurement: shape"),
        (lambda: sphere_factor(*KEYS, [0, 0, np.inf], 1.0), "measurement: not finite"),
        (lambda: sphere_factor(*KEYS, np.ones(3), 1.0, shape="round"), "'round' unknown"),
        (lambda: preintegrate([0, 1], GOOD[:2], 0, 2), "from 0.000 to 2.000 s"),
        (lambda: preintegrate([0, 0, 1], GOOD[:3], 0, 1), "ascending"),
        (lambda: preintegrate([0, 1], GOOD[:2], 1, 1), "from 1.000 to 1.000 s"),
        (
            lambda: preintegrate(np.r_[0:1:0.1, 3:4:0.1], np.ones((20, 3)), 0.5, 3.5),
            "pauses from 0.900 to 3.000 s",
        ),
        (lambda: preintegrate([], np.empty((0, 3)), 0, 1), "got none"),
        (lambda: kernel("tukey"), "l1, huber, cauchy, geman-mcclure"),
        (lambda: robust_noise("cauchy", 1.0, 6), "give `tuning`"),
        (lambda: vech(np.ones((2, 2))), "vech: shape"),
        (lambda: unvech(np.ones(5)), "unvech: shape"),
    ],
)
def test_wrong_measurements_raise_at_construction(build, message):
    with pytest.raises(MagycError, match=message):
        build()


def test_norm_prior_has_no_derivative_at_zero():
    values = gtsam.Values()
    values.insert(KEYS[0], np.zeros(6))
    with pytest.raises(MagycError, match="no derivative at l = 0"):
        norm_prior(KEYS[0], 1.0).error(values)
