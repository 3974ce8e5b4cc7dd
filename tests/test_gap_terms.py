"""Effects as terms of a calibration: their forms, saved, and taken out of what was read."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.factors.chain.rotations import cross, exponential_matrices
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import Signals, channels_by_kind
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.effects.turning import Turning
from magyc_gtsam.gap.effects import TERMS

SOFT = np.array([[1.05, 0.04, 0.0], [0.04, 0.95, 0.02], [0.0, 0.02, 1.01]])
HARD = np.array([2e-6, -12e-6, 9e-6])
BIAS = np.array([4e-3, -5e-3, 2e-3])


def field_rate(field: np.ndarray, rate: np.ndarray) -> np.ndarray:
    result: np.ndarray = SOFT @ -cross(rate, np.linalg.solve(SOFT, field))
    return result


def signals(n: int = 50) -> Signals:
    random = np.random.default_rng(1)
    field, rate = random.standard_normal((3, n)) * 3e-5, random.standard_normal((3, n)) * 0.3
    return Signals(
        np.arange(n) * 0.1,
        field=field,
        field_rate=field_rate(field, rate),
        hard_iron=HARD,
        rate=rate,
        to_sensor=np.repeat(np.eye(3)[:, :, None], n, axis=2),
        soft_iron=SOFT,
        acceleration=random.standard_normal((3, n)) + np.array([[0.0], [0.0], [-9.8]]),
        channels={kind: random.standard_normal((2, n)) for kind in ("current", "temperature", "position")},
    )


SETTINGS = {
    "hard-iron-step": {"time": 2.0},
    "hard-iron-drift": {"order": 2.0, "start": 0.0, "end": 5.0},
    "gain-drift": {"order": 2.0, "start": 0.0, "end": 5.0},
    "soft-iron-step": {"time": 2.0},
    "gyro-bias-step": {"time": 2.0},
    "gyro-bias-drift": {"order": 2.0, "start": 0.0, "end": 5.0},
    "eddy-plane": {"x": 0.6, "y": 0.0, "z": 0.8},
    "local-anomaly": {"time": 2.0, "width": 1.0},
    "saturation": {"level": 3e-5},
    "hysteresis": {"coercive": 1e-5},
    "tone": {"frequency": 1.3},
    "clock-drift": {"start": 0.0, "end": 5.0},
}


@pytest.mark.parametrize("name", FORMS)
def test_a_form_is_its_columns_times_its_value(name: str) -> None:
    at, setting = signals(), SETTINGS.get(name, {})
    columns = FORMS[name].columns(at, setting)
    assert columns.shape[1:] == (3, 50)
    exact = not FORMS[name].rotates and FORMS[name].exact is None
    value = np.linspace(1, 2, len(columns)) * (1.0 if exact else 2e-4)
    added = FORMS[name].evaluate(at, value, setting)
    linear = np.tensordot(value, columns, axes=1)
    # A rotation of axes and delays of axes are exact: their columns are the first order of them.
    np.testing.assert_allclose(added, linear, atol=np.abs(linear).max() * (1e-12 if exact else 1e-2))


def test_what_warms_up_drifts_ever_less() -> None:
    """By one unit from the start to the end; with a long time constant along a straight line."""
    at, whole = signals(), {"order": 0.0, "start": 0.0, "end": 5.0}
    warm = FORMS["hard-iron-drift"].columns(at, whole | {"constant": 1.25})[0, 0]
    expected = (1 - np.exp(-at.time / 1.25)) / (1 - np.exp(-4.0)) - 0.5
    np.testing.assert_allclose(warm, expected, atol=1e-12)
    line, slow = (FORMS["hard-iron-drift"].columns(at, whole | more)[0, 0] for more in ({}, {"constant": 5e5}))
    np.testing.assert_allclose(slow, line, atol=1e-5)
    for name in ("hard-iron-drift", "gain-drift", "gyro-bias-drift"):
        said = TERMS[name].say(np.ones(3), np.ones(3), whole | {"constant": 84.2})
        assert said.endswith("over the recording, like a part that warms up, with a time constant of 84 s")


def test_channels_are_known_by_their_names() -> None:
    found = channels_by_kind({"battery_current": np.ones(4), "Temp": np.zeros(4), "position": np.ones((4, 3))})
    assert {kind: rows.shape for kind, rows in found.items()} == {
        "current": (1, 4),
        "temperature": (1, 4),
        "position": (3, 4),
    }


def calibration(*terms: Term) -> mg.Calibration:
    return mg.Calibration(SOFT, HARD, BIAS, terms=terms, field_strength=5e-5)


def test_terms_survive_saving(tmp_path: Path) -> None:
    term = Term("hard-iron-step", [1e-6, 2e-6, 3e-6], np.diag([1e-16] * 3), {"time": 41.5})
    calibration(term).save(tmp_path / "cal.yaml")
    (loaded,) = mg.Calibration.load(tmp_path / "cal.yaml").terms
    assert loaded.name == term.name
    assert loaded.setting == {"time": 41.5}
    np.testing.assert_array_equal(loaded.value, term.value)
    np.testing.assert_array_equal(loaded.covariance, term.covariance)


def test_apply_takes_a_current_out() -> None:
    random = np.random.default_rng(3)
    u = random.standard_normal((40, 3)) * 3e-5
    current = random.uniform(0, 5, 40)
    value = np.array([1e-7, -2e-7, 3e-7])
    m = u @ SOFT.T + HARD + current[:, None] * value
    cal = calibration(Term("motor-current", value, np.eye(3) * 1e-18))
    np.testing.assert_allclose(cal.apply(m, channels={"current": current}), u, atol=1e-18)
    with pytest.raises(mg.MagycError, match="current"):
        cal.apply(m)


def test_apply_takes_a_cubic_response_out_without_any_channel() -> None:
    u = np.random.default_rng(4).standard_normal((40, 3)) * 3e-5
    clean = u @ SOFT.T + HARD
    value = np.array([5e-7, -5e-7, 3e-7])
    m = clean + value * (clean / 50e-6) ** 3
    cal = calibration(Term("cubic", value, np.eye(3) * 1e-18))
    np.testing.assert_allclose(cal.apply(m), u, atol=2e-10)
    np.testing.assert_allclose(cal.apply(m[0]), u[0], atol=2e-10)


def test_apply_brings_the_field_to_the_axes_of_the_gyroscope() -> None:
    angle = np.array([0.02, -0.03, 0.05])
    turn = gtsam.Rot3.Expmap(angle).matrix()
    u = np.random.default_rng(5).standard_normal((20, 3)) * 3e-5
    # w − b = Exp(v) ω with ω in the magnetometer's axes; so the field in the gyroscope's is Exp(v) u.
    cal = calibration(Term("misalignment", angle, np.eye(3) * 1e-8))
    np.testing.assert_allclose(cal.apply(u @ SOFT.T + HARD), u @ turn.T, atol=1e-18)


def test_apply_gyroscope_takes_a_scale_out() -> None:
    rate = np.random.default_rng(6).standard_normal((30, 3)) * 0.5
    scale = np.array([0.02, -0.01, 0.015, 0.003, -0.002, 0.001])
    x, y, z = rate.T
    error = np.stack(
        [
            scale[0] * x + scale[3] * y + scale[4] * z,
            scale[1] * y + scale[3] * x + scale[5] * z,
            scale[2] * z + scale[4] * x + scale[5] * y,
        ],
        axis=1,
    )
    cal = calibration(Term("gyro-scale", scale, np.eye(6) * 1e-8))
    np.testing.assert_allclose(cal.apply_gyroscope(rate + error + BIAS), rate, atol=1e-9)


def late_axes(rate: float, delay: np.ndarray, time: np.ndarray) -> tuple[Signals, np.ndarray]:
    """Return what a sensor reads that turns about an axis, and what is added where each of its axes is late."""
    axis = np.array([2.0, -1.0, 2.0]) / 3

    def field(when: np.ndarray) -> np.ndarray:
        about = exponential_matrices(-np.outer(axis, rate * when))
        return SOFT @ np.einsum("ijn,j->in", about, [2e-5, 0.0, 4e-5])

    rates = np.outer(axis, np.full(len(time), rate))
    now = field(time)
    at = Signals(time, field=now, field_rate=field_rate(now, rates), rate=rates, soft_iron=SOFT)
    return at, np.array([field(time - late)[i] for i, late in enumerate(delay)]) - now


def test_delays_of_axes_read_each_at_its_own_time() -> None:
    """Of delays of up to 200 ms in turns of 3 rad/s nothing remains, nor of the derivatives."""
    delay = np.array([0.05, 0.2, 0.08])
    at, late = late_axes(3.0, delay, np.linspace(0, 20, 401))
    form = FORMS["axis-delays"]
    np.testing.assert_allclose(form.evaluate(at, delay, {}), late, atol=1e-12)
    step = 1e-6
    moved = [
        (form.evaluate(at, delay + way, {}) - form.evaluate(at, delay - way, {})) / (2 * step)
        for way in step * np.eye(3)
    ]
    np.testing.assert_allclose(form.derivatives(at, delay, {}), moved, atol=1e-9)
    np.testing.assert_allclose(form.derivatives(at, np.zeros(3), {}), form.columns(at, {}), atol=1e-12)


def test_a_delay_that_grows_reads_each_sample_at_its_own_time() -> None:
    """Of a delay that grows from −150 to 150 ms in turns of 3 rad/s nothing remains, nor of its derivative."""
    time = np.linspace(0, 20, 401)
    at, _ = late_axes(3.0, np.zeros(3), time)
    growth, setting, form = np.array([0.3]), {"start": 0.0, "end": 20.0}, FORMS["clock-drift"]
    late = growth * (time / 20 - 0.5)
    alone = [late_axes(3.0, np.full(3, each), time)[1][:, index] for index, each in enumerate(late)]
    np.testing.assert_allclose(form.evaluate(at, growth, setting), np.transpose(alone), atol=1e-12)
    step = 1e-6
    more, less = (form.evaluate(at, growth + way, setting) for way in (step, -step))
    np.testing.assert_allclose(form.derivatives(at, growth, setting)[0], (more - less) / (2 * step), atol=1e-9)
    np.testing.assert_allclose(form.derivatives(at, np.zeros(1), setting), form.columns(at, setting), atol=1e-12)


def test_a_delay_that_grows_beside_a_constant_one_is_that_of_the_attitude_then() -> None:
    """In a swing of 1 rad to and fro; of turns until the stamps 0.5 µT and more remained."""
    axis, late, growth = np.array([2.0, -1.0, 2.0]) / 3, 0.1, 0.2
    time = np.linspace(0, 30, 6001)

    def field(when: np.ndarray) -> np.ndarray:
        about = exponential_matrices(-np.outer(axis, np.sin(2 * when)))
        return np.einsum("ijn,j->in", about, [2e-5, 0.0, 4e-5])

    rate = np.outer(axis, 2 * np.cos(2 * time))
    read = SOFT @ field(time - late - growth * ((time - late) / 30 - 0.5)) + HARD[:, None]
    cal = calibration(
        Term("clock-drift", [growth], np.eye(1) * 1e-8, {"start": 0.0, "end": 30.0}),
        Term("timing", [late], np.eye(1) * 1e-8),
    )
    off = cal.apply(read.T, time=time, angular_rate=rate.T + BIAS).T - field(time - late)
    assert np.abs(off[:, 100:-100]).max() < 0.1e-6


def test_late_axes_are_corrected_without_adding_noise() -> None:
    """From sample to sample at 200 Hz; a correction to second order diverged."""
    delay, time = np.array([0.05, 0.2, 0.08]), np.linspace(0, 20, 4001)
    at, late = late_axes(3.0, delay, time)
    noise = np.random.default_rng(1).standard_normal(late.shape) * 0.3e-6
    cal = calibration(Term("axis-delays", delay, np.eye(3) * 1e-8))
    read = (at.field + late + noise).T + HARD
    left = cal.apply(read, time=time, angular_rate=at.rate.T + BIAS) - np.linalg.solve(SOFT, at.field).T
    assert left.std() < 0.5e-6


def test_delays_are_those_of_three_axes() -> None:
    with pytest.raises(mg.MagycError, match="an effect of 2 values meets data for 3"):
        FORMS["axis-delays"].evaluate(signals(), np.array([0.1, 0.2]), {})


def test_turns_are_those_of_the_samples_of_a_window() -> None:
    """A turn that changes within a second is not that of the windows' mean rates."""
    time = np.linspace(0, 20, 2001)
    rate = np.stack([np.sin(3 * time), np.cos(4 * time), 0.5 * np.ones(len(time))])
    passed = np.stack([-np.cos(3 * time) / 3, np.sin(4 * time) / 4, 0.5 * time])
    then = time - 0.3
    before = np.stack([-np.cos(3 * then) / 3, np.sin(4 * then) / 4, 0.5 * then])

    def mean(values: np.ndarray) -> np.ndarray:
        return values[:, 1:].reshape(3, 20, 100).mean(axis=2)

    turn, earlier = Turning(time, rate, time, mean).within(0.3)
    np.testing.assert_allclose(turn[:, 1:], mean(passed - before)[:, 1:], atol=1e-4)
    assert earlier.shape == (3, 20)
