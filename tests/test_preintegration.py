"""Chains of rotations, and the windows that bring both sensors' samples together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import cumulative_trapezoid, solve_ivp
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors import MagycError
from magyc_gtsam.factors.chain import preintegration, rotations
from magyc_gtsam.factors.chain.gyroscope_track import running_sums
from magyc_gtsam.factors.chain.median import median
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rotations import chain, exponential, increments, matrices, multiply, skew
from magyc_gtsam.simulation import simulate

SINGLE = 1e-9  # rad a window may turn: every sample is its own window


def as_matrices(spinor):
    """(n, 3, 3)"""
    return matrices(spinor).T.reshape(-1, 3, 3)


def field(n, seed=0):
    return np.random.default_rng(seed).normal(0, 5e-5, (n, 3))


def attitudes(time, rate, bias=None):
    """Rotations from the first stamp to each stamp, one increment after the other (scipy)."""
    found = [Rotation.identity()]
    for step in increments(time, rate, bias):
        found.append(found[-1] * Rotation.from_rotvec(step))
    return Rotation.concatenate(found)


# --- rotations ---


def test_exponential_and_product_are_scipys():
    rng = np.random.default_rng(0)
    vectors = np.vstack(
        [np.zeros(3), [1e-300, 0, 0], 1e-9 * rng.normal(size=(3, 3)), 3 * rng.normal(size=(20, 3))]
    )
    first, second = exponential(vectors), exponential(vectors[::-1])
    theirs = Rotation.from_rotvec(vectors), Rotation.from_rotvec(vectors[::-1])
    np.testing.assert_allclose(as_matrices(first), theirs[0].as_matrix(), atol=1e-15)
    np.testing.assert_allclose(
        as_matrices(multiply(first, second)), (theirs[0] * theirs[1]).as_matrix(), atol=2e-15
    )


@pytest.mark.parametrize("n", [0, 1, 2, 15, 16, 17, 31, 32, 33, 255, 256, 257, 300, 4097])
def test_chain_is_the_product_one_after_the_other(n):
    """All lengths at which blocks, and blocks of blocks, begin and end."""
    vectors = np.random.default_rng(n).normal(size=(n, 3))
    expected = [Rotation.identity()]
    for vector in vectors:
        expected.append(expected[-1] * Rotation.from_rotvec(vector))
    found = chain(exponential(vectors))
    assert len(found[0]) == n + 1
    np.testing.assert_allclose(as_matrices(found), Rotation.concatenate(expected).as_matrix(), atol=1e-12)


def test_a_long_chain_stays_a_rotation():
    p, q = chain(exponential(np.random.default_rng(0).normal(size=(100_000, 3))))
    np.testing.assert_allclose(np.abs(p) ** 2 + np.abs(q) ** 2, 1, rtol=0, atol=1e-13)


@pytest.mark.parametrize("n", [1, 23, 24, 25, 1000])
def test_running_sums_are_cumulative_sums(n):
    values = np.random.default_rng(n).normal(size=(3, n))
    np.testing.assert_allclose(running_sums(values), np.cumsum(values, axis=1), rtol=0, atol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 7, 8])
def test_the_median_is_numpys(n):
    values = np.random.default_rng(n).normal(size=n)
    assert median(values) == np.median(values)


@pytest.mark.parametrize("motion", ["wide", "dive"])
def test_increments_are_of_fourth_order_in_the_middle(motion):
    """Against the simulator's attitudes: a step half as long is 16 times less wrong; plain trapezoids, 8 times."""
    errors = []
    for rate in (5, 10):
        log = simulate(
            motion, duration=20, rate=rate, seed=1, gyroscope_noise=0, gyro_bias=[0.01, 0.02, 0.03]
        ).recording
        attitude = Rotation.from_quat(log.attitude)
        true = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
        found = increments(log.time, log.angular_rate, np.array([0.01, 0.02, 0.03]))
        errors.append(np.linalg.norm(found - true, axis=1)[2:-2].max())
    if motion == "wide":
        assert errors[0] < 2e-6
        assert errors[1] < errors[0] / 20
    else:  # its acceleration jumps at the waypoints
        assert errors[1] < 1e-3 / 12


