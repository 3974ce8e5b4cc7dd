"""The parts that `NativeFactors` is made of, each against its definition."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, H, X
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors import (
    GyroscopeTrack,
    HealthLimits,
    KeyframeField,
    MagycError,
    alignment,
    keyframe_field_factor,
    unvech,
)
from magyc_gtsam.factors.alignment import AlignmentLimits, CoarseAlignment, HeadingVerdict
from magyc_gtsam.factors.block_fit import BlockFit, block_fit
from magyc_gtsam.factors.chain.heading_profile import HeadingProfile, block_rows, heading_profile, in_world
from magyc_gtsam.factors.delivered import sorted_factors
from magyc_gtsam.factors.guard import factor_details
from magyc_gtsam.factors.health import Monitor
from magyc_gtsam.factors.held_mounting import HeldMounting, MountingLimits
from magyc_gtsam.factors.kernels import narrowed
from magyc_gtsam.factors.solver import View, new_slots, update_solver
from magyc_gtsam.factors.staleness import Staleness

FIELD = np.array([20.0, 5.0, 43.0])  # µT


def test_nis_is_the_innovations():
    """A linear Gaussian problem: from the posterior residual, and from its definition νᵀS⁻¹ν before the block."""
    random = np.random.default_rng(0)
    before = np.linalg.inv(random.normal(size=(12, 12)) @ random.normal(size=(12, 12)).T + 3 * np.eye(12))
    before = before @ before.T + 0.1 * np.eye(12)
    for _ in range(5):
        jacobian, innovation = random.normal(size=(30, 12)), 2 * random.normal(size=30)
        spread = jacobian @ before @ jacobian.T + np.eye(30)
        expected = innovation @ np.linalg.solve(spread, innovation)
        after = np.linalg.inv(np.linalg.inv(before) + jacobian.T @ jacobian)
        residual = innovation - jacobian @ (after @ jacobian.T @ innovation)
        nis, freedom, scatter, _, _ = block_fit(
            jacobian.T @ jacobian, -jacobian.T @ residual, residual @ residual, after, 30, slice(6, 9)
        )
        seen = np.linalg.eigvalsh(np.eye(12) - np.linalg.cholesky(jacobian.T @ jacobian).T @ after
                                  @ np.linalg.cholesky(jacobian.T @ jacobian))  # fmt: skip
        if seen[0] > 0.02:
            assert freedom == 12
            assert nis + (30 - freedom) * scatter**2 == pytest.approx(expected)
        else:
            assert freedom == (seen > 0.02).sum() < 12


def test_the_offset_of_a_block_is_what_the_others_do_not_know():
    """One block among many of a known model, its readings off by a constant."""
    random = np.random.default_rng(1)
    design = random.normal(size=(40, 6, 9))
    truth, offset = random.normal(size=9), np.array([0.8, -0.5, 0.3])
    readings = design @ truth
    readings[-1] += design[-1][:, 6:] @ offset
    stacked = design.reshape(-1, 9)
    after = np.linalg.inv(stacked.T @ stacked)
    residual = design[-1] @ (after @ stacked.T @ readings.ravel()) - readings[-1]
    information = design[-1].T @ design[-1]
    *_, found, spread = block_fit(
        information, -design[-1].T @ residual, residual @ residual, after, 6, slice(6, 9)
    )
    np.testing.assert_allclose(found, offset, atol=0.2)
    assert (np.linalg.eigvalsh(spread) > 0).all()


def fit(time, offset=0.0, nis=3.0, calibration=(0, 1)):
    shift = np.array([offset, 0.0, 0.0])
    seen = np.array([2e-5, 1e-5, -3e-5])
    return BlockFit(time, nis, 3, 1.0, shift, 1e-7, np.eye(3), np.zeros(3), seen, seen + shift, calibration)


def test_the_words_of_a_disturbance_a_step_and_noise():
    monitor = Monitor(HealthLimits())
    for k in range(10):
        monitor.add(fit(2.0 * k))
    assert str(monitor.health) == "consistent"
    monitor.add(fit(20.0, 5e-6, 300.0))
    assert str(monitor.health) == "suspect: disturbance or step of 5.0 µT since 20.0 s"
    monitor.add(fit(22.0, 5e-6, 100.0))
    monitor.add(fit(24.0))
    assert monitor.health.by == "disturbance of 5.0 µT for 4 s"
    assert monitor.over == [(20.0, 24.0)]
    for k in range(200):
        monitor.add(fit(26.0 + 2 * k))
    assert monitor.health.status == "consistent"
    for k in range(20):
        monitor.add(fit(500.0 + 2 * k, 5e-6, 100.0))
    assert str(monitor.health) == "inconsistent: step of the hard iron of 5.0 µT since 500.0 s"
    monitor.add(fit(540.0, 5e-6, 100.0, calibration=(2, 3)))  # tied to the one before by a walk
    assert monitor.health.by == "step of the hard iron of 5.0 µT"
    monitor.add(fit(542.0, 5e-6, calibration=(4, 5)))  # free
    assert monitor.over == [(20.0, 24.0), (500.0, 542.0)]
    assert str(monitor.health) == "consistent"
    noisy = Monitor(HealthLimits())
    for k in range(10):
        each = fit(2.0 * k)
        noisy.add(
            BlockFit(*[getattr(each, name) if name != "scatter" else 2.0 for name in BlockFit.__annotations__])
        )
    assert noisy.health.by == "noise 2.0 times as stated"


def test_the_evidence_for_a_turned_mounting_is_that_of_a_joint_fit():
    """Blocks on a state that stays: block by block as in one least-squares fit of the state and θ together."""
    random, limits, n = np.random.default_rng(5), MountingLimits(excess=1.0), 4
    held, information, score, turn = HeldMounting(limits), np.eye(n), np.zeros(n), np.radians([1.0, -2.0, 1.5])
    state, whole, right = random.normal(size=n), np.diag(np.r_[np.ones(n), np.full(3, limits.prior**-2)]), 0.0
    for _ in range(20):
        on_state, on_turn = random.normal(size=(8, n)), 20 * random.normal(size=(8, 3))
        measured = on_state @ state + on_turn @ turn + random.normal(size=8)
        information, score = information + on_state.T @ on_state, score + on_state.T @ measured
        rows = np.column_stack([on_state, on_turn, measured - on_state @ np.linalg.solve(information, score)])
        held.add(rows.T @ rows, np.zeros(0), np.linalg.inv(information), counts=True)
        both = np.column_stack([on_state, on_turn])
        whole, right = whole + both.T @ both, right + both.T @ measured
    np.testing.assert_allclose(held.mean, np.linalg.solve(whole, right)[n:], rtol=1e-9)
    np.testing.assert_allclose(held.covariance, np.linalg.inv(whole)[n:, n:], rtol=1e-9)
    without = right[:n] @ np.linalg.solve(information, right[:n]) - np.linalg.slogdet(information)[1]
    free = right @ np.linalg.solve(whole, right) - np.linalg.slogdet(whole)[1] - 6 * np.log(limits.prior)
    assert held.evidence == pytest.approx(0.5 * (free - without), rel=1e-9)


@pytest.mark.parametrize(
    ("claimed", "on_turn", "blocks", "lever"), [(900.0, 1e-3, 0, 0.0), (0.9, 1e-3, 1, 0.9), (0.9, 1.0, 1, 0.0)]
)
def test_a_mounting_is_not_judged_by_what_the_solver_does_not_hold(claimed, on_turn, blocks, lever):
    """Left out with a covariance of another linearisation; D starts again in a graph that lacks the tilt."""
    held = HeldMounting(MountingLimits())
    rows = np.column_stack([1e-3 * np.eye(3), on_turn * np.eye(3), np.zeros(3)])
    held.add(rows.T @ rows, np.array([0.0, 0.0, 1.0]), claimed * 1e6 * np.eye(3), counts=True)
    assert bool(held._information.any()) == bool(blocks)
    assert np.linalg.eigvalsh(held.covariance)[0] > 0
    assert np.abs(held.shift).max(initial=0.0) == pytest.approx(lever)


def test_evidence_above_its_bound_is_as_rare_as_the_bound_says():
    """Where the mounting is right the evidence exceeds 10 at any of 60 blocks in at most a tenth of all runs."""
    random, limits, above = np.random.default_rng(6), MountingLimits(excess=1.0), 0
    for _ in range(100):
        held, information, score = HeldMounting(limits), np.eye(3), np.zeros(3)
        state, greatest = random.normal(size=3), -np.inf
        for _ in range(60):
            on_state, on_turn = random.normal(size=(4, 3)), 20 * random.normal(size=(4, 3))
            measured = on_state @ state + random.normal(size=4)
            information, score = information + on_state.T @ on_state, score + on_state.T @ measured
            rows = np.column_stack([on_state, on_turn, measured - on_state @ np.linalg.solve(information, score)])
            held.add(rows.T @ rows, np.zeros(0), np.linalg.inv(information), counts=True)
            greatest = max(greatest, held.evidence)
        above += greatest > np.log(10.0)
    assert above <= 20  # 10 of 100, 99.9 % of a binomial


@pytest.mark.parametrize("scale", [1e-3, 1e-2])
def test_a_quadratic_is_no_staler_than_what_has_moved_allows(scale):
    """The bound by which a block is not linearised again, where the estimate has come to fit it."""
    random, time = np.random.default_rng(8), np.arange(0, 2, 0.01)
    for _ in range(10):
        rate = 0.5 * random.normal(size=3) + 0.1 * random.normal(size=(200, 3))
        bias, rotation = 0.01 * random.normal(size=3), gtsam.Rot3.Expmap(random.normal(size=3))
        soft_iron, hard_iron = np.r_[1.1, 0.02, -0.03, 0.9, 0.01, 1.05], np.array([5.0, -3, 2])
        bare = KeyframeField.from_samples((time, np.full((200, 3), 1e-9)), (time, rate), 1.98)
        seen, _ = bare.error(1e-6, rotation.matrix().T @ FIELD, unvech(soft_iron), hard_iron, bias)
        block = replace(bare, field=1e-6 * (seen + random.normal(size=seen.shape)))
        graph, fitting = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.push_back(keyframe_field_factor(1, 2, 3, block, 1e-6, field=FIELD * 1e-6, gyro_bias_key=4))
        fitting.insert(1, rotation)
        fitting.insert(2, soft_iron)
        fitting.insert(3, hard_iron)
        fitting.insert(4, gtsam.imuBias.ConstantBias(np.zeros(3), bias))
        (delivered,) = sorted_factors(graph).fresh
        step = gtsam.VectorValues()
        for key, size in ((1, 3), (2, 6), (3, 3), (4, 6)):
            step.insert(key, scale * random.normal(size=size))
        delivered.make(View(fitting.retract(step)))
        exact, stale = (
            each.linearize(fitting).augmentedInformation() for each in (delivered.factor, delivered.native)
        )
        information = np.diag(exact)[:-1]
        seen = information > 0
        true = np.abs(exact[:-1, -1] - stale[:-1, -1])[seen] / np.sqrt(information[seen])
        bound = delivered.renew(View(fitting), tolerance=np.inf)
        assert true.max() < bound < 100 * true.max()


def test_a_quadratic_is_made_anew_at_its_first_look_where_it_is_less_stale_than_later():
    """Which spares looks at one that is always near the tolerance."""
    random, time = np.random.default_rng(9), np.arange(0, 2, 0.01)
    rate, soft_iron = 0.5 * random.normal(size=(200, 3)), np.r_[1.1, 0.02, -0.03, 0.9, 0.01, 1.05]
    hard_iron, rotation = np.array([5.0, -3, 2]), gtsam.Rot3.Expmap(random.normal(size=3))
    bare = KeyframeField.from_samples((time, np.full((200, 3), 1e-9)), (time, rate), 1.98)
    seen, _ = bare.error(1e-6, rotation.matrix().T @ FIELD, unvech(soft_iron), hard_iron, np.zeros(3))
    block = replace(bare, field=1e-6 * (seen + random.normal(size=seen.shape)))
    graph, fitting, step = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.VectorValues()
    graph.push_back(keyframe_field_factor(1, 2, 3, block, 1e-6, field=FIELD * 1e-6))
    for key, value in ((1, rotation), (2, soft_iron), (3, hard_iron)):
        fitting.insert(key, value)
        step.insert(key, 3e-3 * random.normal(size=fitting.extract([key]).dim()))
    moved = fitting.retract(step)
    delivered, stale = (sorted_factors(graph).fresh[0] for _ in range(2))
    stale.make(View(moved))
    shift = stale.renew(View(fitting), 1e-9)
    delivered.make(View(moved))
    for end, anew in ((fitting, True), (moved, False), (fitting, False)):
        native = delivered.native
        delivered.renew(View(end), 3 * shift)
        assert (delivered.native is not native) is anew


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"delay_key": 5},
        {"gyro_bias_key": 4},
        {"robust": "cauchy"},
        {"gyro_bias_key": 4, "body_R_gyroscope": gtsam.Rot3.RzRyRx(3.0, -0.4, 1.5)},
    ],
)
def test_a_block_tells_what_its_held_mounting_would_do(options):
    """The columns that it keeps beside its own are those of the factor with the mounting as a variable."""
    random, time = np.random.default_rng(7), np.arange(0, 1, 0.01)
    rates = 0.3 * random.normal(size=(100, 3))
    mounting = gtsam.Rot3.Expmap(np.array([0.3, -0.8, 1.1]))
    block = KeyframeField.from_samples(
        (time, 3e-5 * random.normal(size=(100, 3))), (time, rates), 0.5, body_R_sensor=mounting
    )
    factor = keyframe_field_factor(1, 2, 3, block, 1e-6, field=[2e-5, 1e-6, 4e-5], field_unit=5e-5, **options)
    graph, point = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(factor)
    point.insert(1, gtsam.Pose3(gtsam.Rot3.Expmap(random.normal(size=3)), np.zeros(3)))
    point.insert(2, np.r_[1.1, 0.02, -0.03, 0.9, 0.01, 1.05])
    point.insert(3, gtsam.Point3(0.1, -0.3, 0.2))
    point.insert(4, random.normal(size=3) * 1e-3)
    point.insert(5, 0.004)
    (delivered,) = sorted_factors(graph).fresh
    delivered.make(View(point))
    keys = list(factor.keys())
    step, moved = 1e-9 * random.normal(size=30), gtsam.VectorValues()
    for key in keys:
        size = point.zeroVectors().at(key).size
        moved.insert(key, step[:size])
    there = point.extract(keys).retract(moved)
    plain, joined = delivered.products(there)
    there.insert(9, mounting)
    ordering = gtsam.Ordering()
    for key in [*keys, 9]:
        ordering.push_back(key)
    free = gtsam.GaussianFactorGraph()
    free.push_back(delivered.details.freed(9).linearize(there))
    matrix = free.augmentedHessian(ordering)
    np.testing.assert_allclose(joined, matrix, atol=1e-6 * np.abs(matrix).max())
    kept = np.r_[0 : len(plain) - 1, len(matrix) - 1]
    np.testing.assert_allclose(joined[np.ix_(kept, kept)], plain, atol=1e-9 * np.abs(plain).max())


@pytest.mark.parametrize("off", [0.0, 1.0, -2.5, np.pi])
def test_the_profile_finds_how_far_the_heading_is_off(off):
    random = np.random.default_rng(2)
    soft_iron, hard_iron = np.eye(3) + np.diag([0.1, -0.05, 0.02]), np.array([12.0, -20, 8])
    rows = []
    for _ in range(15):
        rotation = Rotation.from_euler("zyx", random.uniform(-1, 1, 3) * [3.0, 0.4, 0.4]).as_matrix()
        design = np.stack([Rotation.from_rotvec(0.05 * random.normal(size=3)).as_matrix() for _ in range(30)])
        field = design @ rotation.T @ FIELD @ soft_iron + hard_iron + 0.5 * random.normal(size=(30, 3))
        turned = Rotation.from_euler("z", -off).as_matrix() @ rotation
        compressed = block_rows(design, np.ones(30), field)
        assert compressed.shape == (13, 13)
        rows.append(in_world(compressed, turned))
    prior = np.diag(np.r_[np.full(6, 1 / 0.3**2), np.full(3, 1 / 50**2)])
    profile = heading_profile(np.vstack(rows), FIELD, 0.5, 450, 15, np.r_[1, 0, 0, 1, 0, 1, 0, 0, 0.0], prior)
    assert abs((profile.best - off + np.pi) % (2 * np.pi) - np.pi) < np.radians(4)
    assert profile.within(np.radians(20), off) > 0.95


def test_the_profile_excludes_headings_that_need_a_negative_soft_iron():
    """A field in the wrong axes: −A at another heading fits the samples exactly."""
    random, wrong, rows = np.random.default_rng(2), FIELD[[1, 0, 2]] * [1, 1, -1], []
    for _ in range(15):
        rotation = Rotation.from_euler("zyx", random.uniform(-1, 1, 3) * [3.0, 0.4, 0.4]).as_matrix()
        field = rotation.T @ FIELD + 0.5 * random.normal(size=(30, 3))
        rows.append(in_world(block_rows(np.tile(np.eye(3), (30, 1, 1)), np.ones(30), field), rotation))
    prior = np.diag(np.r_[np.full(6, 1 / 0.3**2), np.full(3, 1 / 50**2)])
    profile = heading_profile(np.vstack(rows), wrong, 0.5, 450, 15, np.r_[1, 0, 0, 1, 0, 1, 0, 0, 0.0], prior)
    upturned = np.arctan2(wrong[1], wrong[0]) - np.arctan2(-FIELD[1], -FIELD[0])
    assert profile.within(np.radians(15), upturned) == 0.0
    assert profile.probability.sum() == pytest.approx(1.0)


_VAGUE = (np.r_[1, 0, 0, 1, 0, 1, 0, 0, 0.0], np.diag(np.r_[np.full(6, 1 / 0.2**2), np.full(3, 1 / 40**2)]))


def two_blocks_in_a_turn(off):
    """A coarse alignment with two blocks, and the graph's values at a heading that is `off` rad wrong."""
    time, turn = np.linspace(0, 2, 51), 1.2
    aligned, values = CoarseAlignment(AlignmentLimits()), gtsam.Values()
    for k in range(2):
        rotation = gtsam.Rot3.Ypr(0.3 + 2 * turn * k, 0.3 - 0.5 * k, 0.2)
        body = Rotation.from_rotvec(-turn * (time - 2.0)[:, None] * rotation.matrix()[2]).as_matrix()
        field = 1e-6 * (body @ (rotation.matrix().T @ FIELD) + [12.0, -20, 8])
        rate = np.tile(turn * rotation.matrix()[2], (51, 1))
        block = KeyframeField.from_samples((time, field), (time, rate), 2.0)
        factor = keyframe_field_factor(X(k), A(0), H(0), block, 0.3e-6, field=1e-6 * FIELD)
        aligned.add(factor_details(factor))
        values.insert(X(k), gtsam.Rot3.Rz(-off) * rotation)
    return aligned, values


