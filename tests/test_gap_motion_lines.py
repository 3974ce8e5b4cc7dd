"""Lines of the spectrum at the frequencies of the motion, which are no tones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.samples.first import First
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


def swell(delay: float) -> mg.Recording:
    """Return a vehicle that turns slowly about all axes and rolls by 3° in a swell, with a late magnetometer."""
    random = np.random.default_rng(1)
    time = np.arange(0, 300, 0.1)

    def attitude(time: np.ndarray) -> Rotation:
        yaw = 3 * np.sin(0.057 * time) + 0.05 * time
        pitch, roll = 0.8 * np.sin(0.082 * time + 1), 0.8 * np.sin(0.069 * time + 2)
        return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll + 0.06 * np.sin(2 * np.pi * ROLL * time)], 1))

    step = 1e-4
    rate = (attitude(time - step).inv() * attitude(time + step)).as_rotvec() / (2 * step)
    field = attitude(time - delay).inv().apply([20e-6, 1e-6, 45e-6]) + [5e-6, -3e-6, 2e-6]
    noise = random.standard_normal((2, len(time), 3))
    return mg.Recording(time, field + 0.3e-6 * noise[0], rate + 2e-3 * noise[1])


def test_the_swell_is_no_tone_among_the_hypotheses_either() -> None:
    """A delay leaves a line at the roll, above the slow turns that most of the field's change is due to."""
    recording = swell(0.1)
    first = First(recording, base_model(recording, None, short_term_noise(recording)))
    (tone,) = (score for score in first.noise if score.name == "tone")
    assert tone.setting["frequency"] == pytest.approx(ROLL, abs=2e-3)
    assert tone.evidence > 20
    assert tone.setting["frequency"] > first.fine.edge
    assert not tone.significant
