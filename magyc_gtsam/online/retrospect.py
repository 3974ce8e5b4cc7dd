"""Where a log does not fit as a whole but its end does: since when it fits, and what the hard iron was before."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.chain_fit import weigh
from magyc_gtsam.factors.field_chain import State, Weights
from magyc_gtsam.factors.rotations import Array
from magyc_gtsam.online.summary import ContinuedChain

_REJECTED = 16.27  # χ² of 3 degrees of freedom at 99.9 %, what a window that does not fit counts
_UNKNOWN = 1e-6  # weight of windows whose field is left out, not quite zero so that all directions are determined


class Beginning(NamedTuple):
    """The first window since which a calibration holds, the time between it and the one before, and the step in
    hard iron there (3,) T, after less before, with their sigmas."""

    window: int
    time: float
    time_sigma: float
    step: Array
    sigma: Array


def find_beginning(chain: ContinuedChain, parameters: Array) -> Beginning | None:
    """Since when θ of the end explains the windows of `chain`; None if it always does, or never."""
    fit = weigh(chain, parameters)
    misfit, _ = chain.squares(chain.residuals(fit.state))
    # The split that costs least, a window before it counting as half rejected.
    gain = 0.5 * _REJECTED - np.minimum(misfit, _REJECTED)
    n = int(np.argmax(np.cumsum(gain[::-1])[::-1]))
    if not 3 <= n < len(misfit) - 3:
        return None
    # The directions before it follow from those after by the gyroscope alone.
    window, link = chain.unweighted()
    window[:n] = _UNKNOWN
    state = State(parameters, fit.state.direction.copy())
    state.direction[:, :n] = state.direction[:, n : n + 1]
    state, _ = chain.settle(state, Weights(window, link))
    # Not all before the split need be of one hard iron, with a hand at work: the middle of its samples.
    before = chain.residuals(state).window[:, :n].T.repeat(chain.windows.count[:n].astype(int), axis=0)
    step = np.median(before, axis=0)
    sigma = 1.4826 * np.median(np.abs(before - step), axis=0) + chain.window_sigma[n]
    time = chain.windows.time
    return Beginning(n, float(time[n] + time[n - 1]) / 2, float(time[n] - time[n - 1]) / np.sqrt(12), step, sigma)
