"""What a model lacks: its algebra against a plain regression, its silence on clean logs, its size on faulty ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from magyc_gtsam import Recording, calibrate, simulate
from magyc_gtsam.estimators.model_error import ModelError, component, model_error
from magyc_gtsam.estimators.model_error.components import (
    fit_components,
    likeliest,
    likeliest_of_each,
    principal,
)
from magyc_gtsam.estimators.model_error.families import FAMILIES
from magyc_gtsam.estimators.model_error.held_columns import HeldColumns, Products
from magyc_gtsam.estimators.model_error.motion import WindowMotion
from magyc_gtsam.estimators.model_error.physical import PHYSICAL
from magyc_gtsam.estimators.model_error.samples import coarse_step, one_sided, too_slow
from magyc_gtsam.estimators.smoother.beside import ColumnProducts, Stacked
from magyc_gtsam.estimators.smoother.columns import UnmodelledColumns
from magyc_gtsam.estimators.smoother.fit import begin, descend
from magyc_gtsam.estimators.smoother.marginal import ContinuedChain
from magyc_gtsam.estimators.smoother.noise_levels import explained
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.chain.facts import LinearFact
from magyc_gtsam.simulation import HARD_IRON
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.scoring import score
from magyc_gtsam.study.faults.signals import record


@pytest.fixture(scope="module")
def fit():
    return fit_field_chain(simulate("wide", duration=240, seed=3).recording)


def within(calibration, truth) -> float:
    """NEES of the hard iron, 3 expected."""
    error = calibration.hard_iron - truth.hard_iron
    return float(error @ np.linalg.solve(calibration.covariance[6:9, 6:9], error))


def with_field(recording: Recording, world: np.ndarray) -> Recording:
    """A recording whose field has more of it, (N, 3) T in the world's axes."""
    return replace(
        recording,
        magnetic_field=recording.magnetic_field + Rotation.from_quat(recording.attitude).inv().apply(world),
    )


def test_without_one_of_correlated_effects_variances_stay_positive() -> None:
    """The total of two effects that cancel is smaller than either; without one the other is left."""
    other = component.Component("late drift", "", 0.0, 9.0, np.diag([4.0, 1.0]))
    left = component.Component("gain drift", "", 0.0, 9.0, np.diag([3.0, 2.0]))
    error = ModelError(np.diag([1.0, 2.5]), (other, left), (replace(left, name="bend"),))
    np.testing.assert_array_equal(error.without("late drift").covariance, 2 * left.covariance)
    assert error.without("late drift").components == (left,)
    assert error.without("play") is error


def test_a_column_moves_the_parameters_as_a_new_fit_does(fit) -> None:
    """S is what happens to θ when a little of the column is put into the reading (and out of the fit's weights)."""
    motion, beside = WindowMotion.of(fit), ColumnProducts(fit)
    random = np.random.default_rng(1)
    columns = FAMILIES[0].columns(motion)
    beta = 1e-4 * random.normal(size=len(columns.window))
    windows = replace(
        fit.chain.windows, field=fit.chain.windows.field + np.einsum("k,kin->in", beta, columns.window)
    )
    chain = replace(fit.chain, windows=windows)
    again = descend(replace(fit, chain=chain, reduced=chain.eliminate(fit.state, fit.weights)), settled=1e-10)
    before = descend(fit, settled=1e-10)
    moved = again.state.parameters - before.state.parameters
    sigma = np.sqrt(np.diag(fit.covariance))
    expected = beside.move(beside.of(columns)) @ beta
    np.testing.assert_allclose((moved / sigma)[fit.free], (expected / sigma)[fit.free], atol=0.02)
    assert np.abs(expected / sigma)[fit.free].max() > 0.05


