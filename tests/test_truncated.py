"""Readings that a cast to integers truncates towards zero, told from rounded ones and calibrated as what they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.truncated import middles, steps_from_zero
from magyc_gtsam.simulation.sensor import Simulation


def _sigmas(calibration: mg.Calibration, simulation: Simulation) -> float:
    assert calibration.covariance is not None
    error = np.abs(calibration.hard_iron - simulation.truth.hard_iron)
    return float((error / np.sqrt(np.diag(calibration.covariance)[6:9])).max())


@pytest.mark.parametrize("spread", [0.8, 1.0, 3.0])
def test_zero_is_counted_too_often(spread: float) -> None:
    """Of a sensor at rest with an offset, beside a motion; its noise is in steps; of less the fit decides."""
    random = np.random.default_rng(1)
    rest = 0.4 + spread * random.standard_normal((20_000, 3))
    reading = np.concatenate([rest, 40 * random.standard_normal((5_000, 3))])
    step = 2e-3
    for rounded in (np.round(reading), np.floor(reading), np.round(reading + 0.3) - 0.3):
        assert not steps_from_zero(step * rounded, step * spread).any()
    logged = (step * np.trunc(reading)).astype(np.float32).astype(float)
    np.testing.assert_allclose(steps_from_zero(logged, step * spread), step, rtol=1e-6)
    assert not steps_from_zero(step * reading, step * spread).any()


def test_an_axis_that_never_reads_zero_is_truncated_as_the_others_are() -> None:
    reading = 20 * np.random.default_rng(2).standard_normal((20_000, 3)) + [0, 0, 300]
    np.testing.assert_allclose(steps_from_zero(np.trunc(reading), 1.0), 1.0)
    nearly = np.array([[2.0, -1.0, 1e-19], [0.0, -1e-19, 5.0]])  # turned by a matrix that is not quite exact
    np.testing.assert_allclose(middles(nearly, np.array([1.0, 1.0, 0.0])), [[2.5, -1.5, 0], [0, 0, 5]], atol=1e-18)
    reading[:, 0] += 300
    reading[:, 1] -= 300
    assert not steps_from_zero(np.trunc(reading), 1.0).any()  # a constant offset of half a step


@pytest.mark.parametrize("motion", ["wide", "moderate", "tiny"])
def test_truncated_rates_do_not_move_the_iron(motion: str) -> None:
    """Steps of twice the noise moved it by 2 to 8 µT."""
    simulation = mg.simulate(motion, 600, seed=700)
    step = 1e-2
    rate = simulation.recording.angular_rate / step
    logged = [replace(simulation.recording, angular_rate=step * how(rate)) for how in (np.trunc, np.round)]
    truncated, rounded = (mg.calibrate(recording) for recording in logged)
    assert truncated.trusted
    assert _sigmas(truncated, simulation) < 3
    assert np.abs(truncated.hard_iron - rounded.hard_iron).max() < 0.5e-6
    assert truncated.diagnostics["truncated"] == pytest.approx({"gyroscope": step})
    assert "the gyroscope's readings are truncated towards zero, in steps of 10 mrad/s" in truncated.message
    assert "truncated" not in rounded.diagnostics


def test_truncated_fields_do_not_move_the_iron() -> None:
    """Steps of five times the noise moved it by 0.9 µT; the vertical axis never reads zero."""
    simulation = mg.simulate("wide", 600, seed=701, magnetometer_noise=0.4e-6)
    field = simulation.recording.magnetic_field / 2e-6
    calibration = mg.calibrate(replace(simulation.recording, magnetic_field=2e-6 * np.trunc(field)))
    assert calibration.trusted
    assert _sigmas(calibration, simulation) < 3
    assert np.linalg.norm(calibration.hard_iron - simulation.truth.hard_iron) < 0.15e-6
    assert calibration.diagnostics["truncated"] == pytest.approx({"magnetometer": 2e-6})


def test_truncated_rates_get_no_name_by_the_gap() -> None:
    """They were called a scale of the gyroscope."""
    simulation = mg.simulate("wide", 300, seed=700)
    rate = 5e-3 * np.trunc(simulation.recording.angular_rate / 5e-3)
    gap = mg.find_gap(replace(simulation.recording, angular_rate=rate))
    assert gap.verdict == "none", gap.sentence
    (left_out,) = gap.diagnostics["left_out"]
    assert left_out == "the truncation towards zero of the gyroscope's readings, in steps of 5 mrad/s"
    assert _sigmas(gap.calibration, simulation) < 3
