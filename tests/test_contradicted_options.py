"""What is given and the data contradict: an earlier calibration of another unit, too small a noise, aligned chips."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magyc_gtsam import Calibration, Recording, calibrate, simulate
from magyc_gtsam.simulation.sensor import HARD_IRON, SOFT_IRON


def _alone(motion: str, seed: int, **chosen: object) -> Recording:
    """Two sensors and nothing else."""
    return replace(simulate(motion, seed=seed, **chosen).recording, attitude=None, acceleration=None)


@pytest.fixture(scope="module")
def ship() -> Recording:
    """Five minutes that do not determine the calibration by themselves."""
    return _alone("ship", 4, duration=300)


def _earlier(soft_iron: np.ndarray, hard_iron: np.ndarray) -> Calibration:
    return calibrate(_alone("wide", 504, soft_iron=soft_iron, hard_iron=hard_iron))


@pytest.mark.parametrize(("unit", "moved"), [(0.0, 5e-6), (0.05, 5e-6), (0.05, 30e-6)])
def test_another_unit_does_not_hide_in_the_noise_of_a_log_of_little_motion(
    ship: Recording, unit: float, moved: float
) -> None:
    """It was trusted with up to 20 µT at 180 sigmas: the noise was 8 in place of 1 µT, and what the log shows by
    itself, far from its minimum, excludes nothing."""
    soft_iron = SOFT_IRON * (1 + unit * np.array([[1, 0.5, -1], [0.5, -1, 0.5], [-1, 0.5, 1]]))
    prior = _earlier(soft_iron, HARD_IRON + moved * np.array([0.5, 0.6, -0.6]))
    calibration = calibrate(ship, prior=prior)
    assert not calibration.trusted
    assert "contradict the earlier calibration" in calibration.message


def test_the_right_unit_is_enough_for_that_log(ship: Recording) -> None:
    calibration = calibrate(ship, prior=_earlier(SOFT_IRON, HARD_IRON))
    assert calibration.trusted
    assert np.abs(calibration.hard_iron - HARD_IRON).max() < 0.3e-6


def test_a_noise_that_is_given_too_small_is_refused_and_named() -> None:
    """It was trusted with 1 µT at 4.8 sigmas, and an invented misalignment."""
    recording = _alone("moderate", 9)
    calibration = calibrate(recording, noise=(0.5e-6, 2.5e-3))
    assert not calibration.trusted
    assert "the magnetometer's noise is given as 0.5 µT, and the data scatter by 0.8" in calibration.message
    assert calibrate(recording, noise=(1e-6, 5e-3)).trusted


def test_chips_given_as_aligned_that_the_data_show_askew_are_refused() -> None:
    recording = _alone("wide", 1)
    turn = Rotation.from_rotvec(np.radians(1.5) * np.array([0.6, -0.64, 0.48])).as_matrix()
    askew = replace(recording, angular_rate=recording.angular_rate @ turn.T)
    calibration = calibrate(askew, misalignment=0)
    assert not calibration.trusted
    assert "the chips are given as aligned" in calibration.message
    assert calibrate(recording, misalignment=0).trusted


def test_a_prior_far_from_the_data_of_a_level_log_is_refused() -> None:
    """The columns of effects explained more than all of a poor fit, and a covariance was not finite."""
    direction = np.random.default_rng(7007).standard_normal(3)
    moved = HARD_IRON + 20e-6 * direction / np.linalg.norm(direction)
    stale = calibrate(_alone("wide", 507, hard_iron=moved))
    calibration = calibrate(_alone("level", 7), prior=stale)
    assert not calibration.trusted
    assert "contradict the earlier calibration" in calibration.message
