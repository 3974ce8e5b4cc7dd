"""Steps in hard iron: a generalised likelihood ratio over the times at which the step may have happened.

At the best fit without a step, one added parameter Δ (3), the hard iron of all windows from n on less that before,
would lower the cost by λ(n)/2, λ(n) = gᵀ S⁻¹ g with g and S the gradient and information of Δ after θ and all
directions are eliminated (Willsky and Jones 1976, here on a smoother instead of a filter). All n share one
factorisation. λ is χ² of 3 degrees of freedom where nothing happened.

Where the field itself is another one from a place on, an offset that stands still in the world explains the
windows better than one that turns with the sensor. Telling them apart takes turning: until then, only what is larger
than any place's field would be is called a step.

A stretch that is merely disturbed also gives a large λ. So a candidate is fitted: the step is taken off
the windows, all of them are fitted, and the step is estimated again about that fit. Robust cost, in which a disturbed
window counts no more than a rejected one, must fall by the same limit.

The window that holds the step is neither before nor after it, and is left out of the fits of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, adapt, begin, descend, misfit, weigh
from magyc_gtsam.factors.chain.field_chain import ChainState, Weights
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.online.likelihood_ratio import change_time, step_profile
from magyc_gtsam.online.marginal import HARD_IRON, ContinuedChain, Marginal

LIMIT = 40.0  # of λ; benchmarks/online.py counts the false alarms
MARGIN = 20.0  # by which λ tells a step in the sensor from one in the world
ALIKE = 5.0  # of λ by which the world may lead where the sensor turned by
TURNED = 2.5  # rad since: what looks alike in both is then taken to be the sensor's
NO_PLACE = 0.5  # of the field strength, a change of the field that no place explains
SMALLEST = 1.5e-6  # T, smaller steps are not worth a restart; the field of a room varies by as much
_AFTER = 5  # windows after a step before it is believed
_BEFORE = 3
_CORRECTIONS = 3  # times the step is taken off and estimated again, so that the linearisation holds nothing of it
_NOTHING = 1e-6  # samples, of a window whose field is left out


@dataclass(frozen=True, eq=False)
class Step:
    """A step inside a window of a chain.

    Attributes:
        window: index of the first window after it; the one before holds it, and is left out of all fits.
        time, time_sigma: s.
        value, sigma: (3,) T.
        before: fit of the windows before it.
        past: their marginal, the hard iron forgotten, for a chain that begins at window − 1.
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
    """The step found, if one was; else whether something happened of which more windows will tell what."""

    step: Step | None
    undecided: bool


def find_step(fit: Fit, colour: float = 1.0, smallest: float = SMALLEST) -> ChangeSearch:
    """Look for a step inside the chain of `fit` (a `ContinuedChain` with a past).

    Args:
        fit: the chain at its minimum without a step.
        colour: by how much neighbouring windows repeat each other's misfit; λ counts for so much less.
        smallest: T; smaller steps do not count.
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
        return ChangeSearch(None, undecided=False)
    if np.linalg.norm(step[n]) < smallest:
        return ChangeSearch(None, undecided=True)
    placed = step_profile(chain, state, weights, reduced, chain.seen(state.parameters))
    rival = placed.at_windows()[0][_BEFORE : len(ratio)]
    strength = np.cbrt(abs(np.linalg.det(unvech(state.parameters[:6]))))
    lead = (ratio[n] - rival.max()) / colour
    told = lead > MARGIN or (lead > -ALIKE and turned(chain.windows.rotation[:, :, n:]) > TURNED)
    if not told and np.linalg.norm(step[n]) < NO_PLACE * strength:
        return ChangeSearch(None, undecided=True)
    # The step taken off: does that explain all windows, and what, seen from there, were its time and size?
    found = change_time(chain, profile, colour)
    for _ in range(_CORRECTIONS):
        corrected = _fitted(fit, found.removed_from(chain), state.parameters)
        linear = chain.eliminate(corrected.state, corrected.weights)
        profile = step_profile(chain, corrected.state, corrected.weights, linear, in_sensor(len(chain.windows)))
        found = change_time(chain, profile, colour)
    if _cost(fit) - _cost(corrected) < limit or np.linalg.norm(found.value) < smallest:
        return ChangeSearch(None, undecided=True)
    held = found.window
    before = _fitted(fit, replace(chain, windows=chain.windows.part(0, held)), state.parameters)
    past = _until(chain, before).forget(HARD_IRON)
    parameters = before.state.parameters.copy()
    parameters[HARD_IRON] += found.value
    rest = replace(chain, windows=chain.windows.part(held, len(chain.windows)), past=past, facts=())
    after = _fitted(fit, rest, parameters)
    sigma = np.sqrt(np.diag(found.covariance))
    found_step = Step(held + 1, found.time, found.time_sigma, found.value, sigma, before, past, after)
    return ChangeSearch(found_step, undecided=False)


def _until(chain: ContinuedChain, before: Fit) -> Marginal:
    """What is known from `before` at the window that follows it, whose own field is left out."""
    held = len(before.chain.windows)
    windows = chain.windows.part(0, held + 1)
    count = windows.count.copy()
    count[held] = _NOTHING
    parameters, direction = before.state
    state = ChainState(parameters, np.column_stack([direction, direction[:, -1]]))
    weights = Weights(np.append(before.weights.window, 1.0), np.append(before.weights.link, 1.0))
    return replace(chain, windows=replace(windows, count=count)).marginalise(state, weights, held)


def turned(rotation: Array) -> float:
    """rad, the largest turn of the windows (3, 3, n) from the first."""
    trace = np.einsum("ij,ijn->n", rotation[:, :, 0], rotation)
    return float(np.arccos(np.clip(0.5 * (trace.min() - 1), -1, 1)))


def in_sensor(count: int) -> Array:
    """(3, 3, n), the column of a step that turns with the sensor."""
    return np.repeat(np.eye(3)[:, :, None], count, axis=2)


def _fitted(fit: Fit, chain: ContinuedChain, parameters: Array) -> Fit:
    return adapt(descend(begin(chain, parameters, fit.free), NEAR), True, None)


def _cost(fit: Fit) -> float:
    """Twice the robust cost, the past's share with it."""
    assert isinstance(fit.chain, ContinuedChain)
    return misfit(fit, fit.chain.noise) + 2 * fit.chain.past_cost(fit.state)


