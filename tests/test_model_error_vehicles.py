"""Model errors of motions unlike those of the papers: fast to and fro, stamps in bursts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from magyc_gtsam import Recording, calibrate
from magyc_gtsam.estimators.model_error.by_attitude import vertical
from magyc_gtsam.estimators.model_error.components import fit_components
from magyc_gtsam.estimators.model_error.motion import WindowMotion
from magyc_gtsam.estimators.model_error.physical import followed
from magyc_gtsam.estimators.model_error.samples import in_bursts
from magyc_gtsam.estimators.smoother.search import fit_field_chain

HARD_IRON = np.array([12e-6, -7e-6, 5e-6])
WORLD = np.array([22e-6, 0.0, 40e-6])
DURATION = 300.0


def moved(time, yaw, pitch, roll):
    """Field (n, 3) T and rate (n, 3) rad/s of angles (n,) rad."""
    spline, half = CubicSpline(time, np.stack([yaw, pitch, roll], axis=1)), 5e-4
    before, after = (Rotation.from_euler("ZYX", spline(time + x)) for x in (-half, half))
    rate = (before.inv() * after).as_rotvec() / (2 * half)
    return Rotation.from_euler("ZYX", spline(time)).inv().apply(WORLD) + HARD_IRON, rate


def swaying(time, random, period, size):
    """Angles (n,) of several waves about a period in s."""
    frequency, phase = 2 * np.pi / period * random.uniform(0.6, 1.6, (9, 1)), random.uniform(0, 6, (9, 1))
    return size * np.sqrt(2 / 9) * np.sin(frequency * time + phase).sum(axis=0)


def recording(random, time, field, rate, stamps=None):
    """With noise of 0.3 µT and 3 mrad/s; the magnetometer has every fifth sample."""
    field, rate = (x + size * random.normal(size=x.shape) for x, size in ((field, 3e-7), (rate, 3e-3)))
    return Recording.from_streams((time[::5] if stamps is None else stamps, field[::5]), (time, rate))


def sigmas(calibration):
    """The largest error of the hard iron in stated sigmas."""
    return float((np.abs(calibration.hard_iron - HARD_IRON) / calibration.sigma["hard_iron"]).max())


def stairs(time, random, step, size):
    """Angles (n,) that are constant but for the last second of each step."""
    knots = np.arange(0, DURATION + 2 * step, step)
    values = np.repeat(size * random.normal(size=len(knots)), 2)
    return np.interp(time, np.stack([knots, knots + step - 1], axis=1).ravel(), values)


def test_a_scale_of_axes_that_swing_faster_than_the_windows_is_not_thought_excluded() -> None:
    """Columns that do not follow the motion left 4.6 to 6.8 sigmas; 2.5 % is at the edge of what data sheets state."""
    time = np.arange(0, DURATION, 0.02)
    found = []
    for seed in range(3):
        random = np.random.default_rng(seed)
        yaw = stairs(time, random, 10, 1.4)
        lean = (stairs(time, random, 5, 0.1) + swaying(time, random, 1.0, 0.05) for _ in "pr")
        field, rate = moved(time, yaw, *lean)
        found.append(sigmas(calibrate(recording(random, time, field, rate * [1.02, 1.03, 0.991]))))
    assert np.sqrt(np.mean(np.square(found))) < 4


def test_a_scale_of_which_one_axis_is_seen_may_be_larger_about_the_others() -> None:
    """Of three coefficients of one size, at any octave, the data show one: the others stay within E[β βᵀ]."""
    random = np.random.default_rng(0)
    score = []
    for _ in range(200):
        beta = 2.0 ** -random.uniform(0, 4) * random.normal(size=3)
        rows = np.array([[1.0], [0], [0]]) * random.normal(size=(3, 400))
        residual = beta @ rows + 0.01 * random.normal(size=400)
        fitted = fit_components(
            rows @ rows.T, rows @ residual, float(residual @ residual), [slice(0, 3)], [1], 400.0
        )
        if fitted.second[1, 1] > 0:
            score.append(beta[1] ** 2 / fitted.second[1, 1])
    assert np.mean(np.array(score) < 9) > 0.95
    assert np.median(score) > 0.05


@pytest.mark.parametrize(("period", "together", "told"), [(3.0, 20, True), (3.0, 1, False), (60.0, 20, False)])
def test_stamps_in_bursts_are_too_few_for_a_fast_motion(period: float, together: int, told: bool) -> None:
    """Twenty samples of 10 Hz are stamped together every two seconds."""
    time, random = np.arange(0, DURATION, 0.02), np.random.default_rng(1)
    field, rate = moved(time, *(swaying(time, random, period, 0.3) for _ in "ypr"))
    i = np.arange(len(time[::5]))
    burst = np.minimum((i // together + 1) * together, len(i)) - 1
    log = recording(random, time, field, rate, time[::5][burst] + 1e-4 * (i - burst))
    assert bool(in_bursts(log)) == told


def test_an_estimated_scale_follows_a_sway_that_the_windows_do_not_resolve() -> None:
    """Means over windows left 4 sigmas rms."""
    time, found = np.arange(0, DURATION, 0.02), []
    for seed in range(100, 104):
        random = np.random.default_rng(seed)
        yaw = stairs(time, random, 10, 1.4)
        lean = (stairs(time, random, 5, 0.1) + swaying(time, random, 2.0, 0.08) for _ in "pr")
        field, rate = moved(time, yaw, *lean)
        read = recording(random, time, field, rate * (1 + random.normal(0, 0.01, 3)))
        found.append(sigmas(calibrate(read, gyroscope_scale=0.01)))
    assert np.sqrt(np.mean(np.square(found))) < 2.0  # the largest of three axes: 1.3 is expected


def leaning(seed, steps, sway):
    """Times, angles of a vehicle that turns and leans, and a generator."""
    time, random = np.arange(0, DURATION, 0.02), np.random.default_rng(seed)
    yaw = stairs(time, random, 10, 1.4)
    return time, random, [yaw, *(stairs(time, random, 6, steps) + swaying(time, random, 3.0, sway) for _ in "pr")]


def test_the_vertical_is_known_where_a_vehicle_rolls_faster_than_it_turns() -> None:
    """The axis of most rotation is horizontal: a boom's 7 µT were trusted at 8 sigmas."""
    time, random = np.arange(0, DURATION, 0.02), np.random.default_rng(0)
    angles = [0.15 * time, *(swaying(time, random, 4.0, 0.1) for _ in "pr")]
    fit = fit_field_chain(recording(random, time, *moved(time, *angles)))
    motion = WindowMotion.of(fit)
    lean = np.stack([np.interp(motion.time, time, angle) for angle in angles], axis=1)
    down = Rotation.from_euler("ZYX", lean).inv().apply([0.0, 0.0, 1.0])
    assert np.abs(np.einsum("in,ni->n", vertical(motion), down)).min() > 0.99


