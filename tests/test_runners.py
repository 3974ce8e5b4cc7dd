"""The batch runner: every way to end, and that it says so."""

import gtsam
import numpy as np
import pytest

from magyc_gtsam.factors import MagycError, custom_factor
from magyc_gtsam.factors.variables import vector
from magyc_gtsam.runners import Status, optimize

X, Y = gtsam.symbol("x", 0), gtsam.symbol("y", 0)
METHODS = ["lm", "dogleg", "gauss-newton"]


def problem(error, rows=2, start=(0.5, 1.0)):
    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(custom_factor("test", 1.0, [X], [vector(2)], rows, error))
    initial.insert(X, np.array(start, dtype=float))
    return graph, initial


def rosenbrock(x, want_jacobians):
    jacobian = np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), [jacobian]


@pytest.mark.parametrize("method", METHODS)
def test_converges_and_tells_each_iteration(method):
    seen = []
    graph, initial = problem(rosenbrock)
    result = optimize(graph, initial, method, progress=lambda i, error: seen.append((i, error)))
    assert result.converged
    assert result.status is Status.CONVERGED
    np.testing.assert_allclose(result.values.atVector(X), [1, 1], atol=1e-3)
    assert seen == list(enumerate(result.errors))[1:]
    assert result.iterations == len(seen)
    assert min(result.errors) == pytest.approx(graph.error(result.values))
    np.testing.assert_array_equal(initial.atVector(X), [0.5, 1.0])


@pytest.mark.parametrize("method", METHODS)
def test_start_at_the_minimum(method):
    result = optimize(*problem(rosenbrock, start=(1, 1)), method)
    assert result.converged
    assert result.errors[-1] == 0


def test_more_iterations_than_allowed():
    result = optimize(*problem(rosenbrock), "lm", max_iterations=2)
    assert result.status is Status.MAX_ITERATIONS
    assert result.iterations == 2
    assert "after 2 iterations" in result.message
    assert not optimize(*problem(rosenbrock), max_iterations=0).converged


@pytest.mark.parametrize("method", METHODS)
def test_nan_of_a_native_factor_at_the_start(method):
    graph, initial = problem(rosenbrock)
    graph.addPriorVector(X, np.array([np.nan, 0.0]), gtsam.noiseModel.Unit.Create(2))
    result = optimize(graph, initial, method)
    assert result.status is Status.FAILED
    assert "nan at the initial values" in result.message


@pytest.mark.parametrize("method", METHODS)
def test_nan_on_the_way(method):
    def error(x, want_jacobians):
        return x if x[0] > 0.9 else x * np.nan, [np.eye(2)]

    result = optimize(*problem(error, start=(1, 1)), method)
    assert result.status is Status.FAILED
    assert "residual is nan" in result.message
    np.testing.assert_array_equal(result.values.atVector(X), [1, 1])


@pytest.mark.parametrize("method", METHODS)
def test_nan_of_an_unguarded_factor_on_the_way(method):
    def error(this, values, jacobians):
        x = values.atVector(X)
        if jacobians is not None:
            jacobians[0] = np.eye(2)
        return x if x[0] > 0.9 else x * np.nan

    _, initial = problem(rosenbrock, start=(1, 1))
    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(2), [X], error))
    result = optimize(graph, initial, method)
    assert result.status in (Status.FAILED, Status.STALLED)
    assert np.isfinite(graph.error(result.values))


@pytest.mark.parametrize("method", METHODS)
def test_no_step_lowers_the_error(method):
    """A Jacobian of the wrong sign: GTSAM itself would report success at the start."""
    result = optimize(*problem(lambda x, want: (x, [-np.eye(2)])), method)
    assert result.status is Status.STALLED
    assert "is predicted" in result.message
    np.testing.assert_array_equal(result.values.atVector(X), [0.5, 1.0])


def test_gauss_newton_that_runs_away_returns_the_best_values():
    def error(x, want_jacobians):
        return np.arctan(x), [np.diag(1 / (1 + x**2))]

    graph, initial = problem(error, start=(1.5, 1.5))
    result = optimize(graph, initial, "gauss-newton")
    assert result.status is Status.STALLED
    assert "use 'lm' or 'dogleg'" in result.message
    assert graph.error(result.values) == min(result.errors)
    assert optimize(graph, initial, "lm").converged


@pytest.mark.parametrize("method", METHODS)
def test_an_undetermined_variable_is_named(method):
    graph, initial = problem(lambda x, want: (x[:1] - 1, [np.array([[1.0, 0.0]])]), rows=1)
    result = optimize(graph, initial, method)
    assert result.status is Status.INDETERMINATE
    assert result.message.startswith("x0 is not determined")
    named = optimize(graph, initial, method, names={X: "the soft iron"})
    assert named.message.startswith("the soft iron is not determined")


@pytest.mark.parametrize("method", METHODS)
def test_interrupt_between_iterations_returns_the_best_values(method):
    def stop(iteration, error):
        if iteration == 1:
            raise KeyboardInterrupt

    graph, initial = problem(rosenbrock)
    result = optimize(graph, initial, method, progress=stop)
    assert result.status is Status.INTERRUPTED
    assert graph.error(result.values) == pytest.approx(min(result.errors))


@pytest.mark.parametrize("method", METHODS)
def test_interrupt_inside_an_error_function(method):
    calls = []

    def error(x, want_jacobians):
        calls.append(x)
        if len(calls) > 3:
            raise KeyboardInterrupt
        return rosenbrock(x, want_jacobians)

    result = optimize(*problem(error), method)
    assert result.status is Status.INTERRUPTED
    assert "best values so far" in result.message


def test_wrong_arguments_and_programming_errors_raise():
    graph, initial = problem(rosenbrock)
    with pytest.raises(MagycError, match="'newton' unknown; there are lm, dogleg"):
        optimize(graph, initial, "newton")
    with pytest.raises(MagycError, match="no initial value for x0"):
        optimize(graph, gtsam.Values())
    with pytest.raises(MagycError, match="Jacobian on x0"):
        optimize(*problem(lambda x, want: (x, [np.eye(3)])))

    def broken(iteration, error):
        raise OSError("display gone")

    with pytest.raises(OSError, match="display gone"):
        optimize(graph, initial, progress=broken)