_REJECTED = 16.27  # χ² of 3 degrees of freedom at 99.9 %, what a window that does not fit counts
_UNKNOWN = 1e-6  # weight of windows whose field is left out, not quite zero so that all directions are determined
_ABOUT = 3  # windows before the edge at which the passage may begin


class EarlierChange(NamedTuple):
    """The first window since which a calibration holds; when the hard iron passed from its old value to that, and the
    step (3,) T, after less before, with their sigmas; and whether it was the hard iron, not the field of another
    place."""

    window: int
    time: float
    time_sigma: float
    step: Array
    sigma: Array
    in_sensor: bool


def find_earlier_change(chain: ContinuedChain, parameters: Array) -> EarlierChange | None:
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
    state = ChainState(parameters, fit.state.direction.copy())
    state.direction[:, :n] = state.direction[:, n : n + 1]
    state = chain.settled(state, Weights(window, link))
    # Not all before the split need be of one hard iron, with a hand at work: the middle of its samples.
    residual = chain.residuals(state).window[:, :n]
    before = residual.T.repeat(chain.windows.count[:n].astype(int), axis=0)
    step = np.median(before, axis=0)
    sigma = 1.4826 * np.median(np.abs(before - step), axis=0) + chain.window_sigma[n]
    when = _transition(residual, step, chain.windows.time[: n + 1])
    in_sensor = _stands_in_sensor(residual, chain.windows.rotation[:, :, :n])
    in_sensor |= bool(np.linalg.norm(step) > NO_PLACE * np.cbrt(abs(np.linalg.det(unvech(parameters[:6])))))
    return EarlierChange(n, *when, step, sigma, in_sensor)


def _stands_in_sensor(residual: Array, rotation: Array) -> bool:
    """Whether what is left (3, n) turned with the sensor, not with the world; no, where nothing turned."""
    in_world = np.einsum("ijn,in->jn", rotation, residual)
    spread = [np.abs(part - np.median(part, axis=1)[:, None]).sum() for part in (residual, in_world)]
    return turned(rotation) > TURNED and bool(spread[0] < spread[1])


def _transition(residual: Array, step: Array, time: Array) -> tuple[float, float]:
    """Mean time and duration (standard deviation), s, of the passage of `residual` (3, n) from `step` to none at
    time[n]: the first window that fits may come seconds after a magnet arrived, while a hand was still near it."""
    left = np.clip(step @ residual / (step @ step), 0.0, 1.0)
    # Two levels first, then what lies about their edge.
    edge = int(np.argmin(np.concatenate([[0.0], np.cumsum((1 - left) ** 2 - left**2)])))
    first = max(edge - _ABOUT, 0)
    level = np.concatenate([[1.0], np.minimum.accumulate(left[first:]), [0.0]])
    passed = -np.diff(level)  # between window k − 1 and k, for k from `first` to n
    before = time[max(first - 1, 0)]
    between = 0.5 * (time[first:] + np.concatenate([[before], time[first:-1]]))
    mean = float(passed @ between)
    spacing = (time[-1] - before) / len(passed)
    return mean, float(np.sqrt(passed @ (between - mean) ** 2 + spacing**2 / 12))
