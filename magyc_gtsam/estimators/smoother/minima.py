"""Minima of a field chain compared: which is the lowest, which differ, and which are one."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.estimators.smoother.fit import NEAR, Fit
from magyc_gtsam.estimators.smoother.noise_levels import misfit
from magyc_gtsam.factors.chain.vech import unvech

_CLOSE = 1.1  # ratio of two minima's misfits from which they count as close
_EQUAL = 1.01  # ratio of misfits up to which minima count as equal
_APART = 0.05  # distance of two minima's hard irons, in field strengths, from which they differ


def lowest(fits: list[Fit]) -> tuple[Fit, Fit | None]:
    """The minimum of lowest robust misfit, and a different one within `_CLOSE` of it.

    Minima found with different noise levels and weights are compared at one noise, each residual counting
    up to its rejection threshold; a soft iron that is not positive definite counts only if all are so.
    """
    possible = [fit for fit in fits if positive(fit)] or fits
    noise = min((fit.chain.noise for fit in possible), key=lambda noise: noise.magnetometer)
    ranked = sorted(possible, key=lambda fit: misfit(fit, noise))
    # Where the motion leaves a direction open, all of its minima explain the data: take the roundest.
    equal = [fit for fit in ranked if misfit(fit, noise) < _EQUAL * misfit(ranked[0], noise)]
    best = min(equal, key=lambda fit: float(np.linalg.cond(unvech(fit.state.parameters[:6]))))
    rival = next((fit for fit in ranked if apart(fit, best)), None)
    return best, rival if rival is not None and misfit(rival, noise) < _CLOSE * misfit(best, noise) else None


def close(fit: Fit, best: Fit) -> bool:
    """Whether another calibration explains the windows of `best` almost as well."""
    noise = best.chain.noise
    return misfit(fit, noise) < _CLOSE * misfit(best, noise)


def positive(fit: Fit) -> bool:
    """Whether the soft iron is positive definite."""
    return bool(np.linalg.eigvalsh(unvech(fit.state.parameters[:6]))[0] > 0)


def strength(fit: Fit) -> float:
    """Of the field, T."""
    return float(np.cbrt(abs(np.linalg.det(unvech(fit.state.parameters[:6])))))


def same(fit: Fit, other: Fit) -> bool:
    """Whether two descents of one chain ended at the same minimum: within two sigmas at the noise that they leave."""
    step = fit.state.parameters - other.state.parameters
    left = max(2 * other.reduced.cost / (3 * len(other.chain.windows)), 1.0)  # over the short-term noise, squared
    return fit.converged and other.converged and bool(step @ other.reduced.information @ step < NEAR * left)


def apart(fit: Fit, other: Fit) -> bool:
    """Whether the hard irons of two minima differ."""
    distance = np.linalg.norm(fit.state.parameters[6:9] - other.state.parameters[6:9])
    return bool(distance > _APART * strength(other))
