"""The field chain against dense algebra and numeric derivatives, and as one factor of a GTSAM graph."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.linalg.lapack import dpbtrf
from scipy.spatial.transform import Rotation

from magyc_gtsam.estimators.smoother.smoother import calibrate_smoother
from magyc_gtsam.factors import MagycError, unvech, vech
from magyc_gtsam.factors.chain.banded import BandFactor, backward_solved, forward_solved
from magyc_gtsam.factors.chain.chain_values import DELAY, PARAMETERS, ChainState, SensorNoise, Weights
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rotations import exponential_matrices, increments, tangent_frame
from magyc_gtsam.factors.field_chain import field_chain_factor
from magyc_gtsam.simulation import simulate

NOISE = SensorNoise(1e-6, 5e-3)
STEP = np.concatenate([np.full(9, 1e-9), np.full(3, 1e-6), [1e-5], np.full(3, 1e-6)])  # of numeric differences


def samples_of(recording):
    return Preintegration(*recording.magnetometer, *recording.gyroscope, turn=0.2)


def truth_parameters(simulation):
    truth = simulation.truth
    return np.concatenate(
        [vech(truth.soft_iron) * truth.field_strength, truth.hard_iron, truth.gyro_bias, [truth.delay]]
    )


@pytest.fixture(scope="module")
def chain():
    """Some 50 windows of a wide motion with a hole of the gyroscope, integrated away from the truth."""
    simulation = simulate("wide", duration=60, rate=10, seed=1)
    recording = simulation.recording
    kept = np.r_[:300, 350:600]
    samples = Preintegration(
        recording.time[kept], recording.magnetic_field[kept], recording.time[kept], recording.angular_rate[kept]
    )
    windows = samples.integrate(np.array([1e-3, -2e-3, 3e-3]), 0.01)
    return FieldChain(windows, NOISE)


@pytest.fixture(scope="module", params=[[], [0.02, -0.03, 0.05]], ids=["", "skew"])
def state(chain, request):
    """A point that is no minimum, at the bias and delay of the integration; without and with a skew."""
    rng = np.random.default_rng(0)
    soft_iron = 50e-6 * np.array([1.1, 0.1, -0.05, 0.9, 0.1, 1.2])
    parameters = np.concatenate([soft_iron, [5e-6, 1e-6, -3e-6], chain.windows.bias, [chain.windows.delay]])
    parameters = np.append(parameters, request.param)
    direction = chain.start(parameters).direction + 0.02 * rng.normal(size=(3, len(chain.windows)))
    return ChainState(parameters, direction / np.linalg.norm(direction, axis=0))


@pytest.fixture
def weights(chain):
    rng = np.random.default_rng(1)
    n = len(chain.windows)
    return Weights(rng.uniform(0.1, 1, n), rng.uniform(0.1, 1, n - 1))


def whitened(chain, state, weights):
    """All residuals, weighted and divided by their sigma: windows first, then links."""
    residuals = chain.residuals(state)
    window = residuals.window * np.sqrt(weights.window) / chain.window_sigma
    link = residuals.link * np.sqrt(weights.link) / chain.link_sigma
    return np.concatenate([window.T.ravel(), link.T.ravel()])


def dense_jacobian(chain, state, weights):
    """Central differences of all residuals on θ and on both tangent coordinates of every direction."""
    basis, columns = tangent_frame(state.direction)[:, 1:], []
    for unit in np.diag(STEP)[: len(state.parameters), : len(state.parameters)]:
        moved = [state._replace(parameters=state.parameters + s * unit) for s in (1, -1)]
        step = unit.sum()
        columns.append((whitened(chain, moved[0], weights) - whitened(chain, moved[1], weights)) / (2 * step))
    for n in range(len(chain.windows)):
        for a in (0, 1):
            moved = []
            for sign in (1, -1):
                direction = state.direction.copy()
                direction[:, n] += sign * 1e-6 * basis[:, a, n]
                moved.append(whitened(chain, ChainState(state.parameters, direction), weights))
            columns.append((moved[0] - moved[1]) / 2e-6)
    return np.array(columns).T


# --- the chain's mathematics ---


def test_elimination_is_dense_algebra_on_the_numeric_jacobian(chain, state, weights):
    """Cost, Schur complement, reduced gradient, and the directions' step."""
    assert (~chain.windows.linked).sum() == 1
    jacobian, residual = dense_jacobian(chain, state, weights), whitened(chain, state, weights)
    normal, gradient = jacobian.T @ jacobian, jacobian.T @ residual
    p = len(state.parameters)
    solved = np.linalg.solve(normal[p:, p:], np.column_stack([normal[p:, :p], gradient[p:]]))
    information = normal[:p, :p] - normal[:p, p:] @ solved[:, :p]
    reduced = chain.eliminate(state, weights)
    scale = 1 / np.sqrt(np.diag(information))
    assert reduced.cost == pytest.approx(0.5 * residual @ residual, rel=1e-12)
    np.testing.assert_allclose(
        reduced.information * scale * scale[:, None], information * scale * scale[:, None], atol=1e-6
    )
    expected = scale * (gradient[:p] - normal[:p, p:] @ solved[:, p])
    np.testing.assert_allclose(scale * reduced.gradient, expected, atol=1e-6 * np.abs(expected).max())

    step = -np.linalg.solve(information * scale * scale[:, None], expected) * scale * 1e-3
    ahead = chain.move(state, reduced, step)
    tangent = -(solved[:, p] + solved[:, :p] @ step).reshape(-1, 2)
    direction = state.direction + np.einsum("ian,na->in", tangent_frame(state.direction)[:, 1:], tangent)
    np.testing.assert_allclose(ahead.direction, direction / np.linalg.norm(direction, axis=0), atol=1e-8)
    np.testing.assert_array_equal(ahead.parameters, state.parameters + step)