def test_increments_of_uneven_steps():
    """Half of the samples lost at random: a step is wrong by hundredths of what plain trapezoids lose."""
    log = simulate("moderate", duration=60, rate=20, seed=1, gyroscope_noise=0, gyro_bias=[0, 0, 0]).recording
    kept = np.random.default_rng(0).random(len(log.time)) < 0.5
    attitude, time, rate = Rotation.from_quat(log.attitude[kept]), log.time[kept], log.angular_rate[kept]
    assert np.diff(time).max() > 0.3
    true = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    plain = 0.5 * np.diff(time)[:, None] * (rate[1:] + rate[:-1])
    wrong, lost = (
        np.sqrt(np.square(found - true)[1:-1].sum(axis=1).mean()) for found in (increments(time, rate), plain)
    )
    assert wrong < lost / 10


def test_increments_of_few_samples_keep_an_oscillation():
    """Samples a second apart on average, at random, keep a period of 20 s to 1 %; by neighbours alone 5 % is lost."""
    random = np.random.default_rng(0)
    time, frequency = np.cumsum(random.exponential(1.0, 20000)), 0.3
    rate = 0.3 * np.cos(frequency * time)[:, None] * [0, 1, 0]
    true = np.diff(np.sin(frequency * time))
    found = increments(time, rate + random.normal(0, 5e-3, rate.shape))[:, 1]
    assert found @ true / (true @ true) == pytest.approx(1, abs=0.015)


def test_increments_take_no_derivative_across_a_hole():
    """There the trapezoid is all that is known, and it is kept from neighbours that know more."""
    time = np.r_[0.0, 0.1, 0.2, 0.3, 5.0, 5.1, 5.2, 5.3]
    rate = np.outer(np.r_[1.0, 1.0, 1.0, 1.0, 3.0, 3.0, 3.0, 3.0], [0.1, 0, 0])
    expected = np.outer(np.r_[0.1, 0.1, 0.1, 2 * 4.7, 0.3, 0.3, 0.3], [0.1, 0, 0])
    np.testing.assert_allclose(increments(time, rate), expected, atol=1e-15)


def test_skew_is_the_cross_product():
    a, b = np.random.default_rng(0).normal(size=(2, 4, 5, 3))
    np.testing.assert_allclose(np.einsum("...ij,...j->...i", skew(a), b), np.cross(a, b), atol=1e-15)


# --- the windows ---


