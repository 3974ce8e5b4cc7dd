"""What the motion determined, in the user's words."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magyc_gtsam import Recording, calibrate, simulate
from magyc_gtsam.foreign_text import two_digits
from magyc_gtsam.observability import (
    GYRO_BIAS_LIMIT,
    HARD_IRON_LIMIT,
    SOFT_IRON_LIMIT,
    Observability,
    Weakness,
    assess,
)

FIELD = 50e-6
GOOD = np.diag(np.r_[np.full(6, 1e-3), np.full(3, 1e-7), np.full(3, 1e-4)] ** 2)  # well below half of every limit
HARD, BIAS = [6, 7, 8], [9, 10, 11]


def recording(up=(0, 0, -9.81)):
    """A level turn in a field of 50 µT and 60° dip; `up` is what the accelerometer reads, None for none."""
    heading = Rotation.from_rotvec(np.outer(np.linspace(0, 2 * np.pi, 100), [0, 0, 1]))
    m = heading.inv().apply([25e-6, 0, 43.3e-6])
    acceleration = None if up is None else np.tile(up, (100, 1)).astype(float)
    return Recording(np.arange(100.0), m, acceleration=acceleration)


def with_weak(block, axis, sigma):
    covariance = GOOD.copy()
    axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    covariance[np.ix_(block, block)] += sigma**2 * np.outer(axis, axis)
    return covariance


def found(covariance, **more):
    return assess(covariance, np.eye(3), FIELD, recording(**more))


def test_nothing_weak():
    result = found(GOOD)
    assert result.observable
    assert result.weak == ()


@pytest.mark.parametrize(
    ("block", "axis", "limit", "unit", "what"),
    [
        (HARD, [0, 0, 1], HARD_IRON_LIMIT * FIELD, 1e6, "hard iron along z"),
        (HARD, [-1, 0, 0], HARD_IRON_LIMIT * FIELD, 1e6, "hard iron along x"),
        (HARD, [1, 0, 1], HARD_IRON_LIMIT * FIELD, 1e6, "hard iron along 0.7 x + 0.7 z"),
        (HARD, [1, -1, 0], HARD_IRON_LIMIT * FIELD, 1e6, "hard iron along"),
        (BIAS, [0, 1, 0], GYRO_BIAS_LIMIT, 1e3, "gyroscope bias about y"),
        ([0, 1, 3], [1, 0, 0], SOFT_IRON_LIMIT, 100, "soft iron along x"),
        ([2, 4, 5], [0, 0, 1], SOFT_IRON_LIMIT, 100, "soft iron along z"),
    ],
)
def test_limits(block, axis, limit, unit, what):
    """From half its limit a direction is named, from its limit the result is not to be trusted."""
    for share, observable, count in ((0.3, True, 0), (0.7, True, 1), (1.5, False, 1)):
        covariance = with_weak(block, axis, share * limit)
        result = found(covariance)
        assert result.observable is observable
        assert len(result.weak) == count
        if count:
            (weak,) = result.weak
            assert weak.what.startswith(what)
            assert weak.limit == pytest.approx(limit * unit)
            assert weak.sigma == pytest.approx(share * limit * unit, rel=0.02)
            assert weak.what in weak.sentence
            assert weak.remedy in weak.sentence
            assert weak.unit in weak.sentence


def test_signs_of_a_slanted_axis_are_kept():
    words = found(with_weak(HARD, [2, -1, 0], 5e-6)).weak[0].what
    assert words == "hard iron along 0.9 x − 0.4 y"


def test_worst_first():
    covariance = with_weak(HARD, [0, 0, 1], 3e-6)
    covariance[9, 9] = (10 * GYRO_BIAS_LIMIT) ** 2
    assert [w.what[:4] for w in found(covariance).weak] == ["gyro", "hard"]


@pytest.mark.parametrize(
    ("axis", "up", "words"),
    [
        ([0, 0, 1], (0, 0, -9.81), ["pitch or roll"]),
        ([0, 0, 1], (0, 0, 9.81), ["pitch or roll"]),
        ([1, 0, 0], (0, 0, -9.81), ["turn through all headings"]),
        ([1, 0, 0], (-9.81, 0, 0), ["pitch or roll"]),
        ([1, 0, 1], (0, 0, -9.81), ["all headings", "pitch or roll"]),
        ([0, 0, 1], None, ["turn about x and y"]),
        ([0, 1, 0], None, ["turn about x and z"]),
    ],
)
def test_the_remedy_is_the_motion_that_is_missing(axis, up, words):
    """The vertical is where the accelerometer says; without one the remedy names the sensor's axes."""
    (weak,) = found(with_weak(HARD, axis, 5e-6), up=up).weak
    for word in words:
        assert word in weak.remedy
    if words == ["turn through all headings"]:
        assert "pitch" not in weak.remedy