def test_gradient_is_that_of_the_cost_at_the_best_directions(chain, state, weights):
    """With the directions at their best the reduced gradient is the whole derivative of the cost on θ."""

    size = len(state.parameters)

    def best(parameters):
        found = ChainState(parameters, state.direction)
        for _ in range(30):
            found = chain.move(found, chain.eliminate(found, weights), np.zeros(size))
        return chain.eliminate(found, weights)

    # Links are exact derivatives at the bias of the integration only, windows everywhere.
    numeric = [
        (best(state.parameters + step * unit).cost - best(state.parameters - step * unit).cost) / (2 * step)
        for step, unit in zip(STEP[:size], np.eye(size), strict=True)
    ]
    reduced = best(state.parameters)
    scale = 1 / np.sqrt(np.diag(reduced.information))
    np.testing.assert_allclose(scale * reduced.gradient, scale * numeric, rtol=1e-4, atol=1e-3)


def test_what_the_windows_lose_is_the_trace_of_the_dense_hat_matrix(chain, state, weights):
    jacobian = dense_jacobian(chain, state, weights)
    size = len(state.parameters)
    free = np.r_[:DELAY, DELAY + 1 : jacobian.shape[1]]  # a fixed delay absorbs nothing
    q, _ = np.linalg.qr(jacobian[:, free])
    n = len(chain.windows)
    expected = float((q[: 3 * n] ** 2).sum())
    reduced = chain.eliminate(state, weights)
    kept = np.delete(np.arange(size), DELAY)
    covariance = np.zeros((size, size))
    covariance[np.ix_(kept, kept)] = np.linalg.inv(reduced.information[np.ix_(kept, kept)])
    assert reduced.absorbed(covariance) == pytest.approx(expected, abs=1e-5)
    assert expected + (q[3 * n :] ** 2).sum() == pytest.approx(len(kept) + 2 * n)


def test_a_window_of_weight_zero_is_not_seen(chain, state, weights):
    """Whatever it measured; the chain goes on through it."""
    weights.window[20] = 0
    field = chain.windows.field.copy()
    field[:, 20] += 50e-6
    other = FieldChain(replace(chain.windows, field=field), NOISE)
    one, two = chain.eliminate(state, weights), other.eliminate(state, weights)
    # Not to the last digit: the floor of the links' variance depends on the field's spread.
    scale = 1 / np.sqrt(np.diag(one.information))
    np.testing.assert_allclose(
        two.information * scale * scale[:, None], one.information * scale * scale[:, None], atol=1e-4
    )
    assert two.cost == pytest.approx(one.cost, rel=1e-4)
    weights.window[20] = 1
    assert other.eliminate(state, weights).cost > 1.02 * chain.eliminate(state, weights).cost


