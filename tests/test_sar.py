"""SAR-LS and SAR-KF against simulated truth, and against each other."""

from dataclasses import replace

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.estimators.hard_iron.sar_kf import filter_field
from magyc_gtsam.estimators.hard_iron.turning import TurningField, turning_field

METHODS = ("sar-ls", "sar-kf")
IDEAL = {"soft_iron": np.eye(3), "gyro_bias": np.zeros(3)}  # what both methods take for granted
LARGE = np.array([60e-6, -70e-6, 400e-6])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("motion", ["wide", "tiny", "dive"])
def test_hard_iron_of_an_ideal_sensor(method, motion):
    simulation = mg.simulate(motion, 300, seed=2, hard_iron=LARGE, **IDEAL)
    calibration = mg.calibrate(simulation.recording, method)
    assert calibration.converged, calibration.message
    error = np.linalg.norm(calibration.hard_iron - LARGE)
    assert error < (0.8e-6 if motion == "tiny" else 0.25e-6)
    np.testing.assert_array_equal(calibration.soft_iron, np.eye(3))
    assert calibration.gyro_bias is None
    assert calibration.covariance is None
    assert calibration.field_strength == pytest.approx(simulation.truth.field_strength, rel=0.02)


@pytest.mark.parametrize("method", METHODS)
def test_exact_without_noise(method):
    simulation = mg.simulate("wide", 40, 50, seed=1, magnetometer_noise=0, gyroscope_noise=0, **IDEAL)
    calibration = mg.calibrate(simulation.recording, method)
    np.testing.assert_allclose(calibration.hard_iron, simulation.truth.hard_iron, atol=1e-10)


def test_least_squares_is_what_the_derivative_form_gives_in_short_windows():
    """Σ ‖ṁ + ω × (m − h)‖² on a quiet, densely sampled recording, against windows of a sample."""
    recording = mg.simulate(
        "wide", 60, 100, seed=3, magnetometer_noise=1e-9, gyroscope_noise=1e-6, **IDEAL
    ).recording
    step = np.diff(recording.time)[:, None]
    change = np.diff(recording.magnetic_field, axis=0) / step
    field = 0.5 * (recording.magnetic_field[1:] + recording.magnetic_field[:-1])
    rate = 0.5 * (recording.angular_rate[1:] + recording.angular_rate[:-1])
    x, y, z = rate.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3)  # (3 n, 3): ω × h
    expected = np.linalg.lstsq(cross, (change + np.cross(rate, field)).ravel(), rcond=None)[0]
    found = mg.calibrate(recording, "sar-ls", window=0.01).hard_iron
    np.testing.assert_allclose(found, expected, atol=2e-9)


def test_filter_is_the_batch_solution_where_nothing_drifts():
    """Without process noise: least squares of m_k = R_kᵀ v + h over all samples."""
    time, field, rotation = turning_field(mg.simulate("low", 60, seed=4, **IDEAL).recording)
    unit = 47e-6
    result = filter_field(TurningField(time, field / unit, rotation), 1e-12)
    design = np.concatenate([np.swapaxes(rotation, 1, 2), np.broadcast_to(np.eye(3), rotation.shape)], axis=2)
    batch = np.linalg.lstsq(design.reshape(-1, 6), (field / unit).ravel(), rcond=None)[0]
    np.testing.assert_allclose(result.state, batch, atol=1e-5)
    information = design.reshape(-1, 6).T @ design.reshape(-1, 6)
    np.testing.assert_allclose(result.covariance, 1e-4 * np.linalg.inv(information), rtol=1e-3, atol=1e-9)


def test_the_filter_finds_how_far_to_trust_the_gyroscope():
    """A bias that the model does not have must not spoil a large hard iron: the phone's case."""
    bias = [0.012, 0.0, 0.075]
    simulation = mg.simulate("wide", 60, 50, seed=1, soft_iron=np.eye(3), gyro_bias=bias, hard_iron=LARGE)
    adapted = mg.calibrate(simulation.recording, "sar-kf")
    trusting = mg.calibrate(simulation.recording, "sar-kf", noise=(1e-6, 5e-3))
    errors = [np.linalg.norm(c.hard_iron - LARGE) for c in (adapted, trusting)]
    assert errors[0] < 0.5 * errors[1]
    ideal = mg.calibrate(mg.simulate("wide", 60, 50, seed=1, **IDEAL).recording, "sar-kf")
    assert ideal.diagnostics["magnetometer_noise"] == pytest.approx(1e-6, rel=0.1)
    assert ideal.diagnostics["gyroscope_noise"] < adapted.diagnostics["gyroscope_noise"]