def test_an_unknown_field_strength_is_no_larger_limit():
    """A weak log may fit any field strength: the limit stays one of the Earth's field."""
    covariance = with_weak(HARD, [0, 0, 1], 1e-4)
    (weak,) = assess(covariance, np.eye(3), 5e-3, recording()).weak
    assert weak.limit == pytest.approx(HARD_IRON_LIMIT * 70)


def test_heading_sigma_is_the_spread_of_the_heading():
    """Of calibrations drawn from the covariance, over a level turn."""
    covariance = with_weak(HARD, [1, 0.5, 0.2], 1e-6)
    log = recording()
    result = assess(covariance, np.eye(3), FIELD, log)
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(np.zeros(12), covariance, 4000)
    rows, columns = np.triu_indices(3)
    headings = []
    for draw in draws:
        soft_iron = np.eye(3)
        soft_iron[rows, columns] += draw[:6]
        soft_iron[columns, rows] = soft_iron[rows, columns]
        u = np.linalg.solve(soft_iron, (log.magnetic_field - draw[6:9]).T)
        headings.append(np.arctan2(u[1], u[0]))
    true = np.arctan2(log.magnetic_field[:, 1], log.magnetic_field[:, 0])
    errors = (np.array(headings) - true + np.pi) % (2 * np.pi) - np.pi
    assert result.heading_sigma == pytest.approx(np.rad2deg(errors.std(axis=0)).max(), rel=0.05)
    # Without a vertical the turn is about z, in a dip of 60°: that of this recording.
    assert assess(covariance, np.eye(3), FIELD, recording(up=None)).heading_sigma == pytest.approx(
        result.heading_sigma, rel=0.01
    )


def test_round_trip():
    weak = Weakness("hard iron along z", 7.25, 2.5, "µT", "pitch or roll")
    for value in (Observability(False, (weak, weak), 3.5), Observability(True)):
        assert Observability.from_dict(value.to_dict()) == value


def test_a_motion_too_short_says_what_it_left_weak():
    """The worst direction, its standard deviation and the remedy are the message."""
    simulation = simulate("tiny", duration=15, rate=10, seed=0)
    calibration = calibrate(simulation.recording)
    assert not calibration.converged
    assert not calibration.observability.observable
    worst = calibration.observability.weak[0]
    assert worst.sigma > worst.limit
    assert worst.sentence in calibration.message
    error = np.abs(calibration.hard_iron - simulation.truth.hard_iron)
    assert (error < 5 * calibration.sigma["hard_iron"]).all()


def test_a_deviation_beyond_all_measure_is_said_in_words():
    weakness = Weakness("hard iron along y", 7.7e4, 3.5123, "µT", "turn")
    assert weakness.sentence == "hard iron along y is not determined (limit ±3.5 µT): turn"
    assert (
        Weakness("soft iron along x", 7.25, 5.0, "%", "turn").sentence
        == "soft iron along x ±7.2 % (limit 5): turn"
    )


def test_a_large_number_has_no_exponent() -> None:
    assert [two_digits(value) for value in (0.0123, 9.96, 99.4, 99.6, 163.0, -1234.0, 2e7)] == [
        "0.012", "10", "99", "100", "163", "-1234", "2e+07",
    ]  # fmt: skip
    assert "±163 µT (limit 2.5)" in Weakness("hard iron along z", 163.0, 2.5, "µT", "turn").sentence