def test_a_mount_that_flexes_is_covered() -> None:
    """By 2° per g an axis. Families that follow the tilt alone left a NEES of 13 and 17 of 3, trusted."""
    for seed in (4, 5):
        time, random, angles = leaning(seed, 0.12, 0.05)
        field, rate = moved(time, *angles)
        down = Rotation.from_euler("ZYX", np.stack(angles, axis=1)).inv().apply([0.0, 0.0, 1.0])
        turn = down @ random.normal(0, np.radians(2.0), (3, 3)).T
        flexed = Rotation.from_rotvec(turn - turn.mean(axis=0)).apply(field)
        calibration = calibrate(recording(random, time, flexed, rate))
        error = calibration.hard_iron - HARD_IRON
        assert error @ np.linalg.solve(calibration.covariance[6:9, 6:9], error) < 5
        assert any(
            "gives way" in each["sentence"] for each in calibration.diagnostics["model_error"]["components"]
        )


def test_a_loop_that_takes_most_of_the_sweep_is_covered() -> None:
    """The lag alone says too little of what is lost: 19 and 17 µT off at 3.3 and 3.0 sigmas."""
    for seed in (0, 2):
        time, random, angles = leaning(seed, 0.1, 0.03)
        field, rate = moved(time, *angles)
        loop = [share * (followed(field.T.copy(), width).T - field) for share, width in ((0.5, 2e-6), (0.2, 5e-6))]
        assert sigmas(calibrate(recording(random, time, field + sum(loop), rate))) < 2.3


def test_the_heading_of_a_car_is_as_uncertain_as_its_gyroscopes_axes() -> None:
    """A cross-axis sensitivity of 0.45 % turns the heading by 0.7°: without that error 28 cars had 2.7 to 6 sigmas."""
    time, found = np.arange(0, DURATION, 0.02), []
    turn = np.linspace(0, 2 * np.pi, 40)
    for seed in range(8):
        random = np.random.default_rng(seed)
        yaw, *lean = (swaying(time, random, *each) for each in ((60.0, 1.8), (4.0, 0.03), (4.0, 0.03)))
        field, rate = moved(time, yaw, *lean)
        skewed = rate + 0.0045 * rate @ np.array([[0, 0.67, -1], [0.67, 0, 1], [-1, 1, 0]])
        calibration = calibrate(recording(random, time, field, skewed))
        level = Rotation.from_euler("Z", turn[:, None]).inv().apply(WORLD)
        x, y, _ = calibration.apply(level + HARD_IRON).T
        error = np.degrees(np.angle(np.exp(1j * (np.arctan2(-y, x) - turn))))
        found.append(np.abs(error).max() / calibration.observability.heading_sigma)
    assert np.sqrt(np.mean(np.square(found))) < 2.4  # 1.75 on 28 cars
