"""A hard iron that changes within a recording is told from a disturbance by the place."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.iron_change import disturbed_stretches, hard_iron_change
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.search import fit_field_chain

CHANGE = np.array([2e-6, -1e-6, 2e-6])


def wide(seed: int) -> mg.Recording:
    return mg.simulate("wide", 400, seed=seed).recording


def with_field(recording: mg.Recording, added: np.ndarray) -> mg.Recording:
    return replace(recording, magnetic_field=recording.magnetic_field + added)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("start", "end"), [(0.0, 130.0), (120.0, 250.0)])
def test_a_change_in_the_smaller_part_is_found(seed: int, start: float, end: float) -> None:
    recording = wide(seed)
    inside = (recording.time >= start) & (recording.time < end)
    changed = with_field(recording, inside[:, None] * 3 * CHANGE)
    calibration = mg.calibrate(changed)
    assert not calibration.trusted
    assert "the hard iron changed at" in calibration.message
    fit, options = fitted(changed), SmootherOptions()
    stretches = disturbed_stretches(changed, fit, options)
    found = hard_iron_change(changed, stretches, fit, mg.calibrate(recording), options)
    assert found is not None
    np.testing.assert_allclose(found.stretches, [[start, end]], atol=4)
    np.testing.assert_allclose(found.change, 3 * CHANGE, atol=1.2e-6)


def test_a_hard_iron_that_jumps_to_and_fro_is_found() -> None:
    """As by a set/reset that fails; each stretch by itself would be too short, or hold what is not of it."""
    recording = wide(0)
    away = np.isin(recording.time // 14, [1, 3, 5, 8, 9, 12, 14, 17, 20, 23])
    changed = with_field(recording, away[:, None] * 5 * CHANGE)
    fit, options = fitted(changed), SmootherOptions()
    stretches = disturbed_stretches(changed, fit, options)
    found = hard_iron_change(changed, stretches, fit, mg.calibrate(recording), options)
    assert found is not None
    parts = [(1, 2), (3, 4), (5, 6), (8, 10), (12, 13), (14, 15), (17, 18), (20, 21), (23, 24)]
    expected = 14 * np.array(parts)
    np.testing.assert_allclose(found.stretches, expected, atol=4)
    np.testing.assert_allclose(found.change, 5 * CHANGE, atol=1.2e-6)
    calibration = mg.calibrate(changed)
    assert not calibration.trusted
    assert "the hard iron changed at 14 s and 28 s and 16 more times by 15 µT" in calibration.message


def test_a_scale_that_changes_is_another_instrument() -> None:
    """As of units that are mixed up: the place may change the field by 20 %, but not the hard iron with it."""
    recording = wide(1)
    later = recording.time > 240
    scaled = replace(recording, magnetic_field=recording.magnetic_field * np.where(later, 1.2, 1.0)[:, None])
    calibration = mg.calibrate(scaled)
    assert not calibration.trusted
    assert "the instrument is another one between 240 and" in calibration.message


def fitted(recording: mg.Recording) -> Fit:
    return fit_field_chain(recording, SmootherOptions())


@pytest.mark.parametrize("seed", range(4))
def test_another_field_at_the_place_is_none(seed: int) -> None:
    """A steel wall turns and strengthens the field for two minutes, in the world's axes."""
    recording = wide(seed)
    assert recording.attitude is not None
    inside = (recording.time >= 120) & (recording.time < 240)
    wall = Rotation.from_quat(recording.attitude).inv().apply([6e-6, -5e-6, 6e-6])
    calibration = mg.calibrate(with_field(recording, inside[:, None] * wall))
    assert "hard iron changed" not in calibration.message
    assert "hard iron changed" not in mg.calibrate(recording).message


@pytest.mark.parametrize(("start", "end"), [(0.0, 150.0), (120.0, 250.0)])
def test_a_part_of_another_instrument_is_told_from_a_disturbance(start: float, end: float) -> None:
    recording = wide(1)
    inside = (recording.time >= start) & (recording.time < end)
    other = Rotation.from_rotvec(np.radians([0, 5, 0])).as_matrix() @ np.diag([1.12, 0.9, 1.05])
    field = recording.magnetic_field.copy()
    field[inside] = field[inside] @ other.T + 10 * CHANGE
    calibration = mg.calibrate(replace(recording, magnetic_field=field))
    assert not calibration.trusted
    found = re.search(r"the instrument is another one between (\d+) and (\d+) s", calibration.message)
    assert found is not None
    assert [float(each) for each in found.groups()] == pytest.approx([start, end], abs=4)


@pytest.mark.parametrize(("share", "size"), [(0.1, 8e-6), (0.25, 8e-6), (0.1, 2.5e-6)])
@pytest.mark.parametrize("motion", ["wide", "low"])
def test_a_ramp_at_the_end_is_no_disturbance_to_leave_out(motion, share, size):
    """Its windows were rejected, or absorbed, and the calibration of what was before trusted: up to 9° off."""
    simulation = mg.simulate(motion, 400, seed=5)
    recording, truth = simulation.recording, simulation.truth
    ramp = np.clip(recording.time / recording.time[-1] - (1 - share), 0, None) / share
    change = size * np.array([0.6, -0.64, 0.48])
    found = mg.calibrate(replace(recording, magnetic_field=recording.magnetic_field + ramp[:, None] * change))
    away = found.hard_iron - truth.hard_iron - change
    assert not found.trusted or away @ np.linalg.solve(found.covariance[6:9, 6:9], away) < 3 * 3**2


def test_a_disturbance_that_is_over_before_the_end_is_left_out_as_before():
    simulation = mg.simulate("wide", 400, seed=5)
    recording = simulation.recording
    passed = (recording.time > 300) & (recording.time < 310)
    field = recording.magnetic_field + 8e-6 * passed[:, None]
    found = mg.calibrate(replace(recording, magnetic_field=field))
    assert found.trusted
    assert np.abs(found.hard_iron - simulation.truth.hard_iron).max() < 0.5e-6