def test_a_link_of_weight_zero_parts_the_chain_in_two(chain, state, weights):
    weights.link[24] = 0
    whole = chain.eliminate(state, weights)
    information, cost = 0.0, 0.0
    for part in (slice(0, 25), slice(25, len(chain.windows))):
        links = slice(part.start, part.stop - 1)
        w = chain.windows
        piece = FieldChain(
            replace(
                w, time=w.time[part], count=w.count[part], field=w.field[:, part], rotation=w.rotation[..., part],
                rotation_bias=w.rotation_bias[..., part], rotation_rate=w.rotation_rate[..., part],
                lever=w.lever[..., links], link_time=w.link_time[links],
                linked=w.linked[links],
            ),
            NOISE,
        )  # fmt: skip
        reduced = piece.eliminate(
            ChainState(state.parameters, state.direction[:, part]),
            Weights(weights.window[part], weights.link[links]),
        )
        information, cost = information + reduced.information, cost + reduced.cost
    assert whole.cost == pytest.approx(cost, rel=1e-4)
    scale = 1 / np.sqrt(np.diag(information))
    np.testing.assert_allclose(
        whole.information * scale * scale[:, None], information * scale * scale[:, None], atol=1e-4
    )


def test_a_window_without_measurement_and_links_has_no_direction(chain, state, weights):
    weights.window[5] = weights.link[4] = weights.link[5] = 0
    with pytest.raises(MagycError, match=rf"window 5 at {chain.windows.time[5]:.1f} s has no finite direction"):
        chain.eliminate(state, weights)


