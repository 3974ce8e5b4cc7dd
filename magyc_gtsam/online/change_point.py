"""Detection of steps in hard iron by a generalised likelihood ratio over all possible times of a step.

The step Δ (3) is the hard iron of all windows from n on minus that before. Added as a parameter at the best fit
without a step, it would lower the cost by λ(n)/2, with λ(n) = gᵀ S⁻¹ g, where g and S are the gradient and information
of Δ after θ and all directions are eliminated (Willsky and Jones 1976, here on a smoother instead of a filter). All n
share one factorisation. Without a step λ is χ² with 3 degrees of freedom.

If the field itself changes with the place, an offset that is fixed in the world explains the windows better than one
that is fixed in the sensor, and if the magnetometer was turned against the gyroscope, a rotation does. Only rotation
distinguishes them; until the sensor has turned, a change counts as a step only if it is larger than changes of the
field between places.

A disturbed stretch also gives a large λ. A candidate is therefore fitted: the step is subtracted from the windows, all
windows are fitted, and the step is estimated again at that fit. The robust cost, which counts a disturbed window no
more than a rejected one, must fall by the same limit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dtbtrs

from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, begin, descend
from magyc_gtsam.estimators.smoother.marginal import ContinuedChain, fitted
from magyc_gtsam.estimators.smoother.noise_levels import misfit
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, ChainState, Reduced, SensorNoise, Weights
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech

LIMIT = 40.0  # smallest λ of a step; benchmarks/online.py counts the false alarms
MARGIN = 20.0  # lead in λ from which a step is fixed in the sensor rather than the world
ALIKE = (
    5.0  # lead of the world in λ up to which a step still counts as fixed in the sensor, after a turn by `TURNED`
)
TURNED = 2.5  # rad, rotation since the step
NO_PLACE = 0.5  # share of the field strength; a larger change is not one of the field with the place
SMALLEST = 1.5e-6  # T, smallest step worth a restart; the field within a room varies by as much
_BEFORE, _AFTER = 3, 5  # fewest windows before and after a step
_AFTER_TIMED = 3  # the same where a step that was found is timed
_FINEST = 24  # parts into which a window is divided
_UNLIKELY = 20.0  # distance of λ from its maximum from which a window is not divided
LARGE = 0.1  # share of the field strength from which the effect of a step is far from linear
_CORRECTIONS = 6  # largest number of times a large step is subtracted and estimated again until it converges
# Factors of the noise in the robust weights, pass by pass.
_NOISE_FACTORS, _NOISE_FACTORS_LARGE = (1.0, 1.0, 1.0), (5.0, 1.0)
_CONVERGED = 1.0  # squared change of a step's estimate, in its covariance, below which it has converged


class StepSearch(NamedTuple):
    """The step found; or whether a possible step needs more windows for a decision, and whether it is large."""

    step: Step | None
    undecided: bool = False
    large: bool = False


def find_step(fit: Fit, colour: float = 1.0, smallest: float = SMALLEST) -> StepSearch:
    """Look for a step inside the chain of a fit.

    Args:
        fit: a `ContinuedChain` with a past, at its minimum without a step.
        colour: correlation factor of the residuals, by which λ is reduced.
        smallest: smallest step that counts, T.
    """
    chain, state = fit.chain, fit.state
    assert isinstance(chain, ContinuedChain)
    limit = LIMIT * colour
    weights = chain.unweighted()
    reduced = chain.eliminate(state, weights)
    profile = step_profile(chain, state, weights, reduced, in_sensor(len(chain.windows)))
    ratio, step, _ = profile.at_windows()
    ratio = ratio[: len(chain.windows) - _AFTER + 1]
    ratio[:_BEFORE] = 0.0
    n = int(np.argmax(ratio))
    if ratio[n] < limit:
        return StepSearch(None)
    if np.linalg.norm(step[n]) < smallest:
        return StepSearch(None, undecided=True)
    rival = max(
        step_profile(chain, state, weights, reduced, column).at_windows()[0][_BEFORE : len(ratio)].max()
        for column in (chain.seen(state.parameters), chain.turned(state))
    )
    strength = np.cbrt(abs(np.linalg.det(unvech(state.parameters[:6]))))
    undecided = StepSearch(None, True, bool(np.linalg.norm(step[n]) > LARGE * strength))
    lead = (ratio[n] - rival) / colour
    in_sensor_frame = lead > MARGIN or (lead > -ALIKE and turned(chain.windows.rotation[:, :, n:]) > TURNED)
    if not in_sensor_frame and np.linalg.norm(step[n]) < NO_PLACE * strength:
        return undecided
    found, corrected = _corrected(fit, _timed(chain, profile, colour), colour, strength)
    if _cost(fit) - _cost(corrected) < limit or np.linalg.norm(found.value) < smallest:
        return undecided
    return StepSearch(found)


def _corrected(fit: Fit, found: Step, colour: float, strength: float) -> tuple[Step, Fit]:
    """Subtract a step, fit all windows, and estimate its time and size again at that fit.

    The first estimate of a large step is off by up to a tenth of its size, and robust weights would reject the
    windows after it because of this remainder. All windows therefore have equal weight until the step has converged.
    The following passes apply robust weights, first at an increased noise level, which rejects the windows in which a
    hand moves the source of the step, and finally at the true one.
    """
    chain, parameters = fit.chain, fit.state.parameters
    assert isinstance(chain, ContinuedChain)
    large = bool(np.linalg.norm(found.value) > LARGE * strength)
    for _ in range(_CORRECTIONS if large else 0):
        before = found.value
        found = _estimated(chain, descend(begin(found.removed_from(chain), parameters, fit.free), NEAR), colour)
        away = found.value - before
        if away @ np.linalg.solve(found.covariance, away) < _CONVERGED:
            break
    for times in _NOISE_FACTORS_LARGE if large else _NOISE_FACTORS:
        noise = SensorNoise(times * chain.noise.magnetometer, times * chain.noise.gyroscope)
        corrected = fitted(found.removed_from(replace(chain, noise=noise)), parameters, fit.free)
        found = _estimated(chain, corrected, colour)
    return found, corrected


def _estimated(chain: ContinuedChain, corrected: Fit, colour: float) -> Step:
    """Return the time and size of a step in a chain, linearised at the fit without it."""
    state, weights = corrected.state, corrected.weights
    profile = step_profile(chain, state, weights, chain.eliminate(state, weights), in_sensor(len(chain.windows)))
    return _timed(chain, profile, colour)


def turned(rotation: Array) -> float:
    """Return the largest rotation, rad, of windows (3, 3, n) relative to the first."""
    trace = np.einsum("ij,ijn->n", rotation[:, :, 0], rotation)
    return float(np.arccos(np.clip(0.5 * (trace.min() - 1), -1, 1)))


def in_sensor(count: int) -> Array:
    """Return the column (3, 3, n) of a step that is fixed in the sensor."""
    return np.repeat(np.eye(3)[:, :, None], count, axis=2)


def _cost(fit: Fit) -> float:
    """Return twice the robust cost, including that of the past marginal."""
    assert isinstance(fit.chain, ContinuedChain)
    return misfit(fit, fit.chain.noise) + 2 * fit.chain.past_cost(fit.state)


@dataclass(frozen=True, eq=False)
class StepProfile:
    """The linearised problem with a step Δ in all windows from n on, for n from 0 to one beyond the last.

    Directions and θ are eliminated. A step inside window n is a share of that before n and the rest of that before
    n + 1, so that its linear terms are mixed by the share and its quadratic ones by products of shares.

    Attributes:
        own: (n + 1, 3, 3) information of Δ before elimination.
        lost: (n + 1, 3, 3) information that the elimination takes.
        between: (n, 3, 3) cross term of `lost` between a step before each window and one before the next window.
        gradient: (n + 1, 3) gradient of Δ after elimination.
    """

    own: Array
    lost: Array
    between: Array
    gradient: Array

    def at_windows(self) -> tuple[Array, Array, Array]:
        """Return λ (n,) of a step before each window, the step Δ (n, 3) and its covariance (n, 3, 3)."""
        return _solved(self.own[:-1] - self.lost[:-1], self.gradient[:-1])

    def inside(self, n: Array, share: Array) -> tuple[Array, Array, Array]:
        """Return λ, Δ and its covariance for k steps inside windows n (k,), each followed by `share` (k,) of its
        samples.
        """
        after, rest = share[:, None, None], 1 - share[:, None, None]
        both = self.between[n] + self.between[n].swapaxes(1, 2)
        own = self.own[n + 1] + after**2 * (self.own[n] - self.own[n + 1])
        lost = after**2 * self.lost[n] + after * rest * both + rest**2 * self.lost[n + 1]
        gradient = share[:, None] * self.gradient[n] + (1 - share[:, None]) * self.gradient[n + 1]
        return _solved(own - lost, gradient)


def _solved(information: Array, gradient: Array) -> tuple[Array, Array, Array]:
    value, vector = np.linalg.eigh(information)
    value = np.maximum(value, 1e-9 * value[:, -1:] + 1e-300)
    covariance = (vector / value[:, None]) @ vector.swapaxes(1, 2)
    step = -np.einsum("nij,nj->ni", covariance, gradient)
    return -np.einsum("ni,ni->n", step, gradient), step, covariance


def step_profile(
    chain: ContinuedChain, state: ChainState, weights: Weights, reduced: Reduced, column: Array
) -> StepProfile:
    """Return the profile of a linearised chain.

    Args:
        chain, state, weights, reduced: the chain's linearisation at `state`, which need not be a minimum.
        column: (3, 3, n) derivative of each window's field by Δ.
    """
    n = len(chain.windows)
    scale = chain.window_scale * np.sqrt(weights.window)
    column = column * scale
    residual = chain.residuals(state).window * scale
    # Border of Δ with the directions per window, times L⁻¹; a step before n applies to n and all windows after.
    border = np.zeros((n, 2, n, 3))
    every = np.arange(n)
    border[every, :, every] = np.einsum("kan,kin->nai", reduced.on_direction, column)
    border = np.cumsum(border[:, :, ::-1], axis=2)[:, :, ::-1]
    half, _ = dtbtrs(reduced.factor, border.reshape(2 * n, 3 * n), uplo="L")
    free = np.diag(reduced.information) > 0
    free[PARAMETERS:] = False  # the misalignment is held
    known = Fit(chain, state, weights, reduced, free).covariance
    # For a step before each window, and for none: Δ with the directions (n + 1, 3, 2n), times L⁻¹, and then Δ with θ.
    half = np.concatenate([half.reshape(2 * n, n, 3).transpose(1, 2, 0), np.zeros((1, 3, 2 * n))])
    cross = _from(np.einsum("pkn,kin->nip", reduced.on_parameters, column)) - half @ reduced.half[:, :-1]
    gradient = _from(np.einsum("kn,kin->ni", residual, column)) - half @ reduced.half[:, -1]
    eliminated = cross @ known
    return StepProfile(
        own=_from(np.einsum("kin,kjn->nij", column, column)),
        lost=half @ half.swapaxes(1, 2) + eliminated @ cross.swapaxes(1, 2),
        between=half[:-1] @ half[1:].swapaxes(1, 2) + eliminated[:-1] @ cross[1:].swapaxes(1, 2),
        gradient=gradient - eliminated @ reduced.gradient,
    )


@dataclass(frozen=True, eq=False)
class Step:
    """A step in hard iron inside a window of a chain.

    Attributes:
        window, share: most likely window of the step, and the share of its samples after the step.
        time, time_sigma: s, averaged over all likely times.
        value, covariance: (3,) T and (3, 3) of the step, averaged over all likely times.
    """

    window: int
    share: float
    time: float
    time_sigma: float
    value: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """The standard deviation (3,) T of the step."""
        return np.sqrt(np.diag(self.covariance))

    def removed_from(self, chain: ContinuedChain) -> ContinuedChain:
        """Return the chain with the step subtracted from its windows."""
        field = chain.windows.field.copy()
        field[:, self.window] -= self.share * self.value
        field[:, self.window + 1 :] -= self.value[:, None]
        return replace(chain, windows=replace(chain.windows, field=field))


def _timed(chain: ContinuedChain, profile: StepProfile, colour: float) -> Step:
    """Return the time of a step, to a part of a window, from all windows that can contain it."""
    windows, coarse = chain.windows, profile.at_windows()[0]
    possible = np.arange(_BEFORE, len(windows) - _AFTER_TIMED)
    at_edges = np.maximum(coarse[possible], coarse[possible + 1])
    likely_windows = possible[at_edges > at_edges.max() - _UNLIKELY * colour]
    parts = np.minimum(windows.count[likely_windows], _FINEST).astype(int)
    n, parts = np.repeat(likely_windows, parts), np.repeat(parts, parts)
    number = np.arange(len(n)) - np.searchsorted(n, n)  # number of the part inside its window
    share = 1 - (number + 0.5) / parts
    ratio, step, covariance = profile.inside(n, share)
    begin, end = _edge(windows.time, windows.count, n), _edge(windows.time, windows.count, n + 1)
    time, width = end - share * (end - begin), (end - begin) / parts
    likely = np.exp(0.5 * (ratio - ratio.max()) / colour) * width
    likely /= likely.sum()
    mean, value = float(likely @ time), likely @ step
    spread = float(likely @ ((time - mean) ** 2 + width**2 / 12))
    away = step - value
    best = int(np.argmax(likely))
    return Step(
        int(n[best]),
        float(share[best]),
        mean,
        float(np.sqrt(spread)),
        value,
        np.einsum("k,kij->ij", likely, colour * covariance + away[:, :, None] * away[:, None, :]),
    )


def _edge(time: Array, count: Array, n: Array) -> Array:
    """Return the times between windows n − 1 and n, whose samples are evenly spaced."""
    edge: Array = time[n - 1] + (time[n] - time[n - 1]) * count[n - 1] / (count[n - 1] + count[n])
    return edge


def _from(values: Array) -> Array:
    """Return the sums over the first axis from each index on, and a last sum of zero."""
    return np.concatenate([np.cumsum(values[::-1], axis=0)[::-1], np.zeros((1, *values.shape[1:]))])
