"""Estimation of hard iron and gyroscope bias that walk at random, by filtering the end of the chain block by block.

Within a block of some seconds the parameters are constant. A block begins with the marginal of all windows before,
widened by the random walk since (`Marginal.widen`), and its fit is the present estimate: an information filter whose
measurements are blocks of windows. Head and tail of the smoother are maintained in parallel for the detection of
steps.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from magyc_gtsam.estimators.smoother.fit import Fit, colour_of
from magyc_gtsam.estimators.smoother.marginal import BIAS, HARD_IRON, ContinuedChain, Marginal, fitted, widened
from magyc_gtsam.estimators.smoother.noise_levels import squares_and_redundancies, weigh
from magyc_gtsam.factors.chain.chain_values import ChainState, SensorNoise, Weights
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.online.report import with_misalignment
from magyc_gtsam.online.state import SmootherState

_SHORTEST, _LONGEST = 2, 6  # windows of a block, in which the parameters are constant
_PART = 0.4  # share of its sigma by which a parameter may walk within a block
_SEGMENT = 20  # windows that share one hard iron when the noise levels are estimated
_PASSES = 2  # passes over all windows kept: the walk distorts the first estimate, of a fit without a walk
_NOISE_ROUNDS = 4


def filter_walk(online: SmootherState) -> None:
    """Filter all windows kept again, linearised at the present estimate."""
    belief, last = online.belief, online.last
    numbers, parameters = online.numbers(), last.parameters
    samples = online.buffer.windows(int(numbers[0]), belief.done, online.delay)
    windows = samples.integrate(parameters[BIAS], online.delay)
    tail, stop = int(np.searchsorted(numbers, belief.tail)), len(numbers) - 1 - _SHORTEST
    for _ in range(_PASSES):
        if online.settings.noise is None:
            noise, colour, freedom = _local_noise(windows, online.last.noise, parameters)
            belief.estimate = last._replace(noise=noise, colour=colour, noise_freedom=freedom)
        chain = ContinuedChain(windows, online.last.noise, belief.past, facts=online.facts(len(parameters)))
        belief.head = _filtered(online, replace(chain, windows=windows.part(0, tail + 1)), parameters)
        following = replace(chain, windows=windows.part(tail, stop + 1), past=belief.head, facts=())
        belief.front, belief.front_at = _filtered(online, following, parameters), int(numbers[stop])
        parameters = belief.front.minimum
    belief.estimate = online.last._replace(parameters=parameters)


def fit_random_walk(online: SmootherState, stop: int) -> Fit:
    """Return a fit up to window `stop` with θ and its information from the last block, the rest from the whole tail."""
    fit, last = with_misalignment(online, online.fit_tail(stop)), _filtered_end(online, stop)[0]
    information, time = last.reduced.information, last.chain.windows.time
    for rows, walk in online.settings.walks:
        # The block estimates the walk's mean; the end of a walk of length T differs from it by T/3 in variance.
        information, _ = widened(information, rows, walk * np.sqrt((time[-1] - time[0]) / 3 / 3600))
    reduced = fit.reduced._replace(information=information)
    return replace(fit, state=ChainState(last.state.parameters, fit.state.direction), reduced=reduced)


def advance_filter(online: SmootherState) -> None:
    """Update the estimate from all windows taken, and move the front up to the last block."""
    belief = online.belief
    fit, belief.front, first = _filtered_end(online, belief.done)
    belief.estimate = online.last._replace(parameters=fit.state.parameters, covariance=fit.covariance)
    belief.front_at = int(online.numbers(belief.front_at)[first])


def _filtered_end(online: SmootherState, stop: int) -> tuple[Fit, Marginal, int]:
    """Filter the windows from the front on; return the last block's fit, its initial marginal and its first window."""
    belief, last = online.belief, online.last
    assert belief.front is not None
    windows = online.buffer.windows(belief.front_at, stop, online.delay).integrate(
        last.parameters[BIAS], online.delay
    )
    chain, parameters, past, first = ContinuedChain(windows, last.noise), last.parameters, belief.front, 0
    length = _block_length(online)
    while True:
        final = len(windows) - first <= 2 * length
        end = len(windows) if final else first + length + 1
        block = replace(chain, windows=windows.part(first, end), past=past)
        fit = fitted(block, parameters, online.settings.free(parameters), online.settings.reject)
        if final:
            return fit, past, first
        past, parameters = _widened(online, block, fit.state, fit.weights), fit.state.parameters
        first += length


def _block_length(online: SmootherState) -> int:
    """Return the number of windows in which no parameter walks by more than a part of its sigma."""
    variance = np.diag(online.last.covariance)
    time = min((_PART / walk) ** 2 * float(variance[rows].mean()) * 3600 for rows, walk in online.settings.walks)
    return int(np.clip(time / online.settings.window, _SHORTEST, _LONGEST))


def _filtered(online: SmootherState, chain: ContinuedChain, parameters: Array) -> Marginal:
    """Return the marginal of a whole chain at its last window, including the random walk; linearised at θ."""
    count, past = len(chain.windows), chain.past
    edges = np.linspace(0, count - 1, max((count - 1) // _block_length(online), 1) + 1).astype(int)
    for first, last in pairwise(edges):  # neighbours share a window
        facts = () if first else chain.facts  # later blocks have them in the marginal
        block = replace(chain, windows=chain.windows.part(int(first), int(last) + 1), past=past, facts=facts)
        fit = weigh(block, parameters, 1)
        weights = fit.weights if online.settings.reject else block.unweighted()
        past = _widened(online, block, fit.state, weights)
    assert past is not None
    return past


def _widened(online: SmootherState, block: ContinuedChain, state: ChainState, weights: Weights) -> Marginal:
    """Return the marginal of a block at its last window, including the random walk."""
    marginal = block.marginalise(state, weights, len(block.windows) - 1)
    elapsed = float(block.windows.time[-1] - block.windows.time[0])
    for rows, walk in online.settings.walks:
        marginal = marginal.widen(rows, walk * np.sqrt(elapsed / 3600))
    return marginal


def _local_noise(windows: FieldWindows, noise: SensorNoise, parameters: Array) -> tuple[SensorNoise, float, float]:
    """Estimate the noise levels from short segments, each with its own hard iron.

    Each group's variance is iterated as its weighted squares over its redundancy.

    Returns:
        The noise, the residuals' colour, and the links' redundancy.
    """
    edges = np.linspace(0, len(windows), max(len(windows) // _SEGMENT, 1) + 1).astype(int)
    parts = [windows.part(int(a), int(b)) for a, b in pairwise(edges)]
    free = np.zeros(len(parameters), dtype=bool)
    free[HARD_IRON] = True
    for _ in range(_NOISE_ROUNDS):
        fits = [fitted(FieldChain(part, noise), parameters, free) for part in parts]
        each = [squares_and_redundancies(fit, fit.chain.squares(fit.residuals)) for fit in fits]
        squares, redundancy = np.sum(each, axis=0)
        noise = SensorNoise(*(np.array(noise) * np.sqrt(squares / redundancy)).tolist())
    colour = max(colour_of(np.hstack(parts)) for parts in zip(*(fit.whitened for fit in fits), strict=True))
    return noise, colour, float(redundancy[1])
