"""The sensors' noise from differences of neighbouring samples, beside a motion that these contain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise

NOISE = 3e-3  # rad/s


@pytest.mark.parametrize("motion", ["wide", "moderate", "tiny"])
def test_a_fast_motion_is_no_noise(motion: str) -> None:
    """Sampled at 10 Hz, the second differences of some dives are 1.5 times those of the noise."""
    for seed in range(4):
        recording = mg.simulate(motion, 600, seed=seed, gyroscope_noise=NOISE).recording
        assert short_term_noise(recording).gyroscope == pytest.approx(NOISE, rel=0.07)


def test_filtered_noise_is_measured_by_second_differences() -> None:
    """Of which higher ones show ever less; so do those of a driver that interpolates."""
    random, rows = np.random.default_rng(4), 6000
    white = NOISE * random.standard_normal((rows, 3))
    filtered = lfilter([0.5], [1, -0.5], white, axis=0)
    held = white.copy()
    held[1:-1:2] = 0.5 * (held[:-2:2] + held[2::2])
    recording = mg.simulate("wide", 600, seed=1).recording
    for rate in (filtered, held):
        second = np.diff(rate, 2, axis=0)
        real = (second**2).sum(axis=1)
        found = short_term_noise(replace(recording, angular_rate=rate)).gyroscope
        upper = np.sqrt(np.quantile(real, 0.75) / 18) / 1.170
        assert found == pytest.approx(upper, rel=0.05)
