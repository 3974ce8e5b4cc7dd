"""Robust weights and noise levels of a field chain; the noise levels by variance components."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.estimators.smoother.fit import NEAR, SETTLED, Fit, descend
from magyc_gtsam.factors.chain.banded import forward_solved
from magyc_gtsam.factors.chain.chain_values import Residuals, SensorNoise, Weights
from magyc_gtsam.factors.chain.facts import quadratic
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.small import solved

_ROUNDS = 20  # most updates of robust weights and noise levels
_WINDOW_OUTLIER = 16.27  # χ² of 3 degrees of freedom at 99.9 %
_LINK_OUTLIER = 13.82  # χ² of 2 degrees of freedom at 99.9 %
_NOISE_STABLE = 0.4  # sigmas of a noise level that the last update may leave
_GYROSCOPE_RANGE = 3.0  # largest factor between the gyroscope's noise and its short-term noise
# Standard deviation of log σ² of the gyroscope below its short-term noise. Over windows its noise is larger (1.8 times
# or more in 26 of 26 real logs); only vibration, which averages out, makes it smaller.
_GYROSCOPE_BELOW = 0.5
_MAGNETOMETER_FLOOR = 3.0  # divides the magnetometer's short-term noise to give the least noise
_WEIGHTS_STABLE = 1e-3  # mean change of a robust weight


def weigh(chain: FieldChain, parameters: Array, rounds: int = 10) -> Fit:
    """Fit directions and robust weights at given θ and noise."""
    state, weights = chain.start(parameters), chain.unweighted()
    before = weights
    for _ in range(rounds):
        state, before = chain.settled(state, weights), weights
        weights = _reweigh(*chain.squares(chain.residuals(state)))
        moved = np.abs(weights.window - before.window).mean() + np.abs(weights.link - before.link).mean()
        if moved < _WEIGHTS_STABLE:
            break
    held = np.zeros(len(parameters), dtype=bool)
    return Fit(chain, state, weights, chain.eliminate(state, before), held)


def misfit(fit: Fit, noise: SensorNoise) -> float:
    """Return the sum of squares at `noise`, with each window and link truncated at its rejection threshold."""
    window, link = truncated(replace(fit.chain, noise=noise), fit.residuals)
    return float(window.sum() + link.sum())


def truncated(chain: FieldChain, residuals: Residuals) -> tuple[Array, Array]:
    """Return the squares of windows (n,) and links (n − 1,), each truncated at its rejection threshold."""
    window, link = chain.squares(residuals)
    return np.minimum(window, _WINDOW_OUTLIER), np.minimum(link, _LINK_OUTLIER)


def adapt(fit: Fit, reject: bool, short_term: SensorNoise | None) -> Fit:
    """Alternate updates of robust weights and noise levels with the descent until all three converge.

    Args:
        fit: near the minimum.
        reject: whether to down-weight windows and links beyond the 99.9 % point of their χ².
        short_term: the sensors' short-term noise, which bounds the estimated noise levels (see `improved_noise`); None
            keeps the noise levels.
    """
    for _ in range(_ROUNDS):
        residuals = fit.residuals
        squares = fit.chain.squares(residuals)
        weights = _reweigh(*squares) if reject else fit.weights
        moved = float(
            np.abs(weights.window - fit.weights.window).sum() + np.abs(weights.link - fit.weights.link).sum()
        )
        fit = replace(fit, weights=weights) if moved else fit
        noise, left, freedom = fit.chain.noise, 0.0, fit.noise_freedom
        if short_term is not None:
            noise, left, freedom = improved_noise(fit, residuals.window, squares, short_term)
        stable = left < _NOISE_STABLE and moved < _WEIGHTS_STABLE * len(weights.window)
        chain = replace(fit.chain, noise=noise)
        reduced = chain.eliminate(fit.state, weights)
        # Steps at other noise levels and weights do not tell how far the next ones go: where a direction is hardly
        # determined, one of 0.04 was followed by one of 0.36.
        steps, spent = (0.0, 0.0), fit.iterations + 1
        fit = replace(fit, chain=chain, reduced=reduced, iterations=spent, noise_freedom=freedom, last_steps=steps)
        # The gradient of the noise levels is valid at a minimum only, so descend in every round.
        fit = descend(fit, SETTLED if stable else NEAR)
        if stable or not fit.converged:
            return fit
    return replace(fit, converged=False)


def _reweigh(window: Array, link: Array) -> Weights:
    """Return the redescending weights min(1, (c²/χ²)²) by squares χ², which are one below the threshold c²."""
    return Weights(
        np.minimum(1.0, (_WINDOW_OUTLIER / np.maximum(window, 1e-100)) ** 2),
        np.minimum(1.0, (_LINK_OUTLIER / np.maximum(link, 1e-100)) ** 2),
    )


def improved_noise(
    fit: Fit, residual: Array, squares: tuple[Array, Array], short_term: SensorNoise
) -> tuple[SensorNoise, float, float]:
    """Take one average-information step on the restricted likelihood of the two noise levels.

    Gilmour, Thompson and Cullis (1995). With Q the weighted squares of a group and D its redundancy
    (residuals less the trace of its block of the hat matrix; the two traces add up to the number of
    unknowns, so that only the windows' is computed), the gradient in log σ² is Q − D, and the average
    information [[Q₁ − c, c], [c, Q₂ − c]] needs one more solve: c = gᵀ K⁻¹ g, with g the gradient of one
    group (at the minimum the other's is −g) and K the full normal matrix. `residual` is that of the fit's windows, and
    `squares` those of windows and links; they do not depend on its weights, and are shared with the update of these.

    Where the magnetometer's noise hides that of the gyroscope, the likelihood's maximum may lie at a third of the true
    noise, and the bias' sigma with it; a level below the short-term noise therefore has a prior, `_GYROSCOPE_BELOW`.
    The gyroscope's noise stays within a factor `_GYROSCOPE_RANGE` of its short-term noise, and the magnetometer's above
    a third of its own. Otherwise, in a field that varies (indoors, over a wreck), the likelihood would attribute all
    misfit to the gyroscope and none to the magnetometer, and the bias would drift.

    Returns:
        The noise, what the step leaves of a level in its sigmas, and the links' redundancy D with that of the prior.
        A step of Newton's method leaves half its square in log σ², whose variance is 2 over its information.
    """
    chain, covariance = fit.chain, fit.covariance
    if not np.isfinite(covariance).all():  # no residual depends on a parameter: the redundancies are undefined
        return chain.noise, 0.0, fit.noise_freedom
    weighted, redundancy = squares_and_redundancies(fit, squares)
    shared = explained(fit, residual * (chain.window_scale * np.sqrt(fit.weights.window)), covariance)
    information = np.array([[weighted[0] - shared, shared], [shared, weighted[1] - shared]])
    gradient = weighted - redundancy
    level = np.array(chain.noise)
    freedom = float(redundancy[1])
    below = 2 * np.log(level[1] / short_term.gyroscope)
    if below < 0 or (below == 0 and gradient[1] < 0):
        gradient[1] -= 2 * below / _GYROSCOPE_BELOW**2
        information[1, 1] += 2 / _GYROSCOPE_BELOW**2
        freedom += 2 / _GYROSCOPE_BELOW**2
    low = np.array(short_term) / np.array([_MAGNETOMETER_FLOOR, _GYROSCOPE_RANGE])
    high = np.array([np.inf, short_term.gyroscope * _GYROSCOPE_RANGE])
    # A group with less than one degree of freedom of information, or at its bound, keeps its noise level.
    kept = (np.diag(information) > 1.0) & ~((level <= low) & (gradient < 0)) & ~((level >= high) & (gradient > 0))
    if not kept.any():
        return chain.noise, 0.0, freedom
    step = np.zeros(2)
    known = information if kept.all() else information[np.ix_(kept, kept)]
    step[kept] = solved(known, gradient[kept])
    better = np.minimum(np.maximum(level * np.exp(np.minimum(np.maximum(0.5 * step, -1.0), 1.0)), low), high)
    left = 2 * np.log(better / level)[kept] ** 2 * np.sqrt(0.5 * information.diagonal()[kept])
    return SensorNoise(*better.tolist()), float(left.max()), freedom


def scatter(fit: Fit) -> SensorNoise:
    """Return the noise levels that the residuals show, which are those of the fit unless these were given."""
    squares, redundancy = squares_and_redundancies(fit, fit.chain.squares(fit.residuals))
    shown = np.array(fit.chain.noise) * np.sqrt(squares / np.maximum(redundancy, 1.0))
    return SensorNoise(*shown.tolist())


def squares_and_redundancies(fit: Fit, squares: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the weighted sums Q (2,) of the squares of windows and links, and their redundancies D (2,)."""
    chain, weights, (window, link) = fit.chain, fit.weights, squares
    absorbed = fit.reduced.absorbed(fit.covariance)
    unknowns = float(2 * len(chain.windows) + fit.free.sum())
    if chain.facts:  # prior knowledge uses up no redundancy of the data
        unknowns -= float(np.sum(fit.covariance * quadratic(chain.facts, fit.state.parameters)[2]))
    links = 2 * weights.link @ chain.windows.linked
    return (
        np.array([weights.window @ window, weights.link @ link]),
        np.array([3 * weights.window.sum() - absorbed, links - (unknowns - absorbed)]),
    )


def explained(fit: Fit, whitened: Array, covariance: Array) -> float:
    """Return the part of the squared norm of `whitened` (3, n) on the windows that directions and θ can explain.

    It is gᵀ K⁻¹ g, with g the gradient with respect to directions and θ, computed with the existing elimination.
    """
    reduced = fit.reduced
    on_direction = np.einsum("ian,in->an", reduced.on_direction, whitened)
    on_parameters = reduced.on_parameters.reshape(len(covariance), -1) @ whitened.ravel()
    half = forward_solved(reduced.band_factor, on_direction[None])[0]
    left = on_parameters - half @ reduced.half[:, :-1]
    return float(half @ half + left @ covariance @ left)