@pytest.mark.parametrize("what", ["fact", "past"])
def test_a_score_is_the_slope_of_the_least_cost_beside_what_is_known(fit, what: str) -> None:
    """Facts two sigmas off, or the first half of the log as the past of an online chain, pull at the residual, too."""
    parameters, windows, noise = fit.state.parameters, fit.chain.windows, fit.chain.noise
    if what == "fact":
        sigma = np.sqrt(np.diag(fit.covariance)[6:9])
        fact = LinearFact(np.arange(6, 9), parameters[6:9] + 2 * sigma, np.diag(1 / sigma))
        chain = replace(fit.chain, facts=(fact,))
    else:
        half = len(windows) // 2
        past = ContinuedChain(windows, noise).marginalise(fit.state, fit.weights, half)
        chain = ContinuedChain(windows.part(half, len(windows)), noise, past)
    known = descend(begin(chain, parameters, fit.free), settled=1e-12)
    columns, beside = FAMILIES[0].columns(WindowMotion.of(known)), ColumnProducts(known)
    new = beside.of(columns)

    def least(beta: float) -> float:
        moved = replace(chain.windows, field=chain.windows.field - beta * columns.window[0])
        return descend(begin(replace(chain, windows=moved), parameters, fit.free), settled=1e-12).reduced.cost

    step = 0.1 / np.sqrt(new.normal[0, 0])
    slope = (least(step) - least(-step)) / (2 * step)
    assert -slope * step == pytest.approx(new.score[0] * step, abs=1e-3)


def test_columns_have_the_products_that_elimination_leaves(fit) -> None:
    """A column of the windows: G is its square less what directions and θ explain of it (fit.explained)."""
    motion, beside = WindowMotion.of(fit), ColumnProducts(fit)
    for name in ("attitude", "second", "drift:slow"):
        family = next(f for f in FAMILIES if f.name == name)
        columns = family.columns(motion).on_all_axes
        normal = beside.of(columns).normal
        for k in (0, len(normal) - 1):
            whitened = columns.window[k] * fit.chain.window_scale * np.sqrt(fit.weights.window)
            left = float(np.vdot(whitened, whitened)) - explained(fit, whitened, fit.covariance)
            assert normal[k, k] == pytest.approx(left, rel=1e-6, abs=1e-10 * np.vdot(whitened, whitened))


def test_products_of_all_families_have_no_negative_direction(fit) -> None:
    """Of all columns together, on a motion that shows little of many of them."""
    weak = fit_field_chain(simulate("tiny", duration=120, seed=5).recording)
    for each in (fit, weak):
        motion, beside = WindowMotion.of(each), ColumnProducts(each)
        new = [beside.of(family.columns(motion)) for family in FAMILIES]
        stacked = Stacked.of(new)
        normal, square = stacked.across(stacked), np.zeros(len(stacked.absorbed))
        for one, own in zip(new, stacked.groups, strict=True):
            normal[own, own] = one.normal
        for part, rows in (stacked.window, stacked.link):
            square[rows] += np.square(part).sum(axis=1)
        scaled = normal / np.sqrt(square * square[:, None])
        np.testing.assert_allclose(scaled, scaled.T, atol=1e-12)
        assert np.linalg.eigvalsh(scaled).min() > -1e-12


def test_the_world_of_the_columns_does_not_turn() -> None:
    """The vertical in it stays within two degrees over ten minutes; the integration's own world turns by 20."""
    simulation = simulate("low", seed=1)
    motion = WindowMotion.of(fit_field_chain(simulation.recording))
    attitude = Rotation.from_quat(simulation.recording.attitude)
    rows = np.searchsorted(simulation.recording.time, motion.time)
    down = attitude[rows].inv().apply([0.0, 0.0, 1.0])
    spread = [
        np.einsum("jin,nj->in", matrices, down).std(axis=1).max()
        for matrices in (motion.attitude, motion.rotation)
    ]
    assert spread[0] < 0.035 < spread[1]
    field = np.einsum("ijn,jn->in", motion.world, motion.direction)
    np.testing.assert_allclose(field, np.broadcast_to(field[:, :1], field.shape), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "strength", "seed"),
    [
        ("current-with-turning", "strong", 7703),
        ("current-with-pitch", "weak", 9003),
        ("current-with-pitch", "weak", 9004),
    ],
)
def test_currents_that_follow_the_motion_are_covered_or_not_trusted(name: str, strength: str, seed: int) -> None:
    """The heading was off by 21 and 4 degrees at 4 to 6 sigmas."""
    fault = FAULTS[name]
    log = record("low", seed, fault, getattr(fault, strength), name)
    assert score(calibrate(log.recording(name))).outcome != "wrong and trusted"


