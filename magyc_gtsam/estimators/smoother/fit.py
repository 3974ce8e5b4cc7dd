"""The descent of a field chain to its minimum: damped Gauss–Newton on θ."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.estimators.smoother.beside import ColumnProducts
from magyc_gtsam.estimators.smoother.minimum import Minimum
from magyc_gtsam.estimators.smoother.skew_found import Skew
from magyc_gtsam.factors.chain.chain_values import Reduced
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError

MAX_ITERATIONS = 40
# Eliminations for a start without a minimum. Of 29 real logs those that are trusted took 8 to 62, of 540 simulated ones
# with a fault 6 in the median, 78 at the 99 % point and 176 at most. The second half of an online run during which a
# magnet was attached by hand took more than 250: with so few the removal of the magnet was not found.
PATIENCE = 300
# The same for a question beside the calibration, which a fit without end does not answer, and for a start beside the
# first: those of the same logs that led to another calibration took 12 to 53.
BRIEF = 120
SETTLED = 5e-3  # squared length of the last step in sigmas, of which at most a fiftieth was seen to be left
NEAR = 4.0  # the same between rounds of noise and weights: two sigmas
_UNSETTLED = 0.1  # gain per window, in squared sigmas, from which the directions are linearised again
_ROUNDING = 1e-9  # of a cost, where noise-free data leave next to none
_COLOURED = 3.0  # standard deviations of an autocorrelation from which it counts


@dataclass(frozen=True, eq=False)
class Fit(Minimum):
    """A minimum, and how it was found.

    Attributes:
        iterations: eliminations spent.
        converged: the last steps of the parameters and of the noise levels were small against their sigmas.
        noise_freedom: degrees of freedom from which the gyroscope's noise was estimated; infinite where it is known.
        skew: what the data say of a skew between the chips; None where it was not asked.
        patience: eliminations after which a start that has found no minimum is given up.
    """

    iterations: int = 0
    converged: bool = False
    noise_freedom: float = np.inf
    skew: Skew | None = None
    patience: int = PATIENCE

    @property
    def hopeless(self) -> bool:
        """Whether the start is given up."""
        return not self.converged and self.iterations > self.patience

    def saying(self, skew: Skew) -> Fit:
        """The same with what the data say of a skew, and with all that was computed of it."""
        result = copy.copy(self)
        object.__setattr__(result, "skew", skew)
        return result

    @cached_property
    def beside(self) -> ColumnProducts:
        """The products of columns with this fit, at its minimum."""
        return ColumnProducts(copy.copy(self))  # a circle would keep both until Python looks for circles

    @cached_property
    def covariance(self) -> Array:
        """(p, p) inverse information; zeros for fixed parameters, infinite where it is singular."""
        return inverse_information(self.reduced.information, self.free)

    @property
    def widening(self) -> float:
        """1 + 2/ν: by how much an estimated noise level leaves the covariance too small on average.

        A variance σ² estimated from ν degrees of freedom has E[1/σ̂²] = (1 + 2/ν)/σ² to first order, which is why
        Student's t is wider than a normal distribution. ν is the links' redundancy, from which the gyroscope's
        noise is learnt; the windows leave many times as much for the magnetometer's.
        """
        return 1 + 2 / max(self.noise_freedom, 1.0)

    @cached_property
    def colour(self) -> float:
        """1 + 2 Σ ρ_k: by how much neighbouring windows repeat each other's misfit; 1 for white residuals.

        A field that varies over the room or a filtered magnetometer leaves residuals that hang together,
        so that the windows count for fewer than they are; taken in the sensor's and in the world's axes.
        """
        return max(colour_of(residual) for residual in self.whitened)


def inverse_information(information: Array, free: np.ndarray) -> Array:
    """(p, p) covariance; zeros for fixed parameters, infinite where the information is singular."""
    result = np.zeros(information.shape)
    kept = np.ix_(free, free)
    information = information[kept]
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    value, vector = np.linalg.eigh(information * scale * scale[:, None])
    value = np.maximum(value, 1e-15)
    result[kept] = (vector / value) @ vector.T * scale * scale[:, None]
    return result


def colour_of(residual: Array) -> float:
    """1 + 2 Σ ρ_k of whitened residuals (3, n), up to the first lag at which they do not hang together."""
    total = float(np.vdot(residual, residual))
    factor = 1.0
    for lag in range(1, residual.shape[1] // 4):
        correlation = float(np.vdot(residual[:, lag:], residual[:, :-lag])) / max(total, 1e-300)
        if correlation < _COLOURED / np.sqrt(residual.size):
            break
        factor += 2 * correlation
    return factor


def begin(chain: FieldChain, parameters: Array, free: np.ndarray, patience: int = PATIENCE) -> Fit:
    """The chain linearised at a start."""
    state, weights = chain.start(parameters), chain.unweighted()
    return Fit(chain, state, weights, chain.eliminate(state, weights), free, patience=patience)


def descend(fit: Fit, settled: float = SETTLED) -> Fit:
    """Levenberg–Marquardt on θ (the directions follow exactly) until a step is below `settled`."""
    damping, spent = 0.0, 0
    state, reduced = fit.state, fit.reduced
    converged = False
    while spent < MAX_ITERATIONS and damping < 1e8:
        step, length = _step(reduced, fit.free, damping)
        trial = fit.chain.move(state, reduced, step)
        ahead_of_directions = float(reduced.half[:, -1] @ reduced.half[:, -1])
        if length < settled and damping == 0.0 and ahead_of_directions < _UNSETTLED * trial.direction.shape[1]:
            # Too short to be checked, or to need a new linearisation; its gain is known.
            reduced = reduced._replace(cost=reduced.cost - 0.5 * (length + ahead_of_directions))
            state, converged = trial, True
            break
        try:
            ahead = fit.chain.eliminate(trial, fit.weights)
        except MagycError:  # so far off that a direction has no curvature: the step was too long
            ahead = reduced._replace(cost=np.inf)
        spent += 1
        if ahead.cost <= reduced.cost * (1 + 1e-10) + _ROUNDING and np.isfinite(ahead.cost):
            state, reduced = trial, ahead
            damping = damping / 10 if damping > 1e-6 else 0.0
        else:
            damping = max(10 * damping, 1e-3)
    iterations = fit.iterations + spent
    return replace(fit, state=state, reduced=reduced, iterations=iterations, converged=converged)


def _step(reduced: Reduced, free: np.ndarray, damping: float = 0.0) -> tuple[Array, float]:
    """The damped Gauss–Newton step on θ (p,), and its squared length in sigmas; what nothing depends on stays."""
    every = bool(free.all())
    information = reduced.information if every else reduced.information[np.ix_(free, free)]
    gradient = reduced.gradient if every else reduced.gradient[free]
    known = information.diagonal()
    scale = np.divide(1.0, np.sqrt(np.maximum(known, 0.0)), out=np.zeros(len(known)), where=known > 0)
    scaled = information * scale * scale[:, None]
    scaled.flat[:: len(scale) + 1] += damping + 1e-14
    short = -scale * np.linalg.solve(scaled, scale * gradient)
    length = float(short @ information @ short)
    if every:
        return short, length
    step = np.zeros(len(free))
    step[free] = short
    return step, length
