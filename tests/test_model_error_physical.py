"""What sensors are known to do: seen by few columns, weighed by odds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from magyc_gtsam import calibrate, simulate
from magyc_gtsam.estimators.model_error.components import principal
from magyc_gtsam.estimators.model_error.not_excluded import averaged_of_each
from magyc_gtsam.estimators.model_error.physical import PHYSICAL, followed
from magyc_gtsam.estimators.model_error.samples import flickers
from magyc_gtsam.simulation import GYRO_BIAS
from magyc_gtsam.study.efficiency import error, nees
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.scoring import score
from magyc_gtsam.study.faults.signals import record


def by_quadrature(normal: np.ndarray, score: np.ndarray, square: float, freedom: float, variance: float) -> float:
    """ln of the mean of the profiled likelihood over β ~ N(0, φ v), by its determinant and square."""
    inverse = np.linalg.inv(normal + np.eye(len(score)) / variance)
    left = square - score @ inverse @ score
    determinant = np.linalg.slogdet(np.eye(len(score)) + variance * normal)[1]
    return float(-0.5 * (freedom * np.log(left / square) + determinant))


def test_the_average_is_that_of_its_octaves() -> None:
    random = np.random.default_rng(4)
    rows, residual = random.normal(size=(3, 200)), random.normal(size=200)
    residual += 0.3 * rows[0]
    products = rows @ rows.T, rows @ residual, float(residual @ residual)
    most = 0.5
    variances = [(most * 0.5**k) ** 2 * 200.0 / products[2] for k in range(4)]
    nats = np.array([by_quadrature(*products, 200.0, v) for v in variances])
    (found,) = averaged_of_each([principal(*products[:2])], products[2], 200.0, [most], [4])
    assert found.evidence == pytest.approx(np.log(np.mean(np.exp(nats))))
    share = np.exp(nats) / np.exp(nats).sum()
    second = np.zeros((3, 3))
    for each, variance in zip(share, variances, strict=True):
        inverse = np.linalg.inv(products[0] + np.eye(3) / variance)
        mean = inverse @ products[1]
        second += each * ((products[2] - products[1] @ mean) / 200.0 * inverse + np.outer(mean, mean))
    np.testing.assert_allclose(found.second, second, rtol=1e-9)


@pytest.mark.parametrize("motion", ["moderate", "tiny"])
def test_over_instruments_that_bend_as_they_are_believed_to_the_covariance_is_honest(motion: str) -> None:
    """Neither of straight ones nor of bent ones alone, but of both by their odds."""
    (bend,) = (family for family in PHYSICAL if family.name == "bend")
    share = bend.prior / (1 + bend.prior)
    scores, by_noise = [], []
    for seed in range(2000, 2014):
        simulation, random = simulate(motion, seed=seed), np.random.default_rng(seed)
        field, strength = simulation.recording.magnetic_field, simulation.truth.field_strength
        amplitude = bend.most * 0.5 ** random.integers(bend.octaves) * random.normal()
        bent = field + amplitude * strength * (field / np.abs(field).max()) ** 3
        straight, crooked = (
            calibrate(replace(simulation.recording, magnetic_field=each), misalignment=0) for each in (field, bent)
        )
        scores.append([nees(error(c, simulation.truth), c.covariance) for c in (straight, crooked)])
        by_noise.append(nees(error(crooked, simulation.truth), crooked.noise_covariance))
    straight_mean, crooked_mean = np.mean(scores, axis=0)
    assert (1 - share) * straight_mean + share * crooked_mean == pytest.approx(11, abs=2.58 * np.sqrt(22 / 14))
    assert crooked_mean < 0.8 * np.mean(by_noise)


@pytest.mark.parametrize(
    ("name", "motion", "told"),
    [
        ("cubic", "low", "bends"),
        ("dead-zone", "wide", "about zero"),
        ("hysteresis", "low", "behind the field"),
        ("late-axis", "moderate", "late by"),
        ("gyroscope-scale", "low", "scale"),
        ("gyroscope-cubic", "low", "gyroscope bends"),
        ("scale-drift", "wide", "gain drifts"),
        ("offset-drift", "wide", "hard iron drifts"),
    ],
)
def test_what_a_sensor_does_is_named_and_covered(name: str, motion: str, told: str) -> None:
    """Trusted and beyond three sigmas in nearly all of these cells before there were such columns."""
    fault = FAULTS[name]
    log = record(motion, 1, fault, fault.strong, name)
    calibration = calibrate(log.recording(name))
    assert score(calibration).outcome != "wrong and trusted"
    components = calibration.diagnostics["model_error"]["components"]
    assert any(told in component["sentence"] for component in components), components


@pytest.mark.parametrize(
    ("name", "size", "seeds"),
    [("offset-drift", 0.5e-6, (42049, 42052, 42055, 42056)), ("scale-drift", 0.0173, (42041, 42055))],
)
def test_a_drift_that_is_just_seen_is_covered_at_the_end_of_the_log(
    name: str, size: float, seeds: Iterable[int]
) -> None:
    """The estimate is the mean over the log; all of these were trusted and wrong at its end, at 3.1 to 6.9 sigmas."""
    for seed in seeds:
        log = record("wide", seed, FAULTS[name], size, name)
        found = score(calibrate(log.recording(name)), end=float(log.field_time[-1]))
        assert found.outcome == "right and trusted", (seed, found)


@pytest.mark.parametrize("motion", ["wide", "tiny"])
def test_a_bias_that_drifts_is_covered_at_the_end_of_the_log(motion: str) -> None:
    """By 5 mrad/s in ten minutes; off by 12 to 18 sigmas when only the mean over the log had a sigma."""
    log = record(motion, 42060, FAULTS["bias-drift"], 5e-3, "bias-drift")
    found = calibrate(log.recording("drift"))
    off = np.abs(found.gyro_bias - GYRO_BIAS)
    assert found.trusted
    assert off.max() > 1e-3
    assert (off < 3 * found.sigma["gyro_bias"]).all()
    assert found.sigma["gyro_bias"].max() < 5e-3


def test_a_delay_says_that_there_may_be_a_filter() -> None:
    """On a motion that shows little of its second order; 2 µT off at a sigma of noise of 0.5."""
    fault = FAULTS["low-pass"]
    calibration = calibrate(record("moderate", 1, fault, fault.weak, "low-pass").recording("filtered"))
    clean = calibrate(record("moderate", 1).recording("clean"))
    assert calibration.delay == pytest.approx(0.1, abs=0.01)
    whole, noise = (np.sqrt(matrix[8, 8]) for matrix in (calibration.covariance, calibration.noise_covariance))
    assert whole > 1.2 * noise
    assert np.sqrt(clean.covariance[8, 8] / clean.noise_covariance[8, 8]) < 1.15


def test_an_axis_that_flickers_between_two_values_is_not_trusted() -> None:
    for name, sensor in (("flickering-axis", "magnetometer"), ("flickering-gyroscope-axis", "gyroscope")):
        for share in (FAULTS[name].weak, FAULTS[name].strong):  # a fifth of the log, and more than half of it
            recording = record("moderate", 2100, FAULTS[name], share, name).recording(name)
            assert f"of the {sensor} has only two values" in flickers(recording)
            assert not calibrate(recording).trusted
    for name in ("clean", "coarse", "coarse-gyroscope", "dead-gyroscope"):
        fault = FAULTS[name]
        recording = record("wide", 3, fault, fault.strong, name).recording(name)
        assert flickers(recording) == flickers(recording.rows(recording.time < 4)) == ""  # fewer rows than a block


def test_a_step_that_leaves_out_the_end_is_not_trusted() -> None:
    """The greater part is before the step; a calibration is used after it."""
    fault = FAULTS["iron-step"]
    refused = [
        calibrate(record("wide", seed, fault, fault.strong, "iron-step").recording("step")) for seed in range(3)
    ]
    assert not any(score(calibration).outcome == "wrong and trusted" for calibration in refused)
    assert any("the field jumped at" in calibration.message for calibration in refused)


def test_a_play_follows_as_its_recursion_does() -> None:
    reading = np.cumsum(np.random.default_rng(0).normal(size=(3, 500)), axis=1)
    found, expected = followed(reading, 1.5), reading[:, 0]
    for row, value in zip(found.T, reading.T, strict=True):
        expected = np.clip(expected, value - 1.5, value + 1.5)
        np.testing.assert_allclose(row, expected)


def test_a_loop_is_covered_on_a_motion_that_hardly_tilts() -> None:
    """Of 0.5 µT, where the sweep along z is a few µT: the hard iron is 8 µT off. It was trusted at 3.3 sigmas."""
    log = record("tiny", 930, FAULTS["hysteresis"], 0.5e-6, "hysteresis")
    found = score(calibrate(log.recording("loop")), end=600.0)
    assert found.outcome == "refused"
    assert found.hard_iron_sigmas < 2


def test_a_stay_beside_steel_is_no_loop() -> None:
    """A play whose width goes with the sweep explained it; 13 µT off at 14 sigmas, one was trusted."""
    logs = [
        record("moderate", s, FAULTS["stay-beside-steel"], 20e-6, "stay-beside-steel") for s in range(932, 937)
    ]
    found = [score(calibrate(log.recording("stay")), end=600.0) for log in logs]
    assert not any(each.outcome == "wrong and trusted" for each in found)
    assert np.median([each.hard_iron_sigmas for each in found]) < 2


def test_the_gyroscopes_noise_at_small_rates_is_no_dead_band() -> None:
    """Rates of a survey are 0.01 rad/s; their noise was in column and residual; 46 of 60 logs were refused."""
    calibrations = [calibrate(simulate("survey", 600, 10, seed=seed).recording) for seed in range(5)]
    assert sum(each.trusted for each in calibrations) >= 4
    names = [one["name"] for each in calibrations for one in each.diagnostics["model_error"]["components"]]
    assert "gyroscope:dead band" not in names
