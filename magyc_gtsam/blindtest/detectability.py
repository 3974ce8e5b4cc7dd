"""The visibility of hidden effects above the noise, and the probability that a perfect test detects them."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2, ncx2

from magyc_gtsam.blindtest.generator import noise_free, sensors
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.blindtest.visibility import OF_SAMPLES, misfit
from magyc_gtsam.recording import Array

# Effects that windows hardly show, or with which no model fits.
_OTHERWISE = (*OF_SAMPLES, "sample-hold", "axis-order")
_VALUES = 3  # number of parameters of an effect
_CANDIDATES = 44  # number of hypotheses of a search, which share the family-wise level
_LEVEL = 0.01  # family-wise level


def stands_out(scenario: Scenario) -> float | None:
    """Return the root of the misfit of the twelve parameters to a single effect, in sigmas of the noise.

    It is None where it is not meaningful: for effects on the noise, a sample-hold and exchanged axes, and for several
    effects.
    """
    if scenario.set != "single" or scenario.names[0] in _OTHERWISE:
        return None
    instrument = sensors(scenario.seed)
    return misfit(noise_free(scenario), (instrument["magnetometer_noise"], instrument["gyroscope_noise"]))


def seen_by_a_perfect_test(sigmas: Array) -> float:
    """Return the mean probability that a perfect test detects effects which stand out by `sigmas` (n,).

    The test knows the form of the effects, has three parameters and one false alarm in a hundred searches.
    """
    threshold = chi2.isf(_LEVEL / _CANDIDATES, _VALUES)
    return float(ncx2.sf(threshold, _VALUES, np.maximum(sigmas, 1e-9) ** 2).mean())