def test_the_integrated_world_is_arbitrary(chain, state, weights):
    """Another frame, R → Q R, turns the directions and leaves all else."""
    q = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix()
    turned = replace(
        chain.windows,
        rotation=np.einsum("ijn,kj->ikn", chain.windows.rotation, q),
        rotation_bias=np.einsum("ijln,kj->ikln", chain.windows.rotation_bias, q),
        rotation_rate=np.einsum("ijn,kj->ikn", chain.windows.rotation_rate, q),
        lever=np.einsum("ij,jkn->ikn", q, chain.windows.lever),
    )
    one = chain.eliminate(state, weights)
    moved = ChainState(state.parameters, q @ state.direction)
    other = FieldChain(turned, NOISE)
    two = other.eliminate(moved, weights)
    scale = 1 / np.sqrt(np.diag(one.information))
    assert two.cost == pytest.approx(one.cost, rel=1e-12)
    np.testing.assert_allclose(scale * two.gradient, scale * one.gradient, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(
        two.information * scale * scale[:, None], one.information * scale * scale[:, None], atol=1e-9
    )
    step = 0.1 * scale
    np.testing.assert_allclose(
        other.move(moved, two, step).direction, q @ chain.move(state, one, step).direction, atol=1e-9
    )


def settled(chain, parameters):
    """The best directions at fixed θ."""
    state, weights = chain.start(parameters), chain.unweighted()
    for _ in range(10):
        state = chain.move(state, chain.eliminate(state, weights), np.zeros(PARAMETERS))
    return state


def noisy_chain(n, interval_mean):
    """Single-sample windows of piecewise constant or piecewise linear rates, and the true directions."""
    rng = np.random.default_rng(4)
    time, rate = np.arange(n) / 10, 0.3 * np.sin(np.arange(n)[:, None] / 10 * [0.5, 0.8, 1.1])
    steps = rate[1:] / 10 if interval_mean else increments(time, rate)
    world = np.array([0.48, 0.6, 0.64])
    attitude, body = Rotation.identity(), [world]
    for step in steps:
        attitude = attitude * Rotation.from_rotvec(step)
        body.append(attitude.inv().apply(world))
    soft_iron, hard_iron = 50e-6 * vech(np.eye(3)), np.array([1e-6, 2e-6, 3e-6])
    m = 50e-6 * np.array(body) + hard_iron + NOISE.magnetometer * rng.normal(size=(n, 3))
    w = rate + NOISE.gyroscope * rng.normal(size=(n, 3))
    chain = FieldChain(Preintegration(time, m, time, w, interval_mean, turn=1e-9).integrate(), NOISE)
    direction = np.einsum("ijn,ni->jn", chain.windows.rotation, np.array(body))
    return chain, ChainState(np.concatenate([soft_iron, hard_iron, np.zeros(4)]), direction)


def test_directions_settle_where_the_readings_are_far_from_the_model():
    """Readings of one to three times the field of the model: Gauss–Newton alone swings for ever."""
    simulation = simulate("wide", duration=60, seed=3)
    parameters = truth_parameters(simulation)
    windows = samples_of(simulation.recording).integrate(parameters[9:12])
    large = 2 + np.sin(np.linspace(0, 40, len(windows)))
    away = parameters[6:9, None]
    far = FieldChain(replace(windows, field=away + large * (windows.field - away)), NOISE)
    _, reduced = far.settle(far.start(parameters), far.unweighted())
    assert np.linalg.norm(reduced.half[:, -1]) < 1e-6 * np.sqrt(reduced.cost)


def test_residuals_at_the_truth_are_as_likely_as_the_noise_says():
    """χ² of 3 per window and of 2 per link, neighbours independent."""
    n = 4000
    chain, truth = noisy_chain(n, interval_mean=True)
    residuals = chain.residuals(truth)
    window, link = chain.squares(residuals)
    assert window.mean() == pytest.approx(3, abs=4 * np.sqrt(6 / n))
    assert link.mean() == pytest.approx(2, abs=4 * np.sqrt(4 / n))
    for group in (residuals.window / chain.window_sigma, residuals.link / chain.link_sigma):
        neighbours = np.einsum("in,in->n", group[:, 1:], group[:, :-1])
        assert neighbours.mean() == pytest.approx(0, abs=4 * np.sqrt(3 / n))


def test_links_of_instant_rates_add_up_to_the_right_drift():
    """Neighbouring links share samples, and their noise is not white, but its sum is right."""
    blocks, length = 800, 20
    _, truth = noisy_chain(blocks * length + 1, interval_mean=False)
    drift = np.linalg.norm(truth.direction[:, length::length] - truth.direction[:, :-1:length], axis=0)
    expected = 2 * NOISE.gyroscope**2 * (length - 0.5) * 0.1**2
    assert np.mean(drift**2) == pytest.approx(expected, rel=4 / np.sqrt(blocks))


def test_without_noise_the_truth_leaves_nothing():
    simulation = simulate("wide", duration=60, rate=100, seed=1, magnetometer_noise=0, gyroscope_noise=0)
    chain = FieldChain(samples_of(simulation.recording).integrate(simulation.truth.gyro_bias), NOISE)
    residuals = chain.residuals(settled(chain, truth_parameters(simulation)))
    assert np.abs(residuals.link).max() < 1e-6
    assert np.abs(residuals.window).max() < 1e-10


def test_a_moved_bias_and_delay_are_right_to_first_order():
    """Residuals against those of integrating again: ten times closer, a hundred times less wrong."""
    simulation = simulate("wide", duration=60, rate=20, seed=1, gyroscope_noise=0)
    samples = Preintegration(
        *simulation.recording.magnetometer, *simulation.recording.gyroscope, turn=1e-9
    )  # over wider windows the first order itself is an approximation
    parameters = truth_parameters(simulation)
    errors = []
    for size in (1e-2, 1e-3):
        moved = parameters + np.r_[np.zeros(9), [size, -size, size], -size]
        first = FieldChain(samples.integrate(parameters[9:12]), NOISE)
        again = FieldChain(samples.integrate(moved[9:12], moved[DELAY]), NOISE)
        one, two = (np.linalg.norm(c.residuals(c.start(moved)).link, axis=0) for c in (first, again))
        errors.append(np.abs(one - two).max())
    assert errors[0] < 3e-4
    assert errors[1] < errors[0] / 50


def test_sigmas_are_per_window_and_link(chain):
    windows = chain.windows
    np.testing.assert_allclose(chain.window_sigma, 1e-6 / np.sqrt(windows.count))
    linked = windows.linked
    np.testing.assert_allclose(chain.link_sigma[linked], 5e-3 * np.sqrt(windows.link_time[linked]), rtol=1e-3)
    assert np.isinf(chain.link_sigma[~linked]).all()


def test_a_perfect_gyroscope_is_solvable():
    simulation = simulate("wide", duration=60, rate=10, seed=1, gyroscope_noise=0)
    chain = FieldChain(
        samples_of(simulation.recording).integrate(simulation.truth.gyro_bias), SensorNoise(1e-6, 0.0)
    )
    reduced = chain.eliminate(chain.start(truth_parameters(simulation)), chain.unweighted())
    assert np.isfinite(reduced.information).all()
    assert np.linalg.eigvalsh(reduced.information)[0] > 0


def test_a_window_that_reads_the_hard_iron_starts_in_some_direction(chain):
    """As with a magnetometer of a coarse resolution: its direction is undefined, but the descent needs one."""
    parameters = np.concatenate([vech(50e-6 * np.eye(3)), chain.windows.field[:, 7], np.zeros(4)])
    np.testing.assert_allclose(np.linalg.norm(chain.start(parameters).direction, axis=0), 1.0)


def test_too_few_windows():
    windows = Preintegration(np.arange(3.0) / 10, np.eye(3), np.arange(3.0) / 10, np.zeros((3, 3))).integrate()
    with pytest.raises(MagycError, match="1 windows, at least 3"):
        FieldChain(windows, NOISE)


def test_rotations_along_the_last_axis():
    vectors = np.random.default_rng(0).normal(size=(3, 30)) * np.repeat([0, 1e-9, 1e-5, 1e-3, 1, 3], 5)
    expected = Rotation.from_rotvec(vectors.T).as_matrix().transpose(1, 2, 0)
    np.testing.assert_allclose(exponential_matrices(vectors), expected, atol=1e-13)


def test_tangent_bases_are_orthonormal_also_at_the_poles():
    directions = np.random.default_rng(0).normal(size=(3, 20))
    directions[:, :2] = [[0, 0], [0, 0], [1, -1]]
    directions /= np.linalg.norm(directions, axis=0)
    frame = np.concatenate([directions[:, None], tangent_frame(directions)[:, 1:]], axis=1)
    np.testing.assert_allclose(np.einsum("ian,ibn->nab", frame, frame), np.tile(np.eye(3), (20, 1, 1)), atol=1e-15)


def test_unvech_is_row_by_row():
    np.testing.assert_array_equal(unvech(np.arange(6.0)), [[0, 1, 2], [1, 3, 4], [2, 4, 5]])


# --- one factor of a graph ---

SOFT, HARD, BIAS, LATE = (gtsam.symbol(c, 0) for c in "khbt")
MICROTESLA = 1e-6
BIASES = {
    "vector": lambda v, b: v.insert(BIAS, b),
    "Point3": lambda v, b: v.insertPoint3(BIAS, b),
    "ConstantBias": lambda v, b: v.insert(BIAS, gtsam.imuBias.ConstantBias(np.array([1.0, 2.0, 3.0]), b)),
}


@pytest.fixture(scope="module")
def wide():
    simulation = simulate("wide", duration=200, rate=10, seed=7)
    return simulation, samples_of(simulation.recording)


def values_at(parameters, bias="Point3", late=True):
    values = gtsam.Values()
    values.insert(SOFT, parameters[:6] / MICROTESLA)
    values.insertPoint3(HARD, parameters[6:9] / MICROTESLA)
    BIASES[bias](values, parameters[9:12])
    if late:
        values.insert(LATE, parameters[DELAY:])
    return values


def near_truth(simulation):
    """A few sigma off, so that no gradient is zero."""
    return truth_parameters(simulation) + np.r_[2e-7 * np.ones(6), -3e-7, 4e-7, 3e-7, 2e-4, -1e-4, 2e-4, 2e-3]


@pytest.mark.parametrize("bias", BIASES)
@pytest.mark.parametrize("delay_key", [LATE, None])
def test_the_factors_gradient_is_the_derivative_of_its_error(wide, bias, delay_key):
    simulation, samples = wide
    factor = field_chain_factor(SOFT, HARD, BIAS, samples, NOISE, delay_key=delay_key, delay=0.002)
    values = values_at(near_truth(simulation), bias, late=delay_key is not None)
    jacobian, right = factor.linearize(values).jacobian()
    gradient, row = -jacobian.T @ right, 0
    assert 0.5 * right @ right == pytest.approx(factor.error(values), rel=1e-9)
    for key in list(factor.keys()):
        size = values.zeroVectors().at(key).size
        step = {SOFT: 1e-2, HARD: 1e-2, BIAS: 1e-5, LATE: 1e-4}[key]
        for unit in np.eye(size):
            errors = []
            for sign in (1, -1):
                delta = gtsam.VectorValues()
                delta.insert(key, sign * step * unit)
                errors.append(factor.error(values.retract(delta)))
            numeric = (errors[0] - errors[1]) / (2 * step)
            # Half a percent of the column's size: bias and delay are derivatives to first order only.
            tolerance = 5e-3 * np.linalg.norm(jacobian[:, row]) * np.sqrt(2 * factor.error(values)) * 0.05 + 1e-4
            assert gradient[row] == pytest.approx(numeric, rel=5e-3, abs=tolerance), (
                gtsam.DefaultKeyFormatter(key),
                unit,
            )
            row += 1
    assert row == jacobian.shape[1]


def test_the_linearised_information_is_the_schur_complement(wide):
    simulation, samples = wide
    parameters = near_truth(simulation)
    factor = field_chain_factor(SOFT, HARD, BIAS, samples, NOISE, delay_key=LATE)
    found = factor.linearize(values_at(parameters)).information()
    chain = FieldChain(samples.integrate(parameters[9:12], parameters[DELAY]), NOISE)
    state = settled(chain, parameters)
    unit = np.r_[np.full(9, MICROTESLA), np.ones(4)]
    expected = chain.eliminate(state, chain.unweighted()).information * unit * unit[:, None]
    scale = 1 / np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found * scale * scale[:, None], expected * scale * scale[:, None], atol=2e-3)


