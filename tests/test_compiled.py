"""The compiled inner loops give the numbers of numpy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.estimators.model_error.physical import followed
from magyc_gtsam.estimators.smoother.columns import EstimatedTerms, UnmodelledColumns
from magyc_gtsam.estimators.smoother.fit import Fit, begin
from magyc_gtsam.estimators.smoother.preparation import preintegrate, short_term_noise
from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.banded import BandFactor, backward_solved, forward_solved
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, WITH_SKEW, ChainState, Weights
from magyc_gtsam.factors.chain.directions import LinearisedSensor
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.forward_filter import ForwardFilter
from magyc_gtsam.factors.chain.gyroscope_track import GyroscopeTrack
from magyc_gtsam.factors.chain.preintegration import windows_passed
from magyc_gtsam.factors.chain.rotations import Array, chained, increments
from magyc_gtsam.factors.chain.spline import Spline
from magyc_gtsam.factors.effects.forms import _COERCIVE, _stopped

pytestmark = pytest.mark.skipif(compiled.loops is None, reason="the inner loops were not compiled")


def both(compute: Callable[[], Any], monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Any]:
    """Return a result of the compiled loops and of numpy."""
    fast = compute()
    with monkeypatch.context() as patch:
        patch.setattr(compiled, "loops", None)
        return fast, compute()


def close(one: Any, other: Any, share: float = 1e-11) -> None:
    """Assert that arrays differ by no more than a share of their largest entry."""
    one, other = np.asarray(one, dtype=complex), np.asarray(other, dtype=complex)
    assert one.shape == other.shape
    np.testing.assert_allclose(one, other, rtol=0, atol=share * max(float(np.abs(other).max(initial=0.0)), 1e-300))


@pytest.fixture(params=["one stretch", "several", "bent", "skewed"])
def fit(request: pytest.FixtureRequest) -> Fit:
    """A chain away from its minimum, with uneven weights; of fewer windows than a stretch, and of several."""
    recording = mg.simulate("wide", duration=60 if request.param == "one stretch" else 400, seed=5).recording
    windows = preintegrate(recording).integrate(np.array([1e-3, -2e-3, 5e-4]), 0.02)
    n, random = len(windows), np.random.default_rng(3)
    assert (n < 128) == (request.param == "one stretch")
    chain = FieldChain(windows, short_term_noise(recording))
    if request.param == "bent":
        chain = replace(chain, bend=LinearisedSensor(random.uniform(0.5, 1, (3, n)), windows.field))
    parameters = np.zeros(WITH_SKEW if request.param == "skewed" else PARAMETERS)
    parameters[[0, 3, 5]] = 50e-6
    parameters[:6] += random.normal(size=6) * 2e-6
    parameters[6:9], parameters[9:12], parameters[12] = 1e-5, windows.bias + 1e-3, 0.025
    parameters[13:] = 0.01
    made = begin(chain, parameters, np.ones(len(parameters), dtype=bool))
    weights = Weights(random.uniform(0.2, 1, n), random.uniform(0.2, 1, n - 1))
    return replace(made, weights=weights, reduced=chain.eliminate(made.state, weights))


def test_elimination(fit: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    """The linearisation and the normal equations."""

    def eliminated() -> Any:
        fit.chain.windows._last.clear()  # its rotations are computed by the loop under test, too
        return fit.chain.eliminate(fit.state, fit.weights)

    close(*both(lambda: np.hstack([1e4 * r for r in fit.chain.residuals(fit.state)]), monkeypatch), 1e-10)
    fast, numpy = both(eliminated, monkeypatch)
    for name, one, other in zip(fast._fields, fast, numpy, strict=True):
        if name == "band_factor":  # its last entries are no part of it
            close(one.inverse, other.inverse)
            one, other = (np.triu(each.columns.T[:, ::-1])[:, ::-1] for each in (one, other))
        close(one, other, 1e-9 if name in ("information", "gradient") else 1e-11)


def test_step_and_absorbed(fit: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    """The directions after a step, and the trace of the windows' part of the hat matrix."""
    step = np.random.default_rng(1).normal(size=len(fit.free)) * 1e-7
    moved = both(lambda: fit.chain.move(fit.state, fit.reduced, step).direction, monkeypatch)
    close(*moved)
    close(*both(lambda: fit.reduced.absorbed(fit.covariance), monkeypatch), 1e-8)
    close(*both(lambda: fit.reduced.direction_slopes, monkeypatch), 1e-9)


