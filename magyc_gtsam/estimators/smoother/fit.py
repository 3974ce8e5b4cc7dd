"""The descent of a field chain to its minimum: damped Gauss–Newton on θ."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt

import numpy as np

from magyc_gtsam.estimators.smoother.beside import ColumnProducts
from magyc_gtsam.estimators.smoother.skew_prior import Skew
from magyc_gtsam.estimators.smoother.whitened_fit import Minimum
from magyc_gtsam.factors.chain.chain_values import Reduced
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.small import eigenvectors, inverse_root, solved
from magyc_gtsam.factors.errors import MagycError

MAX_ITERATIONS = 40
# Eliminations after which a start that has not converged is abandoned. Of 29 real logs, the trusted ones took 8 to 62;
# of 540 simulated logs with a fault, the median was 6, the 99th percentile 78 and the maximum 176. The second half of
# an online run during which a magnet was attached by hand took more than 250: with a limit of 250 the removal of the
# magnet was not found.
PATIENCE = 300
# The limit for auxiliary fits, whose question a fit without convergence leaves unanswered, and for starts from a part
# of the log: starts that led to another calibration of the same logs took 12 to 53.
BRIEF = 120
SETTLED = 5e-3  # squared distance from the minimum, in sigmas, at which a descent ends
NEAR = 4.0  # the same limit between updates of noise levels and weights: two sigmas
_UNSETTLED = 0.1  # gain per window, in squared sigmas, from which the directions are relinearised
_ROUNDING = 1e-9  # tolerance on the cost, which is close to zero for noise-free data
_SLOW_LAGS = 8  # windows, over which autocorrelations are added
_ROUNDED = 1e-8  # eigenvalue of a scaled information below which rounding may matter to its inverse
_REJECTED = 0.5  # weight of a window or a link, below which it is rejected
COLOURED = 3.0  # standard deviations from which an autocorrelation counts


@dataclass(frozen=True, eq=False)
class Fit(Minimum):
    """A minimum of a field chain and the record of the descent.

    Attributes:
        iterations: eliminations spent.
        converged: the last steps of the parameters and of the noise levels were small relative to their sigmas.
        noise_freedom: degrees of freedom from which the gyroscope's noise was estimated; infinite if it is known.
        skew: estimate of the misalignment between the chips; None if it was not estimated.
        patience: eliminations after which a start that has not converged is abandoned.
        last_steps: squared lengths of the last two steps, in sigmas; 0 where there is none, or it was damped.
    """

    iterations: int = 0
    converged: bool = False
    noise_freedom: float = np.inf
    skew: Skew | None = None
    patience: int = PATIENCE
    last_steps: tuple[float, float] = (0.0, 0.0)

    @property
    def hopeless(self) -> bool:
        """Whether the start is abandoned."""
        return not self.converged and self.iterations > self.patience

    @property
    def rejects(self) -> bool:
        """Whether a window or a link has a weight below a half."""
        return float(min(self.weights.window.min(), self.weights.link.min())) < _REJECTED

    def with_skew_estimate(self, skew: Skew) -> Fit:
        """Return a copy with the given misalignment estimate; cached properties are kept."""
        result = copy.copy(self)
        object.__setattr__(result, "skew", skew)
        return result

    @cached_property
    def beside(self) -> ColumnProducts:
        """The products of unmodelled columns with this fit at its minimum."""
        # The copy avoids a reference cycle, which would keep both alive until the garbage collector runs.
        own = copy.copy(self)
        own.__dict__["residuals"] = self.residuals  # computed once for both
        return ColumnProducts(own)

    @cached_property
    def covariance(self) -> Array:
        """(p, p) inverse information; zeros for fixed parameters, very large or infinite where it is singular."""
        return inverse_information(self.reduced.information, self.free)

    @property
    def widening(self) -> float:
        """1 + 2/ν, the factor by which the covariance is too small on average because the noise level is estimated.

        A variance σ² estimated from ν degrees of freedom has E[1/σ̂²] = (1 + 2/ν)/σ² to first order, for the same
        reason that Student's t is wider than a normal distribution. ν is the redundancy of the links, from which the
        gyroscope's noise is estimated; the redundancy of the windows, for the magnetometer's, is many times larger.
        """
        return 1 + 2 / max(self.noise_freedom, 1.0)

    @cached_property
    def colour(self) -> float:
        """1 + 2 Σ ρ_k, the autocorrelation time of the whitened residuals in windows; 1 for white residuals.

        A field that varies over the room, or a filtered magnetometer, leaves autocorrelated residuals, which reduces
        the effective number of windows. The value is the larger of those in the sensor's and in the world's axes.
        """
        return max(colour_of(residual) for residual in self.whitened)

    @property
    def slow(self) -> float:
        """The sum of the first autocorrelations of the whitened residuals in standard deviations of white ones.

        A cause that lasts for several windows shows in it before it shows between neighbours. The fit makes it
        negative, −1 to −5 on clean logs. The value is the larger of those in the sensor's and in the world's axes.
        """
        return max(_sum_of_correlations(residual) for residual in self.whitened)


def inverse_information(information: Array, free: np.ndarray, least: float = 1e-15) -> Array:
    """Return the covariance (p, p) of parameters in any units; zeros for fixed ones, very large where undetermined.

    Args:
        information: (p, p).
        free: (p,) bool.
        least: share of each parameter's information below which a direction counts as having that share.
    """
    if not free.all():
        result, kept = np.zeros(information.shape), np.ix_(free, free)
        own = information[kept]
        result[kept] = inverse_information(own, np.ones(len(own), dtype=bool), least)
        return result
    scale = 1 / np.sqrt(np.maximum(information.diagonal(), 1e-300))
    with np.errstate(over="ignore", invalid="ignore"):  # not finite: has no eigenvalues below
        scaled = information * scale * scale[:, None]
    root = inverse_root(scaled)
    # No eigenvalue is less than the reciprocal of the inverse's trace, so that here none is below the bound.
    if root is not None and np.vdot(root, root) * max(least, _ROUNDED) < 1:
        covariance: Array = root.T @ root * scale * scale[:, None]
        return covariance
    value, vector = eigenvectors(scaled)
    with np.errstate(over="ignore"):  # no residual depends on a parameter: its variance is infinite
        covariance = (vector / np.maximum(value, least)) @ vector.T * scale * scale[:, None]
    return covariance


def colour_of(residual: Array) -> float:
    """Return 1 + 2 Σ ρ_k of whitened residuals (3, n), summed up to the first lag without significant correlation."""
    total = float(np.vdot(residual, residual))
    factor = 1.0
    for lag in range(1, residual.shape[1] // 4):
        correlation = float(np.vdot(residual[:, lag:], residual[:, :-lag])) / max(total, 1e-300)
        if correlation < COLOURED / np.sqrt(residual.size):
            break
        factor += 2 * correlation
    return factor


def _sum_of_correlations(residual: Array) -> float:
    lags = min(_SLOW_LAGS, residual.shape[1] - 1)
    apart = np.zeros((len(residual), residual.shape[1] + lags))  # zeros keep the rows apart
    apart[:, : residual.shape[1]] = residual
    flat = apart.ravel()
    square, *products = np.correlate(flat, flat[:-lags]).tolist()
    return sum(products) / max(square * sqrt(lags / residual.size), 1e-300)


def begin(chain: FieldChain, parameters: Array, free: np.ndarray, patience: int = PATIENCE) -> Fit:
    """Return the chain linearised at the given parameters, with unit weights."""
    state, weights = chain.start(parameters), chain.unweighted()
    return Fit(chain, state, weights, chain.eliminate(state, weights), free, patience=patience)


def descend(fit: Fit, settled: float = SETTLED) -> Fit:
    """Minimise over θ by Levenberg–Marquardt, with the directions eliminated, until less than `settled` is left."""
    damping, spent, before = 0.0, 0, fit.last_steps
    state, reduced = fit.state, fit.reduced
    converged = False
    while spent < MAX_ITERATIONS and damping < 1e8:
        step, length = _step(reduced, fit.free, damping)
        trial = fit.chain.move(state, reduced, step)
        ahead_of_directions = float(reduced.half[:, -1] @ reduced.half[:, -1])
        near = min(length, _left_after(length, before)) < settled
        if near and damping == 0.0 and ahead_of_directions < _UNSETTLED * trial.direction.shape[1]:
            # What is left needs no check and no new linearisation; the gain of the step is known.
            reduced = reduced._replace(cost=reduced.cost - 0.5 * (length + ahead_of_directions))
            state, converged, before = trial, True, (before[1], length)
            break
        try:
            ahead = fit.chain.eliminate(trial, fit.weights)
        except MagycError:  # a direction has no curvature there: the step was too long
            ahead = reduced._replace(cost=np.inf)
        spent += 1
        if ahead.cost <= reduced.cost * (1 + 1e-10) + _ROUNDING and np.isfinite(ahead.cost):
            state, reduced, before = trial, ahead, (before[1], length if damping == 0.0 else 0.0)
            damping = damping / 10 if damping > 1e-6 else 0.0
        else:
            damping = max(10 * damping, 1e-3)
    iterations = fit.iterations + spent
    return replace(
        fit, state=state, reduced=reduced, iterations=iterations, converged=converged, last_steps=before
    )


def _left_after(length: float, before: tuple[float, float]) -> float:
    """Return the squared distance left after a step, if the next ones shrink as the slower of the last two did.

    It is the sum of a geometric series, √l ρ/(1 − ρ), with ρ² the ratio of squared lengths; infinite if not known.
    """
    ratio = max(length / before[1], before[1] / before[0] if before[0] else 0.0) if before[1] else 1.0
    return length * ratio / (1 - np.sqrt(ratio)) ** 2 if ratio < 1 else np.inf


def _step(reduced: Reduced, free: np.ndarray, damping: float = 0.0) -> tuple[Array, float]:
    """Return the damped Gauss–Newton step on θ (p,) and its squared length in sigmas.

    The step is zero for parameters that no residual depends on.
    """
    every = bool(free.all())
    information = reduced.information if every else reduced.information[np.ix_(free, free)]
    gradient = reduced.gradient if every else reduced.gradient[free]
    known = information.diagonal()
    scale = np.power(known, -0.5, out=np.zeros(len(known)), where=known > 0)
    scaled = information * scale * scale[:, None]
    scaled.flat[:: len(scale) + 1] += damping + 1e-14
    short = -scale * solved(scaled, scale * gradient)
    length = float(short @ information @ short)
    if every:
        return short, length
    step = np.zeros(len(free))
    step[free] = short
    return step, length
