"""The incremental runner: a graph that grows gives a batch's estimate, and every failure leaves it whole."""

import gtsam
import numpy as np
import pytest

from magyc_gtsam.factors import MagycError, custom_factor, robust_noise
from magyc_gtsam.factors.variables import vector
from magyc_gtsam.runners import Incremental, Status, optimize

X, Y = gtsam.symbol("x", 0), gtsam.symbol("y", 0)
METHODS = ["dogleg", "gauss-newton"]
TRUTH = np.array([1.2, 0.7])


def values(**vectors):
    result = gtsam.Values()
    for name, value in vectors.items():
        result.insert(gtsam.symbol(name, 0), np.array(value, dtype=float))
    return result


def wave(x, t, y, noise=1.0, key=X):
    """y = x0 sin(x1 t): nonlinear in x, one row."""

    def error(x, want_jacobians):
        jacobian = np.array([[np.sin(x[1] * t), x[0] * t * np.cos(x[1] * t)]])
        return np.array([x[0] * np.sin(x[1] * t) - y]), [jacobian]

    return custom_factor("wave", noise, [key], [vector(2)], 1, error)


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(0)
    t = rng.uniform(0, 3, 60)
    return t, TRUTH[0] * np.sin(TRUTH[1] * t) + 0.05 * rng.normal(size=60)


def factors_of(samples, noise=0.05):
    return [wave(X, t, y, noise) for t, y in zip(*samples, strict=True)]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("factorization", ["cholesky", "qr"])
def test_it_ends_where_a_batch_does(method, factorization, samples):
    factors = factors_of(samples)
    runner = Incremental(method, factorization=factorization)
    for first in range(0, 60, 6):
        result = runner.update(factors[first : first + 6], values(x=[1, 1]), steps=20)
        assert result.status is Status.CONVERGED, result.message
        assert len(result.factors) == 6
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    batch = optimize(graph, values(x=[1, 1]), relative_tolerance=1e-14, absolute_tolerance=1e-14)
    np.testing.assert_allclose(runner.values.atVector(X), batch.values.atVector(X), atol=1e-8)
    assert runner.error() == pytest.approx(min(batch.errors), rel=1e-12)
    marginal = gtsam.Marginals(graph, batch.values).marginalCovariance(X)
    np.testing.assert_allclose(runner.covariance(X), marginal, rtol=1e-5)


def test_one_step_per_update_lags_and_arrives(samples):
    """As in the paper; an update without factors makes one more step."""
    runner = Incremental()
    first = runner.update(factors_of(samples), values(x=[1, 1]))
    assert first.status is Status.MAX_ITERATIONS
    assert "still moving" in first.message
    for _ in range(20):
        result = runner.update()
    assert result.status is Status.CONVERGED
    assert result.factors == ()
    np.testing.assert_allclose(runner.values.atVector(X), TRUTH, atol=0.05)


@pytest.mark.parametrize("method", METHODS)
def test_a_factor_takes_the_place_of_another(method, samples):
    """The samples of all updates in one stacked factor, which each update replaces."""

    def stacked(t, y):
        def error(x, want_jacobians):
            jacobian = np.stack([np.sin(x[1] * t), x[0] * t * np.cos(x[1] * t)], axis=1)
            return x[0] * np.sin(x[1] * t) - y, [jacobian]

        return custom_factor("waves", 0.05, [X], [vector(2)], len(t), error)

    one, many, held = Incremental(method), Incremental(method), ()
    each = factors_of(samples)
    for n in range(6, 61, 6):
        held = one.update([stacked(samples[0][:n], samples[1][:n])], values(x=[1, 1]), remove=held).factors
        many.update(each[n - 6 : n], values(x=[1, 1]))
        np.testing.assert_allclose(one.values.atVector(X), many.values.atVector(X), atol=1e-10)
    assert list(one.factors) == list(held)
    assert len(many.factors) == 60


def test_handles_outlive_what_isam2_does_with_its_places(samples):
    factors = factors_of(samples)
    runner = Incremental()
    first = runner.update(factors[:10], values(x=[1, 1])).factors
    second = runner.update(factors[10:20], remove=first[:4]).factors
    third = runner.update(factors[20:30], remove=(*first[4:], *second[5:])).factors
    left = runner.factors
    assert list(left) == [*second[:5], *third]
    assert [left[handle] for handle in second[:5]] == factors[10:15]
    runner.update(steps=20)
    graph = gtsam.NonlinearFactorGraph()
    for factor in (*factors[10:15], *factors[20:30]):
        graph.add(factor)
    batch = optimize(graph, values(x=[1, 1]), relative_tolerance=1e-14, absolute_tolerance=1e-14)
    np.testing.assert_allclose(runner.values.atVector(X), batch.values.atVector(X), atol=1e-8)
    with pytest.raises(MagycError, match=f"no factor {first[0]} in the graph"):
        runner.update(remove=first[:1])