def test_derivatives_and_integrals_of_what_windows_sample_coarsely(fit) -> None:
    """A cubic exactly, up to the ends; of a wave that turns by 2 rad a window most, at uneven windows."""
    motion = WindowMotion.of(fit)
    time = motion.time
    share = (time - time[0]) / (time[-1] - time[0])
    inner, length = slice(20, -20), time[-1] - time[0]
    np.testing.assert_allclose(motion.derivative(share**3)[inner], 3 * share[inner] ** 2 / length, rtol=1e-6)
    np.testing.assert_allclose(motion.integral(share**3)[inner], np.diff(share**4)[inner] * length / 4, rtol=1e-6)
    frequency = 2.0 / np.median(np.diff(time))
    wave, slope = np.sin(frequency * time), frequency * np.cos(frequency * time)
    turned = np.diff(wave)[inner]
    by_spline, by_trapezoid = (
        values[inner] @ turned / (turned @ turned)
        for values in (motion.integral(slope), 0.5 * (slope[1:] + slope[:-1]) * np.diff(time))
    )
    assert by_spline == pytest.approx(1.0, abs=0.15)
    assert by_trapezoid < 0.8
    kept = motion.derivative(wave)[inner] @ slope[inner] / (slope[inner] @ slope[inner])
    assert kept == pytest.approx(0.85, abs=0.1)


def test_what_the_parameters_explain_is_not_new(fit) -> None:
    beside = ColumnProducts(fit)
    hard_iron = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, len(fit.chain.windows)))
    new = beside.of(UnmodelledColumns(1e-6 * hard_iron, None))
    assert np.abs(new.normal).max() < 1e-9 * np.square(1e-6 * beside.window_scale).sum()
    np.testing.assert_allclose(beside.move(new)[6:9], 1e-6 * np.eye(3), atol=1e-9)


def test_amplitudes_come_back() -> None:
    """Two groups of known variance beside white noise: their mean estimate, and E[β βᵀ], over fresh draws."""
    random = np.random.default_rng(0)
    found, level, score = [], [], []
    for _ in range(40):
        rows = random.normal(size=(30, 600))
        beta = np.concatenate([0.5 * random.normal(size=20), 2.0 * random.normal(size=10)])
        residual = beta @ rows + 3.0 * random.normal(size=600)
        products = rows @ rows.T, rows @ residual, float(residual @ residual)
        fitted = fit_components(*products, [slice(0, 20), slice(20, 30)], [10.0, 10.0], 600.0)
        found.append(fitted.amplitude)
        level.append(np.sqrt(fitted.level))
        error = beta - fitted.mean
        covariance = fitted.second - np.outer(fitted.mean, fitted.mean)
        score.append(error @ np.linalg.solve(covariance, error))
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(found), axis=0)), [0.5, 2.0], rtol=0.15)
    assert np.mean(level) == pytest.approx(3.0, rel=0.02)
    assert np.mean(score) == pytest.approx(30, abs=4)


def test_columns_beside_those_that_are_held() -> None:
    """As one elimination gives them, whatever was held before; a group of one, and one without information."""
    random = np.random.default_rng(3)
    rows = random.normal(size=(9, 40))
    rows[4] = 0.0
    normal, score, square = rows @ rows.T, rows @ random.normal(size=40), 60.0
    groups, variance = [slice(0, 3), slice(3, 4), slice(4, 6), slice(6, 9)], [0.5, 2.0, 0.1, 30.0]

    def expected(there: set[int], own: slice) -> tuple[np.ndarray, np.ndarray, float]:
        kept = np.array([k for i in there for k in range(9)[groups[i]]], dtype=int)
        prior = np.array([variance[i] for i in there for _ in range(9)[groups[i]]])
        solved = np.linalg.solve(normal[np.ix_(kept, kept)] + np.diag(1 / prior), np.c_[normal[kept], score[kept]])
        left = np.c_[normal, score] - normal[:, kept] @ solved
        return left[own, own], left[own, -1], square - score[kept] @ solved[:, -1]

    def same(found: Products, there: set[int], own: slice) -> None:
        for result, right in zip(found, expected(there, own), strict=True):
            np.testing.assert_allclose(result, right, atol=1e-12)

    held = HeldColumns(normal, score, square)
    for there in ({0, 1, 2}, {1, 3}, {0, 2, 3}, set[int]()):
        variance = [3 * each for each in variance]  # of those that stay, too
        for i, own in enumerate(groups):
            held.hold(own, variance[i] if i in there else 0.0)
        assert held.left == pytest.approx(expected(there, slice(0, 1))[2])
        free = [i for i in range(4) if i not in there]
        for i, own in enumerate(groups):
            same(held.of(own), there - {i}, own)
            if i in there:
                for k, found in zip(free, held.without(own, [groups[k] for k in free]), strict=True):
                    same(found, there - {i}, groups[k])