def walk(n=400, rate=20.0, seed=0, speed=0.5):
    """Smooth rates at 20 Hz: (G,) s, (G, 3) rad/s."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) / rate
    phase, frequency = rng.uniform(0, 6, (2, 3))
    return time, speed * np.sin(time[:, None] * frequency + phase)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**31),
    st.floats(0.05, 3.0),
    st.floats(0.02, 2.0),
    st.floats(0, 8),
)
def test_no_window_is_longer_or_turns_more_than_said(seed, length, turn, speed):
    rng = np.random.default_rng(seed)
    gyro_time = np.cumsum(rng.uniform(0.01, 0.05, 300))
    mag_time = np.cumsum(rng.uniform(0.02, 0.08, 100))
    rate = rng.normal(size=(300, 3)) * speed
    samples = Preintegration(mag_time, field(100), gyro_time, rate, length=length, turn=turn)
    inside = mag_time[(mag_time >= gyro_time[0]) & (mag_time <= gyro_time[-1])]
    np.testing.assert_array_equal(samples.magnetometer_time, inside)
    ends = np.append(samples.starts[1:], len(inside)) - 1
    duration = inside[ends] - inside[samples.starts]
    assert (duration <= length * (1 + 1e-9)).all()
    path = cumulative_trapezoid(np.linalg.norm(rate, axis=1), gyro_time, initial=0)
    path = np.interp(inside, gyro_time, path)
    assert (path[ends] - path[samples.starts] <= turn * (1 + 1e-9)).all()
    windows = samples.integrate()
    assert windows.count.sum() == len(inside)
    np.testing.assert_allclose((windows.field * windows.count).sum(axis=1), samples.magnetic_field.sum(axis=0))


def test_a_still_vehicle_has_windows_of_the_longest_length():
    time, _ = walk(n=401)
    windows = Preintegration(time, field(401), time, np.zeros((401, 3)), length=1.0).integrate()
    np.testing.assert_array_equal(windows.count[:-1], 20)
    np.testing.assert_allclose(np.diff(windows.time[:-1]), 1.0)
    np.testing.assert_allclose(windows.rotation, np.repeat(np.eye(3)[:, :, None], len(windows), axis=2))


def test_means_over_each_window():
    """Mean field, stamp and Rᵀ of the samples between two starts."""
    time, rate = walk()
    bias = np.array([0.1, -0.2, 0.05])
    samples = Preintegration(time, field(400), time, rate, turn=0.3)
    windows = samples.integrate(bias)
    backward = attitudes(time, rate, bias).as_matrix().transpose(0, 2, 1)
    groups = np.split(np.arange(400), samples.starts[1:])
    assert 10 < len(groups) < 200
    for n, group in enumerate(groups):
        np.testing.assert_allclose(windows.field[:, n], field(400)[group].mean(axis=0))
        np.testing.assert_allclose(windows.time[n], time[group].mean())
        np.testing.assert_allclose(windows.rotation[:, :, n], backward[group].mean(axis=0), atol=1e-12)


def test_windows_read_the_field_however_far_they_turn():
    """mean(m) = B M g + h exactly; with R at the centre in the place of M it is wrong by a tenth."""
    time, rate = walk(speed=1.0)
    world, hard_iron = np.array([20e-6, 5e-6, 40e-6]), np.array([1e-6, 2e-6, 3e-6])
    soft_iron = np.array([[1.1, 0.1, 0.0], [0.1, 0.9, 0.1], [0.0, 0.1, 1.0]])
    m = attitudes(time, rate).inv().apply(world) @ soft_iron.T + hard_iron
    windows = Preintegration(time, m, time, rate, turn=1.0).integrate()
    explained = np.einsum("ij,jkn,k->in", soft_iron, windows.rotation, world) + hard_iron[:, None]
    np.testing.assert_allclose(windows.field, explained, atol=1e-18)
    shortened = np.linalg.norm(np.einsum("ijn,j->in", windows.rotation, world), axis=0)
    assert shortened.min() < 0.97 * np.linalg.norm(world)


def test_lever_is_the_derivative_with_respect_to_the_bias():
    """R(b + δ) = Exp(K δ) R(b), K̄' − K̄ between neighbours; every sample a window of its own."""
    time, rate = walk(n=200)
    samples = Preintegration(time, field(200), time, rate, turn=SINGLE)
    bias, step = np.array([0.02, -0.01, 0.03]), 1e-6
    windows = samples.integrate(bias)
    numeric = np.empty((3, 3, 200))
    for i, unit in enumerate(np.eye(3)):
        ahead, behind = (samples.integrate(bias + s * step * unit).rotation for s in (1, -1))
        turned = np.einsum("jin,jkn->nik", ahead, behind)  # R' Rᵀ
        numeric[:, i] = Rotation.from_matrix(turned).as_rotvec().T / (2 * step)
    np.testing.assert_allclose(windows.lever, np.diff(numeric), atol=0.05 * 1e-3)  # steps of 0.05 s


@pytest.mark.parametrize("interval_mean", [False, True])
@pytest.mark.parametrize(("turn", "tolerance"), [(SINGLE, 2e-4), (0.2, 0.03)])
def test_rotation_rate_is_the_derivative_with_respect_to_the_delay(interval_mean, turn, tolerance):
    """For single samples; over a window, the product of the means comes close to the mean of the products."""
    time, rate = walk()
    mag_time = time[:-1] + 0.011  # off the gyroscope's stamps, at which the rate has kinks
    samples = Preintegration(mag_time, field(399), time, rate, interval_mean, turn=turn)
    bias, delay, step = np.array([0.02, -0.01, 0.03]), 0.004, 1e-5
    ahead, behind = (samples.integrate(bias, delay + s * step).rotation for s in (1, -1))
    found, numeric = samples.integrate(bias, delay).rotation_rate, (ahead - behind) / (2 * step)
    np.testing.assert_allclose(found, numeric, atol=tolerance * np.abs(numeric).max())


@pytest.mark.parametrize("delay", [0.05, -0.05, 0.0225])
def test_a_delay_reads_the_attitude_of_earlier(delay):
    time, rate = walk()
    inner = np.arange(60, 340)
    late = Preintegration(time[inner], field(280), time, rate, turn=SINGLE).integrate(delay=delay)
    prompt = Preintegration(time[inner] - delay, field(280), time, rate, turn=SINGLE).integrate()
    np.testing.assert_allclose(late.rotation, prompt.rotation, atol=1e-13)