def test_settled_directions(fit: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    """The equations of the directions, a step by them, and all steps."""
    sight = fit.chain._sight(fit.state, fit.weights)
    fast, numpy = both(lambda: sight.equations(fit.state.direction), monkeypatch)
    fast.band[-2:, 2:] = fast.band[-1, 1] = 0  # no entries of the matrix
    for one, other in zip(fast, numpy, strict=True):
        close(one, other)
    (moved, most, failed), (same, largest, _) = both(lambda: fast.stepped(fit.state.direction), monkeypatch)
    close(moved, same)
    close(most, largest, 1e-9)
    assert failed == 0
    close(*both(lambda: fit.chain.settled(fit.state, fit.weights).direction, monkeypatch))


@pytest.mark.parametrize(
    "sides", ["windows", "one axis of the windows", "each axis", "links", "windows and links"]
)
@pytest.mark.parametrize("with_terms", [False, True])
def test_scores(fit: Fit, sides: str, with_terms: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Groups of columns of 1 to 40, beside θ and beside terms of the model."""
    n, random = len(fit.chain.windows), np.random.default_rng(2)

    def columns(count: int) -> UnmodelledColumns:  # of two or fewer on all axes
        window = random.normal(size=(count, 3, n)) * 1e-6 if "windows" in sides else None
        link = random.normal(size=(count, 3, n - 1)) * 1e-3 if "links" in sides else None
        if "one axis" in sides and count > 2:
            return UnmodelledColumns.axis_by_axis(random.normal(size=(count, n)) * 1e-6)
        if "each axis" in sides:
            return UnmodelledColumns.on_each_axis(random.normal(size=(-(-count // 3), n)) * 1e-6)
        return UnmodelledColumns(window, link)

    if with_terms:
        terms = UnmodelledColumns(random.normal(size=(2, 3, n)) * 1e-6, random.normal(size=(2, 3, n - 1)) * 1e-3)
        fit = replace(fit, terms=EstimatedTerms(terms, np.array([0.1, -0.2]), np.ones(2)))
    groups = [columns(count) for count in (1, 3, 17, 40, 2)]

    def scored() -> Any:
        beside = replace(fit).beside
        return beside.of_each([lambda group=group: group for group in groups]), [*map(beside.whiten, groups)]

    (fast, white), (numpy, numpy_white) = both(scored, monkeypatch)
    for one, other in zip(fast, numpy, strict=True):
        close(one.normal, other.normal, 1e-10)
        close(one.score, other.score, 1e-9)
        close(one.explained, other.explained, 1e-9)
    for one, other in zip(white, numpy_white, strict=True):
        for part, same in zip(one, other, strict=True):
            assert (part is None) == (same is None)
            if part is not None:
                close(part, same)


@pytest.mark.parametrize("late", [0.0, 0.013])
def test_integration(late: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The windows, with stamps of the gyroscope and between them, in several pieces."""
    recording = mg.simulate("wide", duration=120, seed=7).recording
    monkeypatch.setattr("magyc_gtsam.factors.chain.preintegration._CHUNK", 500)
    fast, numpy = both(lambda: preintegrate(recording).integrate(np.array([0.01, 0.0, -0.02]), late), monkeypatch)
    for name in ("rotation", "rotation_rate", "rotation_bias", "lever", "field", "link_time"):
        close(getattr(fast, name), getattr(numpy, name))


def test_where_windows_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a turn and by their length, in pieces that are no multiple of a stretch."""
    random = np.random.default_rng(6)
    step, rate = random.uniform(0.01, 0.2, 300), random.normal(size=(301, 3)) * np.linspace(0, 2, 301)[:, None]
    fast, numpy = both(lambda: windows_passed(step, rate, 0.3, 0.5), monkeypatch)
    close(fast, numpy)
    assert np.unique(fast / step).size in range(200, 300)  # most by the turn, and the slow ones by the length


@pytest.mark.parametrize("interval_mean", [False, True])
def test_a_track_between_its_stamps(interval_mean: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """At its first and last stamps, between others, and out of order; across turns of more than a radian."""
    random = np.random.default_rng(8)
    time, rate = np.cumsum(random.uniform(0.5, 1.5, 300)), random.normal(size=(300, 3))
    track = GyroscopeTrack.integrate(time, rate, np.array([0.1, 0.0, -0.2]), interval_mean=interval_mean)
    when = np.append(random.uniform(time[0], time[-1], 200), time[[0, 7, -1]])

    def motion() -> list[Array]:
        (p, q), lever, turned = track.motion_at(when)
        return [p.view(float), q.view(float), lever, turned]

    for fast, numpy in zip(*both(motion, monkeypatch), strict=True):
        close(fast, numpy)


def test_a_long_chain_of_large_rotations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rotations by up to 3 rad; the products keep their norm."""
    vector = np.random.default_rng(4).uniform(-2, 2, (20000, 3))
    fast, numpy = both(lambda: chained(vector), monkeypatch)
    for one, other in zip(fast, numpy, strict=True):
        close(one, other)
    assert np.abs(np.abs(fast[0]) ** 2 + np.abs(fast[1]) ** 2 - 1).max() < 1e-13


@pytest.mark.parametrize("count", [1, 16, 21])
@pytest.mark.parametrize("n", [4, 5, 300])
def test_splines(n: int, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Slopes through uneven times."""
    random = np.random.default_rng(n)
    time = np.cumsum(random.uniform(0.5, 2, n))
    values = random.normal(size=(count, n))
    close(*both(lambda: Spline.at(time).slopes(values), monkeypatch))


@pytest.mark.parametrize("straight", [False, True])
def test_integrals_across_a_direction(straight: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The links' columns by errors of the rate."""
    random, n = np.random.default_rng(5), 300
    time, values, direction = np.cumsum(random.uniform(0.5, 2, n)), random.normal(size=(7, 3, n)), np.ones((3, n))
    direction[1] = values[0, 0]
    close(*both(lambda: Spline.at(time).crossed_integrals(values, direction, straight), monkeypatch))


@pytest.mark.parametrize("n", [1, 300])
def test_a_play(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exactly the same: each value is one of the input, less or more the width."""
    values = np.cumsum(np.random.default_rng(n).normal(size=(3, n)), axis=1)
    fast, numpy = both(lambda: followed(values, 1.5), monkeypatch)
    np.testing.assert_array_equal(fast, numpy)


@pytest.mark.parametrize("n", [1, 2, 300])
def test_loops_of_hysteresis(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Small and large loops."""
    values = np.cumsum(np.random.default_rng(n).normal(size=(3, n)), axis=1) * np.array([[0.1], [1.0], [10.0]])
    close(*both(lambda: _stopped(values, _COERCIVE), monkeypatch))


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("n", [3, 4, 5, 300])
def test_turns_between_samples(n: int, uneven: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """With even steps, and with one that is a hole."""
    random = np.random.default_rng(n)
    step = random.uniform(0.5, 2, n)
    if uneven:
        step[n // 2] = 30.0
    time, rate = np.cumsum(step), random.normal(size=(n, 3))
    close(*both(lambda: increments(time, rate), monkeypatch))
    close(*both(lambda: increments(time, rate, np.array([0.1, -0.2, 0.3])), monkeypatch))


@pytest.mark.parametrize("count", [1, 2, 7, 40])
@pytest.mark.parametrize("n", [2, 20, 300])
def test_substitution(n: int, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forward and backward."""
    random = np.random.default_rng(count)
    factor = np.concatenate([np.full((1, 2 * n), 6.0), random.normal(size=(3, 2 * n))])
    factor[3, 1::2] = 0.0  # blocks of two by two
    made = BandFactor.of(factor)
    close(*both(lambda: forward_solved(made, random_border(n, count)), monkeypatch))
    close(*both(lambda: backward_solved(made, random_border(n, count).reshape(count, -1)), monkeypatch))


def random_border(n: int, count: int) -> Array:
    """The same right sides at every call."""
    return np.random.default_rng(n).normal(size=(count, 2, n))


def test_a_filter_of_the_chain(fit: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    """The innovations of the gap workflow."""
    n, random = len(fit.chain.windows), np.random.default_rng(6)
    filtered = ForwardFilter.of(fit.chain, fit.reduced)
    window, link = random.normal(size=(35, 3, n)), random.normal(size=(35, 3, n - 1))
    close(*both(lambda: filtered(window, link), monkeypatch))
    close(*both(lambda: filtered(window, None), monkeypatch))


def test_a_matrix_without_a_factor_is_refused(fit: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both name the window."""
    fit.weights.window[20] = fit.weights.link[19] = fit.weights.link[20] = 0.0
    messages = []
    for loops in (compiled.loops, None):
        monkeypatch.setattr(compiled, "loops", loops)
        with pytest.raises(mg.MagycError, match="window 20 at .* has no finite direction") as found:
            fit.chain.eliminate(fit.state, fit.weights)
        messages.append(str(found.value))
    assert messages[0] == messages[1]


def test_a_state_that_is_not_finite_has_a_cost_that_is_not(fit: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    """A descent takes its step back there, whatever computed it."""
    state = ChainState(fit.state.parameters, fit.state.direction.copy())
    state.direction[:, 20] = np.nan
    fast, numpy = both(lambda: fit.chain.eliminate(state, fit.weights).cost, monkeypatch)
    assert np.isnan([fast, numpy]).all()


@pytest.mark.parametrize("motion", ["wide", "tiny"])
def test_a_calibration(motion: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Estimates, sigmas and words of the default method."""
    recording = mg.simulate(motion, seed=8).recording
    fast, numpy = both(lambda: mg.calibrate(recording), monkeypatch)
    assert fast.message == numpy.message
    sigma = np.sqrt(np.diag(numpy.covariance))[6:12]
    assert np.abs(fast.hard_iron - numpy.hard_iron).max() < 1e-6 * sigma[:3].min()
    assert np.abs(fast.gyro_bias - numpy.gyro_bias).max() < 1e-6 * sigma[3:].min()
    np.testing.assert_allclose(np.diag(fast.covariance), np.diag(numpy.covariance), rtol=1e-6)


def test_wrong_arguments_are_refused() -> None:
    """Neither a number of arrays nor their type is taken on trust."""
    half: Any = np.zeros((20, 4), dtype=np.float32)
    with pytest.raises(TypeError, match="3 arrays are expected, got 1"):
        compiled.loops.turn(5, np.zeros(3))
    with pytest.raises(TypeError, match="eight bytes"):
        compiled.loops.forward(10, half, np.zeros(20), np.zeros((1, 2, 10)), np.zeros((1, 20)))
    with pytest.raises((BufferError, ValueError), match="contiguous"):
        compiled.loops.turn(5, np.zeros((5, 9)).T, np.zeros(3), np.zeros((3, 3, 5)))