@pytest.mark.parametrize("method", METHODS)
def test_soft_iron_is_not_passed_over(method):
    soft_iron = np.diag([1.3, 1.0, 0.8])
    recording = mg.simulate("wide", 150, seed=1, soft_iron=soft_iron, gyro_bias=np.zeros(3)).recording
    calibration = mg.calibrate(recording, method)
    assert not calibration.converged
    assert "there is soft iron" in calibration.message


@pytest.mark.parametrize("method", METHODS)
def test_a_vehicle_that_only_turns_level_leaves_the_vertical_open(method):
    recording = mg.simulate("survey", 200, seed=1, **IDEAL).recording
    level = np.zeros((len(recording.time), 3))
    level[:, 2] = 0.1 * np.sin(0.05 * recording.time)
    angle = np.cumsum(level[:, 2]) * 0.1
    field = np.stack([20e-6 * np.cos(angle), -20e-6 * np.sin(angle), np.full(len(angle), 40e-6)], axis=1)
    random = np.random.default_rng(0)
    level_recording = mg.Recording(
        recording.time,
        field + 1e-6 * random.standard_normal(field.shape),
        level + 1e-4 * random.standard_normal(level.shape),
    )
    calibration = mg.calibrate(level_recording, method)
    assert not calibration.converged
    assert "hard iron along z" in calibration.message


@pytest.mark.parametrize("method", METHODS)
def test_scale_of_the_field(method):
    simulation = mg.simulate("dive", 60, seed=1, **IDEAL)
    free, scaled = (mg.calibrate(simulation.recording, method, field_strength=f) for f in (None, 50e-6))
    np.testing.assert_allclose(scaled.hard_iron, free.hard_iron)
    np.testing.assert_allclose(scaled.soft_iron, free.field_strength / 50e-6 * np.eye(3))
    assert scaled.field_strength == 50e-6


def test_interval_means_are_integrated_as_such():
    simulation = mg.simulate("dive", 120, 50, seed=1, magnetometer_noise=0, gyroscope_noise=0, **IDEAL)
    recording = simulation.recording
    rate = recording.angular_rate
    mean = np.vstack([rate[:1], 0.5 * (rate[1:] + rate[:-1])])
    told = replace(recording, angular_rate=mean, angular_rate_is="interval-mean")
    untold = replace(recording, angular_rate=mean)
    errors = [
        np.linalg.norm(mg.calibrate(r, "sar-ls").hard_iron - simulation.truth.hard_iron) for r in (told, untold)
    ]
    assert errors[0] < 0.2 * errors[1]


@pytest.mark.parametrize(
    ("method", "options", "match"),
    [
        ("sar-ls", {"window": 0.0}, "window"),
        ("sar-ls", {"window": 100.0}, "windows of 100 s"),
        ("sar-kf", {"noise": (0.0, 1e-3)}, "noise: must be a pair"),
        ("sar-kf", {"drift": -1.0}, "drift"),
    ],
)
def test_wrong_options_are_refused(method, options, match):
    with pytest.raises(mg.MagycError, match=match):
        mg.calibrate(mg.simulate("wide", 60, seed=1).recording, method, **options)


@pytest.mark.parametrize("method", METHODS)
def test_no_gyroscope_no_result(method):
    recording = replace(mg.simulate("wide", 60).recording, angular_rate=None)
    with pytest.raises(mg.MagycError, match="no angular rate"):
        mg.calibrate(recording, method)


@pytest.mark.real
@pytest.mark.parametrize("method", METHODS)
def test_a_phone_against_its_makers_hard_iron(method, shared_data):
    """Its gyroscope bias of 4 °/s is not in these methods' model: within 2 µT, where the smoother has 0.7."""
    calibration = mg.calibrate(mg.read(shared_data / "nexus5_calibration_d1.mcap"), method)
    np.testing.assert_allclose(calibration.hard_iron * 1e6, [58.0, -73.8, 412.4], atol=2.0)