@pytest.mark.parametrize(("off", "verdict"), [(0.0, HeadingVerdict.NEAR), (2.8, HeadingVerdict.APART)])
def test_two_blocks_say_that_a_heading_is_wrong_before_they_say_which_is_right(off, verdict):
    """A vague prior of the irons: two blocks in a turn allow many headings, but not the graph's own."""
    aligned, values = two_blocks_in_a_turn(off)
    assert aligned.judge(values, *_VAGUE) is verdict


def test_verdicts_go_on_where_the_number_of_blocks_stays_the_same():
    """At the largest number of blocks, and in a fixed lag from which as many leave as are added."""
    aligned, values = two_blocks_in_a_turn(0.0)
    aligned.limits = replace(aligned.limits, blocks=40)
    for _ in range(50):
        aligned.add(aligned.last)
    assert len(aligned) == 40
    for _ in range(2):
        assert aligned.due
        aligned.judge(values, *_VAGUE)
        for _ in range(4):
            assert not aligned.due
            aligned.add(aligned.last)


def test_a_heading_at_the_edge_of_near_is_turned_as_one_that_is_far(monkeypatch):
    """The best heading is 23° off: nearer than 25°, but never surely so. Blocks waited for minutes or for ever."""
    angle = np.radians(np.arange(-180.0, 180.0, 2.0))
    probability = np.exp(-0.5 * ((angle + np.radians(23)) / np.radians(6)) ** 2)
    profile = HeadingProfile(angle, probability / probability.sum())
    monkeypatch.setattr(alignment, "heading_profile", lambda *_: profile)
    aligned, values = two_blocks_in_a_turn(0.4)
    verdicts = [aligned.judge(values, *_VAGUE) for _ in range(3)]
    assert verdicts == [HeadingVerdict.UNDECIDED, HeadingVerdict.UNDECIDED, HeadingVerdict.FAR]


