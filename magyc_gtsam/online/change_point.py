"""Detection of steps in hard iron by a generalised likelihood ratio over all possible times of a step.

The step Δ (3) is the hard iron of all windows from n on minus that before. Added as a parameter at the best fit
without a step, it would lower the cost by λ(n)/2, with λ(n) = gᵀ S⁻¹ g, where g and S are the gradient and information
of Δ after θ and all directions are eliminated (Willsky and Jones 1976, here on a smoother instead of a filter). All n
share one factorisation. Without a step λ is χ² with 3 degrees of freedom.

If the field itself changes with the place, an offset that is fixed in the world explains the windows better than one
that is fixed in the sensor. Only rotation distinguishes the two; until the sensor has turned, a change counts as a
step only if it is larger than changes of the field between places.

A disturbed stretch also gives a large λ. A candidate is therefore fitted: the step is subtracted from the windows, all
windows are fitted, and the step is estimated again at that fit. The robust cost, which counts a disturbed window no
more than a rejected one, must fall by the same limit.

The window that contains the step is left out of the fits before and after it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, begin, descend
from magyc_gtsam.estimators.smoother.noise_levels import adapt, misfit, weigh
from magyc_gtsam.factors.chain.chain_values import ChainState, SensorNoise, Weights
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.online.likelihood_ratio import ChangeTime, change_time, step_profile
from magyc_gtsam.online.marginal import HARD_IRON, ContinuedChain, Marginal

LIMIT = 40.0  # smallest λ of a step; benchmarks/online.py counts the false alarms
MARGIN = 20.0  # lead in λ from which a step is fixed in the sensor rather than the world
ALIKE = (
    5.0  # lead of the world in λ up to which a step still counts as fixed in the sensor, after a turn by `TURNED`
)
TURNED = 2.5  # rad, rotation since the step
NO_PLACE = 0.5  # share of the field strength; a larger change is not one of the field with the place
SMALLEST = 1.5e-6  # T, smallest step worth a restart; the field within a room varies by as much
_AFTER = 5  # fewest windows after a step
_BEFORE = 3  # fewest windows before a step
LARGE = 0.1  # share of the field strength from which the effect of a step is far from linear
_CORRECTIONS = 6  # largest number of times a large step is subtracted and estimated again until it converges
# Factors of the noise in the robust weights, pass by pass.
_NOISE_FACTORS, _NOISE_FACTORS_LARGE = (1.0, 1.0, 1.0), (5.0, 1.0)
_CONVERGED = 1.0  # squared change of a step's estimate, in its covariance, below which it has converged
_EMPTY_COUNT = 1e-6  # sample count given to a window whose field is left out


@dataclass(frozen=True, eq=False)
class Step:
    """A step in hard iron inside a window of a chain.

    Attributes:
        window: index of the first window after it; the window before contains it and is left out of all fits.
        time, time_sigma: s.
        value, sigma: (3,) T.
        before: fit of the windows before it.
        past: marginal of those windows without the hard iron, for a chain that begins at window − 1.
        after: fit of that chain.
    """

    window: int
    time: float
    time_sigma: float
    value: Array
    sigma: Array
    before: Fit
    past: Marginal
    after: Fit


class ChangeSearch(NamedTuple):
    """The step found; or whether a possible step needs more windows for a decision, and whether it is large."""

    step: Step | None
    undecided: bool = False
    large: bool = False


def find_step(fit: Fit, colour: float = 1.0, smallest: float = SMALLEST) -> ChangeSearch:
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
        return ChangeSearch(None)
    if np.linalg.norm(step[n]) < smallest:
        return ChangeSearch(None, undecided=True)
    placed = step_profile(chain, state, weights, reduced, chain.seen(state.parameters))
    rival = placed.at_windows()[0][_BEFORE : len(ratio)]
    strength = np.cbrt(abs(np.linalg.det(unvech(state.parameters[:6]))))
    undecided = ChangeSearch(None, True, bool(np.linalg.norm(step[n]) > LARGE * strength))
    lead = (ratio[n] - rival.max()) / colour
    in_sensor_frame = lead > MARGIN or (lead > -ALIKE and turned(chain.windows.rotation[:, :, n:]) > TURNED)
    if not in_sensor_frame and np.linalg.norm(step[n]) < NO_PLACE * strength:
        return undecided
    found, corrected = _corrected(fit, change_time(chain, profile, colour), colour, strength)
    if _cost(fit) - _cost(corrected) < limit or np.linalg.norm(found.value) < smallest:
        return undecided
    step_window = found.window
    before = _fitted(fit, replace(chain, windows=chain.windows.part(0, step_window)), state.parameters)
    past = _marginal_before(chain, before).forget(HARD_IRON)
    parameters = before.state.parameters.copy()
    parameters[HARD_IRON] += found.value
    following = replace(chain, windows=chain.windows.part(step_window, len(chain.windows)), past=past, facts=())
    after = _fitted(fit, following, parameters)
    sigma = np.sqrt(np.diag(found.covariance))
    found_step = Step(step_window + 1, found.time, found.time_sigma, found.value, sigma, before, past, after)
    return ChangeSearch(found_step)


def _corrected(fit: Fit, found: ChangeTime, colour: float, strength: float) -> tuple[ChangeTime, Fit]:
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
        found = _estimated(chain, _started(fit, found.removed_from(chain), parameters), colour)
        away = found.value - before
        if away @ np.linalg.solve(found.covariance, away) < _CONVERGED:
            break
    for times in _NOISE_FACTORS_LARGE if large else _NOISE_FACTORS:
        noise = SensorNoise(times * chain.noise.magnetometer, times * chain.noise.gyroscope)
        corrected = _fitted(fit, found.removed_from(replace(chain, noise=noise)), parameters)
        found = _estimated(chain, corrected, colour)
    return found, corrected


def _estimated(chain: ContinuedChain, corrected: Fit, colour: float) -> ChangeTime:
    """Return the time and size of a step in a chain, linearised at the fit without it."""
    state, weights = corrected.state, corrected.weights
    profile = step_profile(chain, state, weights, chain.eliminate(state, weights), in_sensor(len(chain.windows)))
    return change_time(chain, profile, colour)


def _marginal_before(chain: ContinuedChain, before: Fit) -> Marginal:
    """Return the marginal of `before` at the window that follows it, whose field is left out."""
    step_window = len(before.chain.windows)
    windows = chain.windows.part(0, step_window + 1)
    count = windows.count.copy()
    count[step_window] = _EMPTY_COUNT
    parameters, direction = before.state
    state = ChainState(parameters, np.column_stack([direction, direction[:, -1]]))
    weights = Weights(np.append(before.weights.window, 1.0), np.append(before.weights.link, 1.0))
    return replace(chain, windows=replace(windows, count=count)).marginalise(state, weights, step_window)


def turned(rotation: Array) -> float:
    """Return the largest rotation, rad, of windows (3, 3, n) relative to the first."""
    trace = np.einsum("ij,ijn->n", rotation[:, :, 0], rotation)
    return float(np.arccos(np.clip(0.5 * (trace.min() - 1), -1, 1)))


def in_sensor(count: int) -> Array:
    """Return the column (3, 3, n) of a step that is fixed in the sensor."""
    return np.repeat(np.eye(3)[:, :, None], count, axis=2)


def _started(fit: Fit, chain: ContinuedChain, parameters: Array) -> Fit:
    return descend(begin(chain, parameters, fit.free), NEAR)


def _fitted(fit: Fit, chain: ContinuedChain, parameters: Array) -> Fit:
    return adapt(_started(fit, chain, parameters), True, None)


def _cost(fit: Fit) -> float:
    """Return twice the robust cost, including that of the past marginal."""
    assert isinstance(fit.chain, ContinuedChain)
    return misfit(fit, fit.chain.noise) + 2 * fit.chain.past_cost(fit.state)


_REJECTED = 16.27  # χ² of 3 degrees of freedom at 99.9 %, the cost of a window that does not fit
_UNKNOWN = 1e-6  # weight of windows whose field is left out; not zero, so that all directions are determined
_ABOUT = 3  # windows before the edge at which the transition may begin


class EarlierChange(NamedTuple):
    """A change before the windows that a calibration explains.

    Attributes:
        window: first window from which the calibration holds.
        time, time_sigma: s, when the hard iron changed.
        step, sigma: (3,) T, hard iron after the change minus before.
        in_sensor: whether the hard iron changed, not the field with the place.
    """

    window: int
    time: float
    time_sigma: float
    step: Array
    sigma: Array
    in_sensor: bool


def find_earlier_change(chain: ContinuedChain, parameters: Array) -> EarlierChange | None:
    """Find the window from which θ explains a chain; return None if it explains all windows or too few."""
    fit = weigh(chain, parameters)
    misfit, _ = chain.squares(chain.residuals(fit.state))
    # The split of least cost, where a window before it counts as half rejected.
    gain = 0.5 * _REJECTED - np.minimum(misfit, _REJECTED)
    n = int(np.argmax(np.cumsum(gain[::-1])[::-1]))
    if not 3 <= n < len(misfit) - 3:
        return None
    # The directions before the split follow from those after it by the gyroscope alone.
    window, link = chain.unweighted()
    window[:n] = _UNKNOWN
    state = ChainState(parameters, fit.state.direction.copy())
    state.direction[:, :n] = state.direction[:, n : n + 1]
    state = chain.settled(state, Weights(window, link))
    # The hard iron before the split need not be constant while a hand moves iron, hence the median of the samples.
    residual = chain.residuals(state).window[:, :n]
    before = residual.T.repeat(chain.windows.count[:n].astype(int), axis=0)
    step = np.median(before, axis=0)
    sigma = 1.4826 * np.median(np.abs(before - step), axis=0) + chain.window_sigma[n]
    when = _transition(residual, step, chain.windows.time[: n + 1])
    in_sensor = _stands_in_sensor(residual, chain.windows.rotation[:, :, :n])
    in_sensor |= bool(np.linalg.norm(step) > NO_PLACE * np.cbrt(abs(np.linalg.det(unvech(parameters[:6])))))
    return EarlierChange(n, *when, step, sigma, in_sensor)


def _stands_in_sensor(residual: Array, rotation: Array) -> bool:
    """Return whether a residual (3, n) is fixed in the sensor rather than the world; False without turning."""
    in_world = np.einsum("ijn,in->jn", rotation, residual)
    spread = [np.abs(part - np.median(part, axis=1)[:, None]).sum() for part in (residual, in_world)]
    return turned(rotation) > TURNED and bool(spread[0] < spread[1])


def _transition(residual: Array, step: Array, time: Array) -> tuple[float, float]:
    """Return mean time and duration (standard deviation), s, of the change of `residual` (3, n) from `step` to zero.

    The first window that fits, at time[n], may follow seconds after a magnet arrived, while a hand was still near it.
    """
    left = np.clip(step @ residual / (step @ step), 0.0, 1.0)
    # Find the edge between two levels first, then the transition near it.
    edge = int(np.argmin(np.concatenate([[0.0], np.cumsum((1 - left) ** 2 - left**2)])))
    first = max(edge - _ABOUT, 0)
    level = np.concatenate([[1.0], np.minimum.accumulate(left[first:]), [0.0]])
    passed = -np.diff(level)  # between window k − 1 and k, for k from `first` to n
    before = time[max(first - 1, 0)]
    between = 0.5 * (time[first:] + np.concatenate([[before], time[first:-1]]))
    mean = float(passed @ between)
    spacing = (time[-1] - before) / len(passed)
    return mean, float(np.sqrt(passed @ (between - mean) ** 2 + spacing**2 / 12))
