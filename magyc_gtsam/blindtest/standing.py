"""How far what was hidden stands out of the noise of its own recording, and what a perfect test would see of it."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2, ncx2

from magyc_gtsam.blindtest.generator import noise_free, sensors
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.blindtest.visibility import OF_SAMPLES, misfit
from magyc_gtsam.recording import Array

# Of these windows show little, or nothing fits beside them.
_OTHERWISE = (*OF_SAMPLES, "sample-hold", "axis-order")
_VALUES = 3  # of an effect
_CANDIDATES = 44  # of a search, which share the family-wise level
_LEVEL = 0.01


def stands_out(scenario: Scenario) -> float | None:
    """Root of the misfit that the twelve parameters leave of a single effect, in sigmas of this recording's noise.

    None where it says little: of effects on the noise, of a hold and of exchanged axes, and beside other effects.
    """
    if scenario.set != "single" or scenario.names[0] in _OTHERWISE:
        return None
    instrument = sensors(scenario.seed)
    return misfit(noise_free(scenario), (instrument["magnetometer_noise"], instrument["gyroscope_noise"]))


def seen_by_a_perfect_test(sigmas: Array) -> float:
    """Mean probability with which effects that stand out by `sigmas` (n,) pass the level of one search in a hundred.

    Of a test that knows their form, and spends three values on it.
    """
    threshold = chi2.isf(_LEVEL / _CANDIDATES, _VALUES)
    return float(ncx2.sf(threshold, _VALUES, np.maximum(sigmas, 1e-9) ** 2).mean())
