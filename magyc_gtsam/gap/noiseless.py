"""Whether a recording has noise at all: every test of the workflow measures a misfit against it."""

from __future__ import annotations

from math import comb

import numpy as np

from magyc_gtsam.gap.noise_effects import lattice
from magyc_gtsam.recording import Recording

LEAST = 5e-11  # T per sample: less than a laboratory's fluxgate has, more than rounding to single precision makes
_ORDER = 12  # of the differences, which a motion sampled eight times or more in its shortest period does not enter
_MOST = 90.0  # % of the differences; the others may span what is not smooth


def noiseless(recording: Recording) -> bool:
    """Whether the magnetometer has no measurable noise, as what a simulator computed exactly.

    Coarse readings that seldom change are none of these: their steps are an effect that can be named.
    """
    value = recording.magnetometer.value
    if len(value) <= _ORDER or max(lattice(axis) for axis in value.T) > LEAST:
        return False
    differences = np.diff(value, n=_ORDER, axis=0)
    level = np.sqrt((differences**2).mean(axis=1) / comb(2 * _ORDER, _ORDER))
    return bool(np.percentile(level, _MOST) < LEAST)
