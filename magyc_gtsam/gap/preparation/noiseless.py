"""A test for noise-free recordings: every test of the workflow measures a misfit relative to the noise."""

from __future__ import annotations

from math import comb

import numpy as np

from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.noise_effects import lattice
from magyc_gtsam.recording import Recording

_ORDER = 12  # of the differences, which suppress a motion with eight or more samples in its shortest period


def noiseless(recording: Recording) -> bool:
    """Return whether the magnetometer has no measurable noise, as exact output of a simulator.

    Coarse readings that seldom change are not noise-free: their steps are an effect that can be named.
    """
    value = recording.magnetometer.value
    if len(value) <= _ORDER or max(lattice(axis) for axis in value.T) > RULES.noiseless:
        return False
    differences = np.diff(value, n=_ORDER, axis=0)
    level = np.sqrt((differences**2).mean(axis=1) / comb(2 * _ORDER, _ORDER))
    return bool(np.percentile(level, RULES.noiseless_share) < RULES.noiseless)
