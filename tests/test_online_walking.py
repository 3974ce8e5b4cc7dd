"""A hard iron and a bias that walk at random: followed, with an honest covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_online import feed

from magyc_gtsam import OnlineCalibrator, simulate
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.online.random_walk import _local_noise


def walking(motion, seed, *, hard_iron=0.0, bias=0.0, duration=700.0):
    """The recording, and hard iron and bias at its end; walks in T and rad/s per √h."""
    simulation = simulate(motion, duration=duration, seed=seed)
    recording, truth = simulation.recording, simulation.truth
    step = np.sqrt(np.median(np.diff(recording.time)) / 3600)
    walk = np.cumsum(np.random.default_rng(seed).standard_normal((len(recording.time), 6)), axis=0) * step
    moved, turned = hard_iron * walk[:, :3], bias * walk[:, 3:]
    recording = replace(
        recording,
        magnetic_field=recording.magnetic_field + moved,
        angular_rate=recording.angular_rate + turned,
    )
    return recording, truth.hard_iron + moved[-1], truth.gyro_bias + turned[-1]


def test_a_walking_hard_iron_is_known_as_well_as_is_said():
    scores = []
    for seed in range(2):
        recording, hard_iron, _ = walking("wide", seed, hard_iron=4e-6, duration=200.0)
        online = feed(OnlineCalibrator(hard_iron_drift=4e-6), recording, step=50.0)
        assert online.converged
        assert online.changes == ()
        error = online.calibration.hard_iron - hard_iron
        covariance = online.calibration.covariance[6:9, 6:9]
        assert np.sqrt(np.trace(covariance) / 3) < 0.35e-6  # 1.1 µT were walked meanwhile
        scores.append(error @ np.linalg.solve(covariance, error))
    assert 0.19 < np.mean(scores) < 11.2  # χ² of 6 degrees of freedom over 2, at 99.8 %


def test_a_walking_bias_is_followed():
    recording, _, bias = walking("wide", 3, bias=20e-3, duration=300.0)
    online = feed(OnlineCalibrator(gyro_bias_drift=20e-3), recording, step=50.0)
    error = np.abs(online.calibration.gyro_bias - bias)
    assert (error < 4 * online.calibration.sigma["gyro_bias"]).all()
    fixed = feed(OnlineCalibrator(), recording, step=50.0).calibration.gyro_bias
    assert np.linalg.norm(error) < 0.5 * np.linalg.norm(fixed - bias)


def test_a_strong_walk_does_not_keep_it_from_converging():
    recording, hard_iron, _ = walking("moderate", 4, hard_iron=5e-6, duration=240.0)
    online = feed(OnlineCalibrator(hard_iron_drift=5e-6), recording, step=50.0)
    assert online.calibration.converged
    assert (np.abs(online.calibration.hard_iron - hard_iron) < 4 * online.calibration.sigma["hard_iron"]).all()


def test_noise_levels_are_those_of_short_segments():
    """A walk of many sigmas does not enter them."""
    recording, *_ = walking("wide", 5, hard_iron=2.5e-6)
    still = simulate("wide", duration=700, seed=5).recording
    fit = fit_field_chain(still, delay=0.0)
    walked = fit_field_chain(recording, start=fit.state.parameters, delay=0.0)
    assert walked.chain.noise.gyroscope > 1.3 * fit.chain.noise.gyroscope
    noise, colour, freedom = _local_noise(walked.chain.windows, SensorNoise(2e-6, 1e-2), fit.state.parameters)
    assert noise.magnetometer == pytest.approx(fit.chain.noise.magnetometer, rel=0.1)
    assert noise.gyroscope == pytest.approx(fit.chain.noise.gyroscope, rel=0.25)
    assert colour < 2.0
    assert 0 < freedom < 2 * len(walked.chain.windows)
