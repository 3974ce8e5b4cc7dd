"""Fitting a field chain: damped Gauss–Newton on θ, robust weights, noise levels by variance components."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg.lapack import dtbtrs

from magyc_gtsam.factors.chain.chain_values import ChainState, Reduced, Residuals, SensorNoise, Weights
from magyc_gtsam.factors.chain.facts import quadratic
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError

if TYPE_CHECKING:
    from magyc_gtsam.estimators.smoother.beside import ColumnProducts
    from magyc_gtsam.estimators.smoother.columns import EstimatedTerms
    from magyc_gtsam.estimators.smoother.skew import Skew

MAX_ITERATIONS = 40
# Eliminations for a start without a minimum. Of 29 real logs those that are trusted took 8 to 62, of 540 simulated ones
# with a fault 6 in the median, 78 at the 99 % point and 176 at most. The second half of an online run during which a
# magnet was attached by hand took more than 250: with so few the removal of the magnet was not found.
PATIENCE = 300
# The same for a question beside the calibration, which a fit without end does not answer, and for a start beside the
# first: those of the same logs that led to another calibration took 12 to 53.
BRIEF = 120
ROUNDS = 20  # of robust weights and noise levels
_SETTLED = 5e-3  # squared length of the last step in sigmas, of which at most a fiftieth was seen to be left
NEAR = 4.0  # the same between rounds of noise and weights: two sigmas
_WINDOW_OUTLIER = 16.27  # χ² of 3 degrees of freedom at 99.9 %
_LINK_OUTLIER = 13.82  # χ² of 2 degrees of freedom at 99.9 %
_NOISE_STABLE = 10.0  # squared length of the last step of the noise levels in their own sigmas, likewise
_GYROSCOPE_RANGE = 3.0
_MAGNETOMETER_FLOOR = 3.0
_UNSETTLED = 0.1  # gain per window, in squared sigmas, from which the directions are linearised again
_ROUNDING = 1e-9  # of a cost, where noise-free data leave next to none
_COLOURED = 3.0  # standard deviations of an autocorrelation from which it counts
_WEIGHTS_STABLE = 1e-3  # mean change of a robust weight


@dataclass(frozen=True, eq=False)
class Fit:
    """A chain at its minimum.

    Attributes:
        chain, state, weights, reduced: the minimum and its linearisation.
        free: (p,) bool, parameters that were estimated.
        iterations: eliminations spent.
        converged: the last steps of the parameters and of the noise levels were small against their sigmas.
        noise_freedom: degrees of freedom from which the gyroscope's noise was estimated; infinite where it is known.
        skew: what the data say of a skew between the chips; None where it was not asked.
        terms: parameters beyond θ, estimated with it; None where there are none.
        patience: eliminations after which a start that has found no minimum is given up.
    """

    chain: FieldChain
    state: ChainState
    weights: Weights
    reduced: Reduced
    free: np.ndarray
    iterations: int = 0
    converged: bool = False
    noise_freedom: float = np.inf
    skew: Skew | None = None
    terms: EstimatedTerms | None = None
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
        from magyc_gtsam.estimators.smoother.beside import ColumnProducts  # which is of fits

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

    @cached_property
    def residuals(self) -> Residuals:
        """Of windows and links."""
        return self.chain.residuals(self.state)

    @cached_property
    def whitened(self) -> tuple[Array, Array]:
        """(3, n) twice: the windows' residuals over their sigmas, in the sensor's and in the world's axes."""
        whitened = self.residuals.window * np.sqrt(self.weights.window) / self.chain.window_sigma
        return whitened, np.einsum("ijn,in->jn", self.chain.windows.rotation, whitened)


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


def descend(fit: Fit, settled: float = _SETTLED) -> Fit:
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


def weigh(chain: FieldChain, parameters: Array, rounds: int = 10) -> Fit:
    """Directions and robust weights at given θ and noise."""
    state, weights = chain.start(parameters), chain.unweighted()
    before = weights
    for _ in range(rounds):
        state, before = chain.settled(state, weights), weights
        weights = _reweigh(chain, chain.residuals(state))
        moved = np.abs(weights.window - before.window).mean() + np.abs(weights.link - before.link).mean()
        if moved < _WEIGHTS_STABLE:
            break
    held = np.zeros(len(parameters), dtype=bool)
    return Fit(chain, state, weights, chain.eliminate(state, before), held)


def misfit(fit: Fit, noise: SensorNoise) -> float:
    """Sum of squares at `noise`, each window and link counting up to its rejection threshold."""
    chain = replace(fit.chain, noise=noise)
    window, link = chain.squares(fit.residuals)
    return float(np.minimum(window, _WINDOW_OUTLIER).sum() + np.minimum(link, _LINK_OUTLIER).sum())


