"""The minima of a field chain: the lowest, distinct and identical ones, and a start from a part of the recording."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from magyc_gtsam.estimators.smoother import starts
from magyc_gtsam.estimators.smoother.fit import BRIEF, NEAR, Fit, begin, descend
from magyc_gtsam.estimators.smoother.noise_levels import misfit, weigh
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.errors import MagycError

_CLOSE = 1.1  # ratio of misfits up to which two minima count as close
_EQUAL = 1.01  # ratio of misfits up to which minima count as equal
_APART = 0.05  # distance of the hard irons of two minima, in field strengths, from which they are distinct


def lowest(fits: list[Fit]) -> tuple[Fit, Fit | None]:
    """Return the minimum of lowest robust misfit, and a distinct one within `_CLOSE` of it; None if there is none.

    Minima found with different noise levels and weights are compared at one noise level, with each residual truncated
    at its rejection threshold. Minima with a soft iron that is not positive definite count only if there are no others.
    """
    possible = [fit for fit in fits if positive(fit)] or fits
    noise = min((fit.chain.noise for fit in possible), key=lambda noise: noise.magnetometer)
    ranked = sorted(possible, key=lambda fit: misfit(fit, noise))
    # If the motion leaves a direction unobserved, many minima explain the data equally: take the best-conditioned iron.
    equal = [fit for fit in ranked if misfit(fit, noise) < _EQUAL * misfit(ranked[0], noise)]
    best = min(equal, key=lambda fit: float(np.linalg.cond(unvech(fit.state.parameters[:6]))))
    rival = next((fit for fit in ranked if apart(fit, best)), None)
    return best, rival if rival is not None and misfit(rival, noise) < _CLOSE * misfit(best, noise) else None


def close(fit: Fit, best: Fit) -> bool:
    """Return whether another fit explains the data almost as well as `best`, at the noise of `best`."""
    noise = best.chain.noise
    return misfit(fit, noise) < _CLOSE * misfit(best, noise)


def positive(fit: Fit) -> bool:
    """Return whether the soft iron is positive definite."""
    return bool(np.linalg.eigvalsh(unvech(fit.state.parameters[:6]))[0] > 0)


def strength(fit: Fit) -> float:
    """Return the field strength, T."""
    return float(np.cbrt(abs(np.linalg.det(unvech(fit.state.parameters[:6])))))


def same(fit: Fit, other: Fit) -> bool:
    """Return whether two descents of one chain ended at the same minimum, within two sigmas at the residual's noise."""
    step = fit.state.parameters - other.state.parameters
    left = max(
        2 * other.reduced.cost / (3 * len(other.chain.windows)), 1.0
    )  # variance over that of short-term noise
    return fit.converged and other.converged and bool(step @ other.reduced.information @ step < NEAR * left)


def apart(fit: Fit, other: Fit) -> bool:
    """Return whether the hard irons of two minima differ."""
    distance = np.linalg.norm(fit.state.parameters[6:9] - other.state.parameters[6:9])
    return bool(distance > _APART * strength(other))


_PARTS = 4
_ROUNDS = 3  # updates of the weights


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
