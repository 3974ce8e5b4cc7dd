"""Lines of the spectrum at the frequencies of the motion, which are no tones."""

from __future__ import annotations

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.gap.samples.motion_lines import follows_motion

ROLL, MOTOR = 0.14, 2.9  # Hz


def rolling(shaken: float = 0.0) -> mg.Recording:
    """Return a vehicle that turns at random and rolls with a swell, with a motor that shakes it, rad/s."""
    random = np.random.default_rng(5)
    time = np.arange(0, 300, 0.1)
    rate = 0.05 * random.standard_normal((len(time), 3))
    rate[:, 0] += 0.3 * np.cos(2 * np.pi * ROLL * time) + shaken * np.cos(2 * np.pi * MOTOR * time)
    return mg.Recording(time, 50e-6 * np.eye(3)[random.integers(3, size=len(time))], rate)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_line_at_a_harmonic_of_the_motion_follows_it(order: int) -> None:
    assert follows_motion(rolling(), order * ROLL, 0.3e-6)


def test_other_lines_do_not_follow_the_motion() -> None:
    recording = rolling()
    assert not any(follows_motion(recording, f, 0.3e-6) for f in np.random.default_rng(6).uniform(0.7, 4.9, 50))


def test_a_line_larger_than_the_field_moves_is_of_the_motor_that_shakes_the_gyroscope() -> None:
    recording = rolling(shaken=0.05)  # turns the field by 0.14 µT
    assert follows_motion(recording, MOTOR, 0.05e-6)
    assert not follows_motion(recording, MOTOR, 0.5e-6)