def test_groups_at_once_have_the_amplitudes_of_each() -> None:
    random = np.random.default_rng(4)
    residual, most = random.normal(size=300), [0.5, 1e-3, 2.0]
    rows = [random.normal(size=(k, 300)) + size * residual for k, size in ((1, 0.3), (4, 0.1), (7, 0.0))]
    square, products = float(residual @ residual), [(each @ each.T, each @ residual) for each in rows]
    found = likeliest_of_each([principal(*each) for each in products], square, 300.0, most)
    alone = [likeliest(*each, square, 300.0, limit) for each, limit in zip(products, most, strict=True)]
    np.testing.assert_allclose(found, [each[:2] for each in alone])
    assert found[0][1] > 0
    assert alone[0].variance <= alone[0].mean <= most[0]


def test_no_amplitude_where_there_is_none() -> None:
    random = np.random.default_rng(0)
    gains = []
    for _ in range(300):
        rows, residual = random.normal(size=(12, 300)), random.normal(size=300)
        gains.append(likeliest(rows @ rows.T, rows @ residual, float(residual @ residual), 300.0, 1.0).gain)
    assert np.mean(np.array(gains) > 1.92) < 0.05  # half of a χ² of one degree of freedom beyond 3.84
    assert max(gains) < 7


@pytest.mark.parametrize("motion", ["wide", "moderate", "low", "tiny"])
def test_clean_logs_are_hardly_widened(motion: str) -> None:
    """What instruments may do and the motion does not show has its odds from before, which costs a few per cent.

    One log of 48 shows a drift of the bias by chance, which is 5 times as uncertain for it.
    """
    ratios = []
    for seed in range(600, 612):
        calibration = calibrate(simulate(motion, duration=300, seed=seed).recording)
        assert calibration.trusted
        ratio = np.diag(calibration.covariance)[6:] / np.diag(calibration.noise_covariance)[6:]
        ratios.append(np.sqrt(ratio))
    assert np.median(np.max(ratios, axis=1)) < 1.15
    hard_iron, bias = np.split(np.mean(ratios, axis=0), 2)
    assert hard_iron.max() < 1.2
    assert bias.max() < 1.5


def test_a_small_current_that_is_switched_every_half_minute_is_covered() -> None:
    """Neighbouring residuals are not correlated, those of several windows are; 6.3 and 6.7 sigmas off before."""
    fault = FAULTS["switched-current"]
    for motion, seed in (("wide", 43015), ("low", 43026)):
        log = record(motion, seed, fault, fault.slight, "switched-current")
        calibration = calibrate(log.recording("switched"))
        assert calibration.diagnostics["colour"] == 1
        found = score(calibration, end=float(log.field_time[-1]))
        assert max(found.hard_iron_sigmas, found.heading_sigmas) < 3
        assert "hard iron changes with time" in calibration.message