def test_a_variable_goes_with_its_last_factor(samples):
    runner = Incremental()
    runner.update(factors_of(samples)[:10], values(x=[1, 1]))
    prior = gtsam.PriorFactorVector(Y, np.ones(2), gtsam.noiseModel.Unit.Create(2))
    handles = runner.update([prior], values(y=[0, 0], x=[5, 5])).factors
    np.testing.assert_allclose(runner.values.atVector(Y), [1, 1], atol=1e-9)
    runner.update(remove=handles)
    assert not runner.values.exists(Y)
    assert runner.update(steps=10).status is Status.CONVERGED
    with pytest.raises(MagycError, match="y0 is not in the graph"):
        runner.covariance(Y)
    assert runner.update([prior], values(y=[0, 0])).updated


@pytest.mark.parametrize("method", METHODS)
def test_what_is_not_determined_yet_waits(method):
    """Nothing of the update is taken; the same factors with one more are."""
    half = custom_factor("half", 1.0, [Y], [vector(2)], 1, lambda y, want: (y[:1] - 2, [np.array([[1.0, 0.0]])]))
    other = custom_factor("half", 1.0, [Y], [vector(2)], 1, lambda y, want: (y[1:] - 3, [np.array([[0.0, 1.0]])]))
    prior = gtsam.PriorFactorVector(X, np.ones(2), gtsam.noiseModel.Unit.Create(2))
    runner = Incremental(method, names={Y: "the hard iron"}, radius=100)
    assert runner.update([half], values(y=[0, 0])).status is Status.INDETERMINATE  # in an empty graph
    assert runner.update([prior], values(x=[0, 0])).updated
    result = runner.update([half], values(y=[0, 0]))
    assert result.status is Status.INDETERMINATE
    assert "the hard iron is not determined; add data" in result.message
    assert not result.updated
    assert result.factors == ()
    assert not runner.values.exists(Y)
    assert len(runner.factors) == 1
    assert runner.update([half, other], values(y=[0, 0]), steps=5).status is Status.CONVERGED
    np.testing.assert_allclose(runner.values.atVector(Y), [2, 3])
    np.testing.assert_allclose(runner.values.atVector(X), [1, 1])


def test_a_factor_that_fails_leaves_the_graph_as_it_was(samples):
    factors = factors_of(samples)
    runner, whole = Incremental(), Incremental()
    for each in (runner, whole):
        each.update(factors[:20], values(x=[1, 1]), steps=20)
    before = runner.values.atVector(X)
    bad = custom_factor("bad", 1.0, [X], [vector(2)], 2, lambda x, want: (x * np.nan, [np.eye(2)]))
    result = runner.update([factors[20], bad], remove=[3])
    assert result.status is Status.FAILED
    assert "residual is nan" in result.message
    native = gtsam.PriorFactorVector(X, np.array([np.nan, 0.0]), gtsam.noiseModel.Unit.Create(2))
    assert runner.update([native]).status in (Status.FAILED, Status.INDETERMINATE)

    def stop(x, want_jacobians):
        raise KeyboardInterrupt

    assert runner.update([custom_factor("stop", 1.0, [X], [vector(2)], 2, stop)]).status is Status.INTERRUPTED
    wrong = custom_factor("wrong", 1.0, [X], [vector(2)], 2, lambda x, want: (x[:1], [np.eye(2)]))
    with pytest.raises(MagycError, match=r"residual is float64 \(1,\)"):
        runner.update([wrong])
    np.testing.assert_array_equal(runner.values.atVector(X), before)
    assert len(runner.factors) == 20
    for each in (runner, whole):
        each.update(factors[20:], steps=20)
    np.testing.assert_allclose(runner.values.atVector(X), whole.values.atVector(X), atol=1e-9)


def test_no_step_that_lowers_the_error_is_not_called_converged():
    """A Jacobian of the wrong sign shrinks the trust region to nothing."""
    wrong = custom_factor("wrong", 1.0, [X], [vector(2)], 2, lambda x, want: (x, [-np.eye(2)]))
    runner = Incremental()
    result = runner.update([wrong], values(x=[0.5, 1.0]), steps=50)
    assert result.status is Status.STALLED
    assert "is predicted" in result.message
    assert result.updated