@pytest.mark.parametrize("interval_mean", [False, True])
def test_the_attitude_has_no_jump_at_the_gyroscopes_stamps(interval_mean):
    """A nanosecond before a stamp it is what it is at the stamp, also for noisy rates."""
    time, rate = walk()
    rate = rate + 5e-3 * np.random.default_rng(0).normal(size=rate.shape)
    samples = Preintegration(time[1:-1], field(398), time, rate, interval_mean, turn=SINGLE)
    at, before = (samples.integrate(delay=delay).rotation for delay in (0.0, 1e-9))
    np.testing.assert_allclose(before, at, atol=1e-8)


@pytest.mark.parametrize("interval_mean", [False, True])
def test_the_magnetometer_has_stamps_of_its_own(interval_mean):
    """Between two gyroscope stamps the rate is linear, or constant: the attitude there is the integral's."""
    gyro_time, rate = walk(n=40)
    mag_time = np.sort(np.random.default_rng(1).uniform(0, gyro_time[-1], 30))
    bias = np.array([0.05, 0.02, -0.03])
    windows = Preintegration(mag_time, field(30), gyro_time, rate, interval_mean, turn=SINGLE).integrate(bias)
    for n, when in enumerate(mag_time):
        left = np.searchsorted(gyro_time, when, side="right") - 1
        since, step = when - gyro_time[left], gyro_time[left + 1] - gyro_time[left]
        if interval_mean:
            turned = Rotation.identity()
            for k in range(left):
                turned = turned * Rotation.from_rotvec((rate[k + 1] - bias) * 0.05)
            rest = (rate[left + 1] - bias) * since
        else:
            turned = attitudes(gyro_time, rate, bias)[left]
            rest = (rate[left] + 0.5 * (rate[left + 1] - rate[left]) * since / step - bias) * since
        turned = turned * Rotation.from_rotvec(rest)
        # Instant rates between stamps: linear to the first order, whatever corrects the whole step.
        np.testing.assert_allclose(
            windows.rotation[:, :, n], turned.as_matrix().T, atol=1e-13 if interval_mean else 3e-4
        )


def test_delta_angles_are_integrated_exactly():
    """Rates that are constant between stamps, as delta angles: against the differential equation."""
    rng = np.random.default_rng(3)
    time, rate = np.arange(6) / 2, rng.normal(size=(6, 3))
    mag_time = np.array([0.3, 0.9, 1.0, 1.7, 2.5])
    windows = Preintegration(mag_time, field(5), time, rate, interval_mean=True, turn=SINGLE).integrate()

    def kinematics(t, flat):
        return (flat.reshape(3, 3) @ skew(rate[min(int(t * 2) + 1, 5)])).ravel()

    for n, when in enumerate(mag_time):
        attitude = np.eye(3).ravel()
        for start in np.arange(0, when, 0.5):  # piece by piece, so that no step crosses a jump
            end = min(start + 0.5, when)
            attitude = solve_ivp(
                lambda t, y, k=start: kinematics(min(max(t, k + 1e-9), k + 0.5 - 1e-9), y),
                (start, end), attitude, rtol=1e-11, atol=1e-13,
            ).y[:, -1]  # fmt: skip
        np.testing.assert_allclose(windows.rotation[:, :, n], attitude.reshape(3, 3).T, atol=1e-9)


def test_different_rates_agree():
    """A smooth motion seen at 10 and at 200 Hz differs by a power of the step only."""
    fine_time = np.arange(4001) / 200
    fine = 0.3 * np.sin(fine_time[:, None] * [0.7, 1.1, 0.9] + [0, 1, 2])
    mag_time = np.arange(1, 200) / 10
    errors = []
    for every in (20, 10):
        coarse = Preintegration(mag_time, field(199), fine_time[::every], fine[::every], turn=SINGLE).integrate()
        exact = Preintegration(mag_time, field(199), fine_time, fine, turn=SINGLE).integrate()
        errors.append(np.abs(coarse.rotation - exact.rotation).max())
    assert errors[0] < 1e-4
    assert errors[1] < errors[0] / 7


def walk_with_holes():
    """Three stretches of 5 s at 20 Hz, 25 s apart."""
    time, rate = walk(n=100)
    return np.concatenate([time, time + 30.0, time + 60.0]), np.tile(rate, (3, 1))


def test_holes_part_the_chain():
    """Between the last stamp before a hole and the first one after it, no window and no link."""
    time, rate = walk_with_holes()
    samples = Preintegration(time, field(300), time, rate)
    assert {100, 200} < set(samples.starts.tolist())
    parted = samples.starts[1:][~samples.integrate().linked]
    np.testing.assert_array_equal(parted, [100, 200])