def test_a_sensor_on_an_arm_in_a_gradient_is_covered() -> None:
    """0.4 m in 6 µT/m; today's colour alone leaves a mean NEES of some hundred."""
    scores, alone = [], []
    for seed in range(8):
        simulation = simulate("wide", duration=300, seed=seed)
        random = np.random.default_rng(seed)
        arm, gradient = random.normal(size=3), random.normal(size=(3, 3))
        gradient = gradient + gradient.T - 2 / 3 * np.trace(gradient) * np.eye(3)
        position = Rotation.from_quat(simulation.recording.attitude).apply(0.4 * arm / np.linalg.norm(arm))
        world = position @ (6e-6 * gradient / np.linalg.norm(gradient))
        calibration = calibrate(with_field(simulation.recording, world))
        scores.append(within(calibration, simulation.truth))
        alone.append(within(replace(calibration, covariance=calibration.noise_covariance), simulation.truth))
        assert calibration.diagnostics["model_error"]["field_variation"]["size"] > 0.2e-6
    assert np.median(scores) < 6
    assert np.median(alone) > 3 * np.median(scores)


@pytest.mark.parametrize("motion", ["wide", "moderate"])
def test_a_gyroscope_with_a_wrong_scale_is_covered_or_not_trusted(motion: str) -> None:
    """By 5 %; without their model error most results are trusted and off by tens of sigmas."""
    wrong, alone = 0, []
    for seed in range(8):
        simulation = simulate(motion, duration=300, seed=seed)
        rate = 1.05 * simulation.recording.angular_rate
        calibration = calibrate(replace(simulation.recording, angular_rate=rate))
        wrong += calibration.trusted and within(calibration, simulation.truth) > 16
        alone.append(within(replace(calibration, covariance=calibration.noise_covariance), simulation.truth))
    assert wrong <= 1
    assert np.median(alone) > 16


@pytest.mark.parametrize("kind", ["halves", "directions", "speeds"])
def test_parts_of_a_recording_that_disagree_are_named_and_covered(kind: str) -> None:
    """Hard irons that are 1 µT apart in two parts of the recording, on a motion that hardly tilts."""
    for seed in range(4):
        simulation = simulate("moderate", seed=800 + seed)
        recording, truth = simulation.recording, simulation.truth
        rate = np.stack([np.convolve(axis, np.ones(11) / 11, "same") for axis in recording.angular_rate.T], axis=1)
        speed = np.linalg.norm(rate, axis=1)
        side = {
            "halves": np.where(recording.time < recording.time.mean(), -1.0, 1.0),
            "directions": np.sign(rate[:, 2]),
            "speeds": np.sign(speed - np.median(speed)),
        }[kind]
        way = np.random.default_rng(seed).normal(size=3)
        shift = 0.5e-6 * way / np.linalg.norm(way)
        if kind == "halves":  # a calibration is used after the recording
            truth = replace(truth, hard_iron=truth.hard_iron + shift)
        field = recording.magnetic_field + side[:, None] * shift
        calibration = calibrate(replace(recording, magnetic_field=field), misalignment=0)
        components = calibration.diagnostics["model_error"]["components"]
        assert kind in [component["name"] for component in components]
        assert not calibration.trusted or within(calibration, truth) < 16


def test_a_filtered_magnetometer_is_covered_or_not_trusted() -> None:
    """First order with 0.5 s on wide: off by 1.5 µT at a noise of 0.06."""
    for seed in range(4):
        simulation = simulate("wide", duration=300, seed=seed)
        field = simulation.recording.magnetic_field
        keep = np.exp(-0.1 / 0.5)
        slow = lfilter([1 - keep], [1, -keep], field - field[0], axis=0) + field[0]
        calibration = calibrate(replace(simulation.recording, magnetic_field=slow))
        assert not calibration.trusted or within(calibration, simulation.truth) < 16


@pytest.mark.parametrize("seed", range(3, 9))
def test_residuals_that_are_not_white_ask_for_every_family(seed: int) -> None:
    """A current that is switched every half minute: in half of the logs the families that are tested first miss it."""
    log = simulate("low", seed=seed).recording
    switched = np.where(log.time % 60 < 30, 1e-6, 0.0)[:, None] * [0.6, 0.6, 0.5]
    found = calibrate(replace(log, magnetic_field=log.magnetic_field + switched))
    assert "drift:fast" in [each["name"] for each in found.diagnostics["model_error"]["components"]]