@pytest.mark.parametrize("name", ["huber", "cauchy", "geman-mcclure", "l1"])
@pytest.mark.parametrize("method", METHODS)
def test_robust_noise_models(name, method, samples):
    """A fifth of the samples are far off; the estimate is the batch's under the same kernel, near the truth."""
    t, y = samples
    y = y.copy()
    y[::5] += 1.0
    noise = robust_noise(name, 0.05, 1)
    factors = [wave(X, *each, noise) for each in zip(t, y, strict=True)]
    runner = Incremental(method)
    for first in range(0, 60, 6):
        result = runner.update(factors[first : first + 6], values(x=[1.1, 0.8]))
    result = runner.update(steps=500)
    assert result.status is Status.CONVERGED, result.message
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    assert runner.error() == pytest.approx(graph.error(runner.values))
    batch = optimize(graph, runner.values, "lm")  # none is lower nearby
    assert batch.errors[0] - min(batch.errors) < 1e-5
    plain = Incremental(method)
    plain.update(factors_of((t, y)), values(x=[1.1, 0.8]), steps=50)
    errors = [np.linalg.norm(each.values.atVector(X) - TRUTH) for each in (runner, plain)]
    assert errors[0] < 0.4 * errors[1]


def test_rise_survives_a_start_from_which_gauss_newton_runs_away():
    def error(x, want_jacobians):
        return np.arctan(x), [np.diag(1 / (1 + x**2))]

    far = custom_factor("arctan", 1.0, [X], [vector(2)], 2, error)
    rise, plain = Incremental("dogleg"), Incremental("gauss-newton")
    assert rise.update([far], values(x=[3, 3]), steps=50).status is Status.CONVERGED
    np.testing.assert_allclose(rise.values.atVector(X), 0, atol=1e-7)
    assert plain.update([far], values(x=[3, 3]), steps=50).status is not Status.CONVERGED


def test_what_makes_no_sense_is_refused(samples):
    with pytest.raises(MagycError, match="optimizer 'lm' unknown"):
        Incremental("lm")
    with pytest.raises(MagycError, match="factorization 'lu' unknown"):
        Incremental(factorization="lu")
    with pytest.raises(MagycError, match="relinearize_threshold: must be finite and not negative, got -1"):
        Incremental(relinearize_threshold=-1)
    with pytest.raises(MagycError, match="radius: must be finite and above 0, got 0"):
        Incremental(radius=0)
    runner = Incremental()
    with pytest.raises(MagycError, match="no initial value for x0"):
        runner.update(factors_of(samples)[:1])
    with pytest.raises(MagycError, match="steps: must be at least 1, got 0"):
        runner.update(steps=0)


def test_a_long_chain_is_what_isam2_makes_of_it_and_says_converged():
    """Poses one by one; only what an update touches is looked at."""
    random, isotropic = np.random.default_rng(0), gtsam.noiseModel.Isotropic.Sigma
    settings = gtsam.ISAM2Params()
    settings.setRelinearizeThreshold(0.1)
    settings.relinearizeSkip = 1
    runner, isam = Incremental("gauss-newton", relinearize_threshold=0.1), gtsam.ISAM2(settings)
    pose = gtsam.Pose3()
    for k in range(150):
        graph, new = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            graph.addPriorPose3(0, pose, isotropic(6, 0.1))
        else:
            step = gtsam.Pose3(gtsam.Rot3.Rz(0.05), np.array([1.0, 0, 0]))
            step = step.compose(gtsam.Pose3.Expmap(0.01 * random.normal(size=6)))
            graph.push_back(gtsam.BetweenFactorPose3(k - 1, k, step, isotropic(6, 0.01)))
            pose = pose.compose(step)
        new.insert(k, pose)
        if k % 50 == 49:
            graph.push_back(
                gtsam.GPSFactor(k, pose.translation() + 0.2 * random.normal(size=3), isotropic(3, 0.1))
            )
        result = runner.update(graph, new)
        isam.update(graph, new)
        assert result.updated
    for _ in range(3):
        result = runner.update()
        isam.update()
    assert result.status is Status.CONVERGED
    found = runner.values.localCoordinates(isam.calculateEstimate()).vector()
    np.testing.assert_allclose(found, 0, atol=1e-12)


def test_steps_that_grow_are_called_diverged():
    """Gauss–Newton on a cost that flattens: each step is longer than the one before."""

    def error(x, want_jacobians):
        return np.arcsinh(x), [np.diag(1 / np.sqrt(1 + x**2))]

    runner = Incremental("gauss-newton")
    far = custom_factor("arcsinh", 1.0, [X], [vector(2)], 2, error)
    result = runner.update([far], values(x=[5, 5]))
    statuses = [result.status] + [runner.update().status for _ in range(12)]
    assert Status.DIVERGED in statuses
    assert Status.CONVERGED not in statuses