@pytest.mark.parametrize("delay", [None, 0.0])
def test_levenberg_marquardt_over_the_factor_is_the_smoother(wide, delay):
    """From A = I, h = 0 to the estimate of `calibrate_smoother` and the covariance that the sensors' noise leaves."""
    simulation, samples = wide
    recording = simulation.recording
    expected = calibrate_smoother(
        recording, noise=NOISE, robust=False, delay=delay, turn=0.2, window=1.0, misalignment=0.0
    )
    free = delay is None
    graph = gtsam.NonlinearFactorGraph()
    graph.add(field_chain_factor(SOFT, HARD, BIAS, samples, NOISE, delay_key=LATE if free else None))
    start = np.r_[50e-6 * vech(np.eye(3)), np.zeros(7)]
    tight = gtsam.LevenbergMarquardtParams()
    tight.setRelativeErrorTol(1e-12)
    tight.setAbsoluteErrorTol(1e-10)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values_at(start, late=free), tight).optimize()

    soft_iron = unvech(values.atVector(SOFT))
    soft_iron /= np.cbrt(np.linalg.det(soft_iron))
    sigma = expected.sigma
    assert (np.abs(soft_iron - expected.soft_iron) < 0.02 * sigma["soft_iron"]).all()
    assert (np.abs(values.atPoint3(HARD) * MICROTESLA - expected.hard_iron) < 0.02 * sigma["hard_iron"]).all()
    assert (np.abs(values.atPoint3(BIAS) - expected.gyro_bias) < 0.02 * sigma["gyro_bias"]).all()
    if free:
        assert values.atVector(LATE)[0] == pytest.approx(expected.delay, abs=0.02 * expected.delay_sigma)

    marginals = gtsam.Marginals(graph, values)
    colour = expected.diagnostics["colour"]  # hard iron and bias do not depend on how the scale is fixed
    for key, unit, block in ((HARD, MICROTESLA, slice(6, 9)), (BIAS, 1.0, slice(9, 12))):
        covariance = marginals.marginalCovariance(key) * unit**2 * colour
        np.testing.assert_allclose(
            covariance, expected.noise_covariance[block, block], rtol=0.01, atol=0.01 * np.diag(covariance).max()
        )