@pytest.mark.parametrize("fault", ["reading bends", "gyroscope's scale"])
def test_what_the_motion_does_not_show_is_in_the_sigma(fault: str) -> None:
    """On tiny a bend of 1 % or a scale of 1 % gains little and moves the hard iron by a sigma of the sensors' noise."""
    scores, alone = [], []
    for seed in range(12):
        simulation = simulate("tiny", duration=300, seed=seed)
        recording = simulation.recording
        if fault == "reading bends":
            field = recording.magnetic_field
            bent = field + 0.01 * field**3 / np.abs(field).max() ** 2
            recording = replace(recording, magnetic_field=bent)
        else:
            recording = replace(recording, angular_rate=1.01 * recording.angular_rate)
        calibration = calibrate(recording)
        scores.append(within(calibration, simulation.truth))
        alone.append(within(replace(calibration, covariance=calibration.noise_covariance), simulation.truth))
    assert np.mean(np.array(scores) > 11.3) <= 0.15  # 1 % of χ² with three degrees of freedom
    assert np.median(scores) < np.median(alone)


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_the_shift_by_spikes_to_one_side_is_found_whole(share: float) -> None:
    """The medians of five alone miss a third of what a fifth of the samples does."""
    recording, random = simulate("wide", duration=300, seed=3).recording, np.random.default_rng(3)
    size = (random.random(len(recording.time)) < share) * random.uniform(15e-6, 45e-6, len(recording.time))
    spikes = np.outer(size, [0.6, 0.0, -0.8])
    found = one_sided(replace(recording, magnetic_field=recording.magnetic_field + spikes))
    assert found is not None
    np.testing.assert_allclose(found.shift, spikes.mean(axis=0), atol=0.05 * size.mean())
    assert one_sided(recording) is None


@pytest.mark.parametrize("seed", [2171, 2172])
def test_steps_of_a_coarse_magnetometer_are_covered(seed: int) -> None:
    """What rounding does comes back with the attitude, and is no noise: the heading was off by 3 to 6 sigmas."""
    fault = FAULTS["coarse"]
    assert coarse_step(record("low", seed, fault, fault.weak, "coarse").recording("steps of the noise")) == 0
    recording = record("low", seed, fault, fault.strong, "coarse").recording("steps of ten times the noise")
    assert coarse_step(recording) == pytest.approx(fault.strong)
    calibration = calibrate(recording)
    assert "steps" in [each["name"] for each in calibration.diagnostics["model_error"]["components"]]
    assert score(calibration).outcome == "right and trusted"


def test_spikes_to_one_side_are_covered_or_not_trusted() -> None:
    """A fifth of the samples off by up to 80 µT one way pull the hard iron by 5 µT; two-sided ones do not."""
    for seed in range(4):
        simulation = simulate("wide", duration=300, seed=seed)
        recording, random = simulation.recording, np.random.default_rng(seed)
        hit = (random.random(len(recording.time)) < 0.2)[:, None]
        size, way = 40e-6 * random.normal(size=hit.shape), random.normal(size=3)
        way /= np.linalg.norm(way)
        spiked = calibrate(replace(recording, magnetic_field=recording.magnetic_field + hit * np.abs(size) * way))
        assert not spiked.trusted or within(spiked, simulation.truth) < 16
        assert "outliers lie to one side" in spiked.message
        both = calibrate(replace(recording, magnetic_field=recording.magnetic_field + hit * size * way))
        assert "to one side" not in both.message


@pytest.mark.parametrize(("period", "step", "told"), [(1.8, 1.0, True), (4.0, 1.0, True), (1.8, 0.1, False)])
def test_samples_too_few_for_the_motion_are_said(period: float, step: float, told: bool) -> None:
    """A swell sampled once a second, of which the trapezoidal rule loses a fifth and more, and ten times as fast."""
    for seed in range(4):
        time, random = np.arange(0, 400, step), np.random.default_rng(seed)
        swell = 2 * np.pi * time / period
        rate = np.stack([0.5 * np.sin(swell), 0.3 * np.cos(swell), 0.02 * np.sin(time / 30)], axis=1)
        field = np.array([20e-6, 0, 40e-6]) + 1e-6 * random.normal(size=(len(time), 3))
        recording = Recording(time, field, rate + 5e-3 * random.normal(size=rate.shape))
        assert bool(too_slow(recording)) == told