def adapt(fit: Fit, reject: bool, short_term: SensorNoise | None, rounds: int = ROUNDS) -> Fit:
    """Alternate robust weights, noise levels and descent until all three stand still.

    Args:
        fit: near the minimum.
        reject: weigh down windows and links beyond the 99.9 % point of their χ².
        short_term: the sensors' short-term noise, about which the noise levels are estimated (see
            `improved_noise`); None keeps the noise as it is.
    """
    for _ in range(rounds):
        weights = _reweigh(fit.chain, fit.residuals) if reject else fit.weights
        moved = float(
            np.abs(weights.window - fit.weights.window).sum() + np.abs(weights.link - fit.weights.link).sum()
        )
        fit = replace(fit, weights=weights)
        noise, gain, freedom = fit.chain.noise, 0.0, fit.noise_freedom
        if short_term is not None:
            noise, gain, freedom = improved_noise(fit, short_term)
        stable = gain < _NOISE_STABLE and moved < _WEIGHTS_STABLE * len(weights.window)
        chain = replace(fit.chain, noise=noise)
        reduced = chain.eliminate(fit.state, weights)
        fit = replace(fit, chain=chain, reduced=reduced, iterations=fit.iterations + 1, noise_freedom=freedom)
        # The noise levels' gradient holds at a minimum only, so descend in every round.
        fit = descend(fit, _SETTLED if stable else NEAR)
        if stable or not fit.converged:
            return fit
    return replace(fit, converged=False)


def _reweigh(chain: FieldChain, residuals: Residuals) -> Weights:
    """Weights min(1, (c²/χ²)²): one for all that the noise explains, then redescending."""
    window, link = chain.squares(residuals)
    return Weights(
        np.minimum(1.0, (_WINDOW_OUTLIER / np.maximum(window, 1e-100)) ** 2),
        np.minimum(1.0, (_LINK_OUTLIER / np.maximum(link, 1e-100)) ** 2),
    )


def improved_noise(fit: Fit, short_term: SensorNoise) -> tuple[SensorNoise, float, float]:
    """One average-information step on the restricted likelihood of the two noise levels.

    Gilmour, Thompson and Cullis (1995). With Q the weighted squares of a group and D its redundancy
    (residuals less the trace of its block of the hat matrix; the two traces add up to the number of
    unknowns, so that only the windows' is computed), the gradient in log σ² is Q − D, and the average
    information [[Q₁ − c, c], [c, Q₂ − c]] needs one more solve: c = gᵀ K⁻¹ g, g being the gradient of one
    group (at the minimum the other's is −g) and K the full normal matrix.

    The gyroscope's noise stays within a factor `_GYROSCOPE_RANGE` of its short-term noise, the
    magnetometer's above a third of its own: where the field itself varies (indoors, over a wreck), the
    likelihood would else call the gyroscope bad and the magnetometer perfect, and the bias would wander.

    Returns:
        The noise, the step's squared length in its own sigmas, and the links' redundancy D.
    """
    chain, weights, reduced = fit.chain, fit.weights, fit.reduced
    residuals = fit.residuals
    window, link = chain.squares(residuals)
    covariance = fit.covariance
    absorbed = chain.absorbed(reduced, covariance)
    unknowns = float(2 * len(chain.windows) + fit.free.sum())
    if chain.facts:  # what is known beforehand takes nothing from the data
        unknowns -= float(np.sum(covariance * quadratic(chain.facts, fit.state.parameters)[2]))
    squares = np.array([weights.window @ window, weights.link @ link])
    redundancy = np.array(
        [
            3 * weights.window.sum() - absorbed,
            2 * weights.link[chain.windows.linked].sum() - (unknowns - absorbed),
        ]
    )
    shared = explained(fit, residuals.window / chain.window_sigma * np.sqrt(weights.window), covariance)
    information = np.array([[squares[0] - shared, shared], [shared, squares[1] - shared]])
    gradient = squares - redundancy
    level = np.array(chain.noise)
    low = np.array(short_term) / np.array([_MAGNETOMETER_FLOOR, _GYROSCOPE_RANGE])
    high = np.array([np.inf, short_term.gyroscope * _GYROSCOPE_RANGE])
    # A group with less than one degree of freedom of information, or at its bound, keeps the noise it has.
    kept = (np.diag(information) > 1.0) & ~((level <= low) & (gradient < 0)) & ~((level >= high) & (gradient > 0))
    if not kept.any():
        return chain.noise, 0.0, float(redundancy[1])
    step = np.zeros(2)
    step[kept] = np.linalg.solve(information[np.ix_(kept, kept)], gradient[kept])
    better = np.clip(level * np.exp(0.5 * np.clip(step, -2.0, 2.0)), low, high)
    gain = float(np.abs(2 * np.log(better / level) * gradient)[kept].sum())
    return SensorNoise(*better.tolist()), gain, float(redundancy[1])


def explained(fit: Fit, whitened: Array, covariance: Array) -> float:
    """How much of the square of `whitened` (3, n) on the windows directions and θ can explain.

    gᵀ K⁻¹ g for the gradient g that it leaves in them, by the elimination at hand.
    """
    reduced = fit.reduced
    on_direction = np.einsum("ian,in->an", reduced.on_direction, whitened)
    on_parameters = reduced.on_parameters.reshape(len(covariance), -1) @ whitened.ravel()
    half, _ = dtbtrs(reduced.factor, on_direction.T.ravel(), uplo="L")
    left = on_parameters - half @ reduced.half[:, :-1]
    return float(half @ half + left @ covariance @ left)