def test_robust_weights_reach_the_factor(wide):
    """A window of weight zero may hold anything."""
    simulation, samples = wide
    field = samples.magnetic_field.copy()
    starts = samples.starts
    field[starts[9] : starts[10]] += 2e-5
    disturbed = replace(samples, magnetic_field=field)
    weights = FieldChain(samples.integrate(), NOISE).unweighted()
    values = values_at(near_truth(simulation))
    errors = []
    for weight in (1.0, 0.0):
        weights.window[9] = weight
        errors.append(
            [
                field_chain_factor(SOFT, HARD, BIAS, s, NOISE, delay_key=LATE, weights=weights).error(values)
                for s in (samples, disturbed)
            ]
        )
    assert errors[0][1] > errors[0][0] + 100
    assert errors[1][1] == pytest.approx(errors[1][0], rel=1e-6)


@pytest.mark.parametrize(
    ("key", "wrong", "words"),
    [
        (SOFT, np.ones(5), "k0 holds 5 numbers, 6 are expected"),
        (SOFT, gtsam.Rot3(), "field chain"),
        (HARD, gtsam.Rot3(), "field chain"),
        (BIAS, gtsam.Pose3(), "field chain"),
        (LATE, np.ones(2), "t0 holds 2 numbers, 1 are expected"),
        (LATE, None, "field chain"),
    ],
)
def test_keys_of_another_kind(wide, key, wrong, words):
    simulation, samples = wide
    factor = field_chain_factor(SOFT, HARD, BIAS, samples, NOISE, delay_key=LATE)
    values = values_at(truth_parameters(simulation))
    values.erase(key)
    if wrong is not None:
        values.insert(key, wrong)
    with pytest.raises(MagycError, match=words):
        factor.error(values)