def test_the_message_and_the_numbers_say_what_is_noise_and_what_is_not() -> None:
    simulation = simulate("wide", duration=300, seed=4)
    time = simulation.recording.time
    world = 2e-6 * np.sin(2 * np.pi * time / 40)[:, None] * np.array([1.0, 0.5, 0.0])
    calibration = calibrate(with_field(simulation.recording, world))
    assert "the field of the place varies by" in calibration.message
    found = calibration.diagnostics["model_error"]["field_variation"]
    assert 0.5e-6 < found["size"] < 2e-6
    assert 20 < found["period"] < 80
    whole, noise = calibration.covariance, calibration.noise_covariance
    assert np.linalg.eigvalsh(whole - noise)[0] > -1e-9 * np.trace(whole)
    again = type(calibration).from_dict(calibration.to_dict())
    np.testing.assert_array_equal(again.noise_covariance, noise)


def test_few_windows_of_a_clean_log_show_nothing() -> None:
    fit = fit_field_chain(simulate("wide", duration=18, seed=1).recording)
    assert len(fit.chain.windows) < 30
    assert not model_error(fit).components


def test_a_bent_reading_is_covered_in_half_a_minute_too() -> None:
    """Below thirty windows nothing was looked for: 6 of 24 such logs were trusted beyond 3 sigmas, at most 6.3."""
    off = []
    for seed in range(100, 108):
        for duration in (20, 28):
            recording = simulate("wide", duration=duration, seed=seed).recording
            field = recording.magnetic_field
            bent = field + 0.03 * 45e-6 * (field / np.abs(field).max()) ** 3
            calibration = calibrate(replace(recording, magnetic_field=bent))
            if calibration.trusted:
                away = np.abs(calibration.hard_iron - HARD_IRON)
                off.append((away / np.sqrt(np.diag(calibration.covariance)[6:9])).max())
    assert len(off) >= 10
    assert max(off) < 3.5


@pytest.mark.parametrize("seed", [4111, 4143])
def test_a_gyroscope_filtered_by_half_a_second_is_covered(seed: int) -> None:
    """It loses a fifth of the turns to and fro, as scales would take. Held at 3 %, they left 14 µT at 2.2 sigmas.

    A mount that flexes, fitted with the others, would take the filter's place: 21 µT trusted at 4.5 sigmas.
    """
    log = record("moderate", seed, FAULTS["filtered-gyroscope"], 0.5, "filtered-gyroscope")
    calibration = calibrate(log.recording("filtered"))
    assert not calibration.trusted
    assert np.abs((calibration.hard_iron - HARD_IRON) / calibration.sigma["hard_iron"]).max() < 2.5


@pytest.mark.parametrize(("motion", "seed"), [("moderate", 5049), ("tiny", 5019)])
def test_mixtures_of_scales_that_are_noise_say_nothing(motion: str, seed: int) -> None:
    """Of clean logs: their score is biased by the gyroscope's noise, to 18 nats."""
    fit = fit_field_chain(simulate(motion, seed=seed).recording)
    family = next(family for family in PHYSICAL if family.name == "gyroscope:scales")
    beside, motions = ColumnProducts(fit), WindowMotion.of(fit)
    (found,) = component.tested(beside, motions, [family])
    assert found.gain < 3
    every = beside.of(family.columns(motions))
    assert likeliest(every.normal, every.score, beside.square, beside.freedom, 0.3**2).gain > 10
    np.testing.assert_array_equal(found.moving.normal, every.normal)


def test_a_filter_that_noise_hides_has_the_size_that_the_delay_says() -> None:
    """Its column is the gyroscope's noise, by which nothing is learnt; left out, 12 µT were trusted at 3.3 sigmas."""
    log = record("moderate", 931, FAULTS["filtered-gyroscope"], 0.5, "filtered-gyroscope")
    sigma = calibrate(log.recording("filtered")).sigma["hard_iron"]
    assert sigma[2] > 6e-6