def test_a_magnetometer_that_goes_on_through_a_hole_is_not_read_there():
    """Without a gyroscope the attitude is unknown: those samples tell nothing."""
    time, rate = walk_with_holes()
    mag_time = np.arange(0, 64.9, 0.1)
    samples = Preintegration(mag_time, field(len(mag_time)), time, rate)
    windows = samples.integrate()
    nearest = np.abs(samples.magnetometer_time[:, None] - time).min(axis=1)
    assert len(nearest) == pytest.approx(150, abs=3)
    assert nearest.max() < 0.06
    assert (~windows.linked).sum() == 2


def test_a_hole_of_the_magnetometer_parts_nothing():
    """The gyroscope bridges it."""
    time, rate = walk(n=300)
    kept = np.r_[:50, 250:300]
    samples = Preintegration(time[kept], field(100), time, rate)
    assert 50 in samples.starts
    assert samples.integrate().linked.all()


def test_link_time_is_the_sum_of_squared_steps():
    time = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.1, 50))
    windows = Preintegration(time[::5], field(10), time, np.zeros((50, 3)), turn=SINGLE, length=0.01).integrate()
    squares = np.cumsum(np.append(0, np.diff(time) ** 2))[::5]
    np.testing.assert_allclose(windows.link_time, np.diff(squares))


@pytest.mark.parametrize("chunk", [1, 7, 64])
def test_chunks_do_not_show(monkeypatch, chunk):
    """Whole windows per chunk, also where a window is longer than a chunk."""
    time, rate = walk(speed=0.2)
    samples = Preintegration(time[:-1] + 0.013, field(399), time, rate)
    whole = samples.integrate(np.full(3, 0.01), 0.02)
    assert whole.count.max() > 7
    monkeypatch.setattr(preintegration, "_CHUNK", chunk)
    for name in (
        "time",
        "count",
        "field",
        "rotation",
        "rotation_bias",
        "rotation_rate",
        "lever",
        "link_time",
        "linked",
    ):
        pieces = getattr(samples.integrate(np.full(3, 0.01), 0.02), name)
        np.testing.assert_allclose(pieces, getattr(whole, name), atol=1e-13, err_msg=name)


def test_block_length_does_not_show(monkeypatch):
    steps = exponential(np.random.default_rng(0).normal(size=(100, 3)))
    whole = as_matrices(chain(steps))
    monkeypatch.setattr(rotations, "_BLOCK", 3)
    np.testing.assert_allclose(as_matrices(chain(steps)), whole, atol=1e-13)


@pytest.mark.parametrize("shift", [-1000.0, 1000.0])
def test_no_magnetometer_inside_the_gyroscopes_time(shift):
    time, rate = walk()
    with pytest.raises(MagycError, match=r"0 magnetometer samples inside .*\(0.000 to 19.950 s\), at least 3"):
        Preintegration(time + shift, field(400), time, rate)


def test_rotation_bias_is_the_derivative_with_respect_to_the_bias():
    """Against windows integrated at another bias, brought to the frame of the window's mean lever.

    The derivative is to first order in the turn inside a window.
    """
    time = np.arange(400) / 20
    rate = np.stack([np.sin(0.7 * time), np.cos(time), np.sin(1.3 * time)], axis=1)
    samples = Preintegration(time, field(400), time, rate, turn=0.2)
    here, step = samples.integrate(), 1e-4
    for axis in range(3):
        numeric = np.zeros_like(here.rotation)
        for sign in (1, -1):
            there = samples.integrate(sign * step * np.eye(3)[axis])
            lever = np.cumsum(np.concatenate([np.zeros((3, 3, 1)), here.lever], axis=2), axis=2)[:, axis]
            # The frames differ by the lever of the first window's mean, a constant turn of the world.
            turn = Rotation.from_rotvec(sign * step * lever.T).as_matrix()
            numeric += sign * np.einsum("ijn,njk->ikn", there.rotation, turn) / (2 * step)
        generators = np.stack([Rotation.from_rotvec(e).as_matrix() - np.eye(3) for e in 1e-7 * np.eye(3)]) / 1e-7
        design = np.einsum("ijn,mjk->iknm", here.rotation, generators).reshape(-1, 3)
        found = here.rotation_bias[:, :, axis]
        constant = np.linalg.lstsq(design, (numeric - found).ravel(), rcond=None)[0]
        predicted = found + (design @ constant).reshape(found.shape)
        np.testing.assert_allclose(numeric, predicted, atol=0.05 * np.abs(found).max())