def test_quadratics_are_looked_at_until_they_are_settled():
    staleness, all_of_them = Staleness(2, 2.0), list(range(9))
    assert staleness.due(all_of_them[:1], 1) == [0]
    assert staleness.due(all_of_them[:3], 1) == [
        0,
        1,
        2,
    ]  # all: from two on, then each time that they have doubled
    assert staleness.due(all_of_them[:5], 1) == [3, 4]
    assert staleness.due(all_of_them[:6], 2) == [0, 1, 2, 3, 4, 5]
    assert staleness.pending
    assert staleness.due(all_of_them[:8], 0) == [6, 7]  # what has just entered
    assert not staleness.pending
    staleness.found([3.0, 0.2, 0.4, 0.1])
    assert staleness.due(all_of_them[:8], 1) == [4, 5, 6, 7]  # from the one that was stale
    staleness.found([0.2, 3.0, 0.1, 0.1])
    assert staleness.due(all_of_them, 0) == [5, 6, 7, 8]  # with what entered since
    staleness.found([0.2, 0.9, 0.1, 0.1])
    assert not staleness.pending


def test_a_kernel_is_as_wide_as_the_blocks_misfit():
    assert narrowed([]) == narrowed([0.8, 1.1, np.nan]) == 1.0
    assert narrowed([40.0, 50.0, 60.0, np.nan]) == 50.0
    assert narrowed([1.0, 0.9, 1.1, 80.0]) == pytest.approx(1.05)


