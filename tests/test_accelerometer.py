"""Accelerometer self-calibration: simulated truth with motion, refusals, files, and real instruments."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from commands import run
from scipy.spatial.transform import Rotation, Slerp

from magyc_gtsam import (
    AccelerometerCalibration,
    MagycError,
    Recording,
    calibrate_accelerometer,
    cli,
    read,
    simulate,
)
from magyc_gtsam.estimators.autocal.accelerometer import STANDARD_GRAVITY, accelerometer_samples
from magyc_gtsam.io import write_mcap

SCALE = np.array([[1.02, 0.005, -0.003], [0.005, 0.985, 0.004], [-0.003, 0.004, 1.01]])
BIAS = np.array([0.15, -0.25, 0.08])


def turned_by_hand(seed=0, motion=0.15, noise=0.03, rate=50, stops=24):
    """Held for two seconds in each attitude and turned to the next within one; `motion` of all seconds shake."""
    rng = np.random.default_rng(seed)
    attitudes = Rotation.random(stops, random_state=rng)
    keys = np.sort(np.concatenate([3.0 * np.arange(stops), 3.0 * np.arange(stops) + 2]))
    time = np.arange(int((keys[-1]) * rate)) / rate
    path = Slerp(keys, attitudes[np.repeat(np.arange(stops), 2)])(time)
    force = path.inv().apply([0.0, 0.0, STANDARD_GRAVITY])
    second = time.astype(int)
    shaken = rng.permutation(second[-1] + 1)[: round(motion * (second[-1] + 1))]
    push = np.zeros((second[-1] + 1, 3))
    push[shaken] = rng.normal(0, 3, (len(shaken), 3))
    wave = np.sin(2 * np.pi * 1.3 * time)[:, None]
    acceleration = (force + push[second] * wave) @ SCALE.T + BIAS + noise * rng.normal(size=force.shape)
    field = path.inv().apply([20e-6, 0.0, 40e-6]) + 1e-7 * rng.normal(size=force.shape)
    return Recording(time, field, np.zeros_like(field) + 1e-3, acceleration=acceleration, name="by hand")


def deviation(calibration):
    return np.concatenate([(calibration.scale - SCALE)[np.triu_indices(3)], calibration.bias - BIAS])


def test_scale_and_bias_come_back_in_spite_of_motion():
    recording = turned_by_hand()
    calibration = calibrate_accelerometer(recording)
    assert calibration.converged, calibration.message
    np.testing.assert_allclose(calibration.scale, SCALE, atol=2e-3)
    np.testing.assert_allclose(calibration.bias, BIAS, atol=0.02)
    assert calibration.noise == pytest.approx(0.03, rel=0.3)
    mask = calibration.inliers(recording.acceleration)
    assert 0.03 < (~mask).mean() < 0.2
    still = np.linalg.norm(calibration.apply(recording.acceleration)[mask], axis=1)
    assert np.abs(still - STANDARD_GRAVITY).mean() < 0.05


def test_least_squares_would_not():
    """A kernel as wide as gravity is least squares: motion spoils it."""
    recording = turned_by_hand()
    spoilt = calibrate_accelerometer(recording, noise=5.0)
    robust = calibrate_accelerometer(recording)
    assert np.linalg.norm(deviation(spoilt)[6:]) > 5 * np.linalg.norm(deviation(robust)[6:])


def test_the_covariance_is_honest():
    """NEES of 24 runs: 9 degrees of freedom, since gravity sets the scale; some 180 blocks make it a little more."""
    consistency = []
    for seed in range(24):
        calibration = calibrate_accelerometer(turned_by_hand(seed, stops=60))
        error = deviation(calibration)
        consistency.append(error @ np.linalg.solve(calibration.covariance, error))
    assert 9 - 2.6 * np.sqrt(18 / 24) < np.mean(consistency) < 9 + 3.0 * np.sqrt(18 / 24)


@pytest.mark.parametrize("kernel", ["huber", "l1", "geman-mcclure"])
def test_other_kernels(kernel):
    calibration = calibrate_accelerometer(turned_by_hand(3), kernel=kernel)
    np.testing.assert_allclose(calibration.bias, BIAS, atol=0.03)


def test_gravity_sets_the_scale():
    recording = turned_by_hand(1)
    standard, elsewhere = (calibrate_accelerometer(recording, gravity=g) for g in (STANDARD_GRAVITY, 9.78))
    np.testing.assert_allclose(elsewhere.scale * 9.78, standard.scale * STANDARD_GRAVITY, rtol=1e-9)
    np.testing.assert_allclose(elsewhere.bias, standard.bias, rtol=1e-9)
    np.testing.assert_allclose(elsewhere.sigma["scale"] * 9.78, standard.sigma["scale"] * 9.80665, rtol=1e-9)


def test_a_vehicle_that_stays_level_is_not_trusted():
    simulation = simulate("moderate", duration=120)
    rng = np.random.default_rng(2)
    noisy = simulation.recording.acceleration + 0.05 * rng.normal(size=(1200, 3))
    calibration = calibrate_accelerometer(replace(simulation.recording, acceleration=noisy))
    assert not calibration.converged
    assert "too little motion" in calibration.message


def test_what_is_no_accelerometer_is_refused():
    recording = turned_by_hand()
    with pytest.raises(MagycError, match="has no acceleration"):
        calibrate_accelerometer(replace(recording, acceleration=None))
    with pytest.raises(MagycError, match="likely unit: g"):
        calibrate_accelerometer(replace(recording, acceleration=recording.acceleration / STANDARD_GRAVITY))
    with pytest.raises(MagycError, match="too little motion"):
        calibrate_accelerometer(
            replace(recording, acceleration=[0.0, 0.0, 9.8] + 1e-3 * np.sin(recording.time[:, None] * [1, 2, 3]))
        )
    with pytest.raises(MagycError, match="gravity of the accelerometer: must be between .* got 98"):
        calibrate_accelerometer(recording, gravity=98)
    with pytest.raises(MagycError, match="kernel 'tukey' unknown"):
        calibrate_accelerometer(recording, kernel="tukey")


def test_samples_are_the_gyroscopes_rows_without_repeats():
    recording = turned_by_hand()
    fresh = np.arange(len(recording.time)) % 2 == 0
    held = np.repeat(recording.acceleration[::4], 4, axis=0)[: len(recording.time)]
    time, value = accelerometer_samples(replace(recording, acceleration=held, angular_rate_fresh=fresh))
    assert len(time) == len(value) == -(-len(recording.time) // 4)


def test_a_calibration_is_saved_and_loaded_bit_for_bit(tmp_path):
    calibration = calibrate_accelerometer(turned_by_hand())
    calibration.save(tmp_path / "accelerometer.yaml")
    loaded = AccelerometerCalibration.load(tmp_path / "accelerometer.yaml")
    assert loaded.to_dict() == calibration.to_dict()
    np.testing.assert_array_equal(loaded.covariance, calibration.covariance)
    text = (tmp_path / "accelerometer.yaml").read_text(encoding="utf-8")
    (tmp_path / "cut.yaml").write_text(text[: text.index("converged:")], encoding="utf-8")
    with pytest.raises(MagycError, match="calibration without converged, .* is it cut off"):
        AccelerometerCalibration.load(tmp_path / "cut.yaml")
    (tmp_path / "other.yaml").write_text("format: magyc-gtsam calibration 1\n")
    with pytest.raises(MagycError, match="not the calibration of an accelerometer"):
        AccelerometerCalibration.load(tmp_path / "other.yaml")


def calibrated(*arguments, cwd):
    return run("calibrate", *arguments, "--sensor", "accelerometer", cwd=cwd)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "by_hand.mcap"
    write_mcap(path, turned_by_hand())
    return path


def test_the_command_writes_a_folder_for_an_accelerometer(log, tmp_path):
    result = calibrated(log, "-o", "out", "--option", "gravity=9.81", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("✔ Calibrated: bias known to")
    assert {f.name for f in (tmp_path / "out").iterdir()} == {
        "calibration.yaml",
        "configuration.yaml",
        "report.html",
    }
    calibration = AccelerometerCalibration.load(tmp_path / "out" / "calibration.yaml")
    assert calibration.gravity == 9.81
    np.testing.assert_allclose(calibration.bias, BIAS, atol=0.02)
    configuration = yaml.safe_load((tmp_path / "out" / "configuration.yaml").read_text())
    assert configuration["options"] == {"gravity": 9.81}
    page = (tmp_path / "out" / "report.html").read_text()
    for text in (page, result.stdout):
        assert "m/s²" in text
        for word in ("µT", "iron", "magnet"):
            assert word not in text.lower()


def test_the_command_says_what_is_wrong(log, tmp_path, capsys):
    def said(*arguments):
        code = cli.main(["calibrate", *map(str, arguments), "--sensor", "accelerometer"])
        return code, capsys.readouterr()

    for arguments, words in (
        (("--option", "window=2"), "no option 'window'"),
        (("--field-strength", "50"), "no option 'field_strength'"),
        (("--method", "ellipsoid"), "'ellipsoid' cannot calibrate an accelerometer"),
        (("--acceleration-unit", "g"), "is not gravity in m/s²"),
    ):
        code, output = said(log, "-o", tmp_path / "x", *arguments)
        assert code == 2
        assert words in output.err
        assert not (tmp_path / "x").exists()
    few = tmp_path / "few.mcap"
    write_mcap(few, turned_by_hand(stops=4))
    code, output = said(few, "-o", tmp_path / "few", "--json")
    assert code == 1
    assert "too little motion" in output.err
    assert not json.loads(output.out)["trusted"]
    code, output = said(few, "-o", tmp_path / "few")
    assert output.out.startswith("✘ Do not use this calibration: too little motion")
    assert "Bias" not in output.out
    assert (tmp_path / "few" / "report.html").exists()


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "bias"),
    [
        ("broad_01_slow_rotation.mcap", [0, 0, 0]),  # calibrated at the factory
        ("breakout_boards_hand_rotation.mcap", [0.12, 0.14, -0.23]),  # not
    ],
)
def test_real_instruments(shared_data, name, bias):
    calibration = calibrate_accelerometer(read(shared_data / name))
    assert calibration.converged, calibration.message
    np.testing.assert_allclose(np.diag(calibration.scale), 1, atol=0.02)
    np.testing.assert_allclose(calibration.bias, bias, atol=0.06)


@pytest.mark.real
@pytest.mark.parametrize(
    "name",
    ["broad_06_fast_rotation.mcap", "nexus5_calibration_d1.mcap", "xio_hand_motion.csv", "ardusub_still.BIN"],
)
def test_real_motion_that_does_not_do_is_not_trusted(shared_data, name):
    calibration = calibrate_accelerometer(read(shared_data / name))
    assert not calibration.converged
    assert "too little motion" in calibration.message