@pytest.mark.parametrize("unit", ["soft_iron_unit", "field_unit"])
def test_units_must_be_positive(wide, unit):
    with pytest.raises(MagycError, match=f"{unit} 0"):
        field_chain_factor(SOFT, HARD, BIAS, wide[1], NOISE, **{unit: 0})


def test_the_soft_iron_may_be_dimensionless(wide):
    """With the field strength as its unit the key holds the soft iron itself."""
    simulation, samples = wide
    parameters, strength = near_truth(simulation), simulation.truth.field_strength
    tesla = values_at(parameters)
    ratio = values_at(parameters)
    ratio.update(SOFT, parameters[:6] / strength)
    options = {"delay_key": LATE}
    one = field_chain_factor(SOFT, HARD, BIAS, samples, NOISE, **options)
    two = field_chain_factor(SOFT, HARD, BIAS, samples, NOISE, soft_iron_unit=strength, **options)
    assert two.error(ratio) == pytest.approx(one.error(tesla), rel=1e-9)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_columns_through_a_banded_factor(count: int) -> None:
    """Two at a time give what one at a time do, forward and back."""
    random = np.random.default_rng(count)
    band = np.concatenate([np.full((1, 40), 6.0), random.normal(size=(3, 40))])
    band[3, 1::2] = 0.0  # blocks of two by two
    factor = dpbtrf(band, lower=1)[0]
    dense = sum(np.diag(factor[k, : 40 - k], -k) for k in range(4))
    border = random.normal(size=(count, 2, 20))
    columns = border.swapaxes(1, 2).reshape(count, 40)
    half = forward_solved(BandFactor.of(factor), border)
    np.testing.assert_allclose(half @ dense.T, columns, atol=1e-13)
    whole = backward_solved(BandFactor.of(factor), half).swapaxes(1, 2).reshape(count, 40)
    np.testing.assert_allclose(whole @ (dense @ dense.T), columns, atol=1e-12)