@pytest.mark.parametrize("interval_mean", [False, True])
def test_a_track_between_stamps_is_the_track_with_more_stamps(interval_mean):
    time = np.linspace(0, 5, 251)
    rate = np.stack([np.sin(time), 0.5 * np.cos(2 * time), 0.3 + 0 * time], axis=1)
    bias, when = np.array([0.01, -0.02, 0.03]), np.array([0.011, 1.2345, 4.87])
    track = GyroscopeTrack.integrate(time, rate, bias, interval_mean=interval_mean)
    finer = GyroscopeTrack.integrate(
        time, rate, bias, interval_mean=interval_mean, stamps=np.unique(np.r_[time, when])
    )
    (p, q), _ = track.rotation_at(when)
    rows = np.searchsorted(finer.time, when)
    np.testing.assert_allclose(p, finer.rotation[0][rows], atol=2e-6)
    np.testing.assert_allclose(q, finer.rotation[1][rows], atol=2e-6)
    np.testing.assert_allclose(track.lever_at(when), finer.lever[:, rows], atol=2e-4)
    exact = Rotation.from_matrix(track.matrices[:, -1].reshape(3, 3))
    turned = Rotation.identity()
    for step in np.diff(time)[:, None] * (rate[1:] - bias) if interval_mean else track.increment:
        turned = turned * Rotation.from_rotvec(step)
    assert (turned.inv() * exact).magnitude() < 1e-9


