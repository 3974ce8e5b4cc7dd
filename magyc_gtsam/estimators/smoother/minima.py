"""Two minima of a field chain: their comparison, and a start for the second from a part of the recording.

If the instrument was another one for some of the windows (an axis whose sign was wrong for a third of the log), a
descent on all windows may miss the minimum of the majority. A part of the log may be free of such windows.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from magyc_gtsam.estimators.smoother import starts
from magyc_gtsam.estimators.smoother.fit import BRIEF, NEAR, Fit, begin, descend
from magyc_gtsam.estimators.smoother.noise_levels import misfit, weigh
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.facts import strength_of
from magyc_gtsam.factors.chain.small import eigenvectors
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.errors import MagycError

_APART = 0.05  # distance of the hard irons of two minima, in field strengths, from which they are distinct
_PARTS = 4
_ROUNDS = 3  # updates of the weights


def lower(fit: Fit, other: Fit) -> bool:
    """Return whether a minimum has a lower robust misfit than another one, or is the only one with a possible iron.

    Minima found with different noise levels and weights are compared at one noise level, with each residual truncated
    at its rejection threshold.
    """
    if positive(fit) != positive(other):
        return positive(fit)
    noise = min(fit.chain.noise, other.chain.noise, key=lambda noise: noise.magnetometer)
    return misfit(fit, noise) < misfit(other, noise)


def positive(fit: Fit) -> bool:
    """Return whether the soft iron is positive definite."""
    return bool(eigenvectors(unvech(fit.state.parameters[:6]))[0][0] > 0)


def strength(fit: Fit) -> float:
    """Return the field strength, T."""
    return strength_of(unvech(fit.state.parameters[:6]))


def apart(fit: Fit, other: Fit) -> bool:
    """Return whether the hard irons of two minima differ."""
    distance = np.linalg.norm(fit.state.parameters[6:9] - other.state.parameters[6:9])
    return bool(distance > _APART * strength(other))


def by_a_part(fit: Fit, noise: SensorNoise, most: float) -> Fit | None:
    """Return all windows, weighted at the calibration of the part that explains them best; None if none is better.

    Args:
        fit: of the whole recording, with thirteen parameters.
        noise: at which misfits are compared.
        most: upper bound of the misfit; the hard iron must also differ from that of `fit`.
    """
    chain, found = replace(fit.chain, noise=noise), None
    for first, stop in pairwise(np.linspace(0, len(chain.windows), _PARTS + 1).astype(int).tolist()):
        part = chain.part(first, stop)
        try:
            own = descend(begin(part, starts.from_gyroscope(part.windows), fit.free, BRIEF), NEAR)
        except MagycError:  # too little motion
            continue
        if not apart(own, fit):
            continue
        whole = weigh(chain, own.state.parameters, _ROUNDS)
        left = misfit(whole, noise)
        if left < most:
            most, found = left, replace(whole, free=fit.free, patience=BRIEF)
    return found