def test_a_view_puts_new_values_on_top():
    graph, values, new = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.Values()
    for key, sigma in ((A(0), 0.5), (H(0), 2.0)):
        graph.addPriorVector(key, np.ones(3), gtsam.noiseModel.Isotropic.Sigma(3, sigma))
        values.insert(key, np.zeros(3))
    new.insert(X(0), gtsam.Rot3())
    isam = gtsam.ISAM2()
    result = update_solver(isam, graph, values, None, [])
    assert new_slots(isam, result, [graph.at(0), graph.at(1)]) == [0, 1]
    view = View(isam, new)
    assert view.exists(X(0))
    assert view.exists(A(0))
    assert not view.exists(X(1))
    np.testing.assert_allclose(view.values([A(0), X(0)]).atPoint3(A(0)), 1.0)
    np.testing.assert_allclose(view.covariance([H(0), A(0)]), np.diag(np.r_[np.full(3, 4.0), np.full(3, 0.25)]))


def test_a_block_knows_its_time():
    time = np.linspace(0, 1, 11)
    block = KeyframeField.from_samples(
        (time, np.full((11, 3), 3e-5)), (time - 0.5, np.zeros((11, 3))), 0.0, delay=0.5
    )
    assert block.time == pytest.approx(0.0)
    with pytest.raises(MagycError, match="likely unit: deg/s"):
        KeyframeField.from_samples((time, np.full((11, 3), 3e-5)), (time, np.full((11, 3), 90.0)), 0.5)
