"""Hard iron and gyroscope bias that walk at random: the end of the chain, taken block by block.

Within a block of some seconds the parameters stand still. A block begins with the marginal of all before it, the
parameters widened by what they may have walked since (`Marginal.widen`), and its fit is the estimate now: an
information filter whose measurements are blocks of windows. Head and tail of the smoother
go on beside it, to look for steps.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, adapt, begin, colour_of, descend, weigh
from magyc_gtsam.factors.chain.field_chain import ChainState, FieldChain, SensorNoise, Weights
from magyc_gtsam.factors.chain.preintegration import FieldWindows
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.online.marginal import BIAS, HARD_IRON, ContinuedChain, Marginal, widened
from magyc_gtsam.online.state import SmootherState

_SHORTEST, _LONGEST = 2, 6  # windows of a block, in which the parameters are taken to stand still
_PART = 0.4  # of its sigma by which a parameter may walk in a block
_SEGMENT = 20  # windows with a hard iron of their own, from which the noise levels are learnt
_PASSES = 2  # over all windows kept, for a walk bends the estimate of a fit without one
_NOISE_ROUNDS = 4


def filter_walk(online: SmootherState) -> None:
    """All windows kept, filtered anew; there is an estimate to linearise about."""
    m, last = online.belief, online.last
    numbers, parameters = online.numbers(), last.parameters
    samples = online.buffer.windows(int(numbers[0]), m.done, online.delay)
    windows = samples.integrate(parameters[BIAS], online.delay)
    tail, stop = int(np.searchsorted(numbers, m.tail)), len(numbers) - 1 - _SHORTEST
    for _ in range(_PASSES):
        if online.settings.noise is None:
            noise, colour, freedom = _local_noise(windows, online.last.noise, parameters)
            m.estimate = last._replace(noise=noise, colour=colour, noise_freedom=freedom)
        chain = ContinuedChain(windows, online.last.noise, m.past, facts=online.facts(len(parameters)))
        m.head = _filtered(online, replace(chain, windows=windows.part(0, tail + 1)), parameters)
        rest = replace(chain, windows=windows.part(tail, stop + 1), past=m.head, facts=())
        m.front, m.front_at = _filtered(online, rest, parameters), int(numbers[stop])
        parameters = m.front.minimum
    m.estimate = online.last._replace(parameters=parameters)


def fit_random_walk(online: SmootherState, stop: int) -> Fit:
    """Up to window `stop`: θ and its information are those of the last block, all else is of the whole tail."""
    fit, last = online.asked(online.fit_tail(stop)), _filtered_end(online, stop)[0]
    information, time = last.reduced.information, last.chain.windows.time
    for rows, walk in online.settings.walks:
        # The end of a walk of length T is T/3 (in variance) away from its mean, which the block estimates.
        information, _ = widened(information, rows, walk * np.sqrt((time[-1] - time[0]) / 3 / 3600))
    reduced = fit.reduced._replace(information=information)
    return replace(fit, state=ChainState(last.state.parameters, fit.state.direction), reduced=reduced)


def advance_filter(online: SmootherState) -> None:
    """All windows taken give the estimate; all but the last block of them join what is before the front."""
    m = online.belief
    fit, m.front, first = _filtered_end(online, m.done)
    m.estimate = online.last._replace(parameters=fit.state.parameters, covariance=fit.covariance)
    m.front_at = int(online.numbers(m.front_at)[first])


def _filtered_end(online: SmootherState, stop: int) -> tuple[Fit, Marginal, int]:
    """The last block of the windows from the front on; the marginal with which it begins, and its index."""
    m, last = online.belief, online.last
    assert m.front is not None
    windows = online.buffer.windows(m.front_at, stop, online.delay).integrate(last.parameters[BIAS], online.delay)
    chain, parameters, past, first = ContinuedChain(windows, last.noise), last.parameters, m.front, 0
    length = _block_length(online)
    while True:
        final = len(windows) - first <= 2 * length
        end = len(windows) if final else first + length + 1
        block = replace(chain, windows=windows.part(first, end), past=past)
        begun = begin(block, parameters, online.settings.free(parameters))
        fit = adapt(descend(begun, NEAR), online.settings.reject, None)
        if final:
            return fit, past, first
        past, parameters = _widened(online, block, fit.state, fit.weights), fit.state.parameters
        first += length


def _block_length(online: SmootherState) -> int:
    """Windows in which no parameter walks by more than a part of its sigma."""
    variance = np.diag(online.last.covariance)
    time = min((_PART / walk) ** 2 * float(variance[rows].mean()) * 3600 for rows, walk in online.settings.walks)
    return int(np.clip(time / online.settings.window, _SHORTEST, _LONGEST))


def _filtered(online: SmootherState, chain: ContinuedChain, parameters: Array) -> Marginal:
    """All of a chain as the past of its last window, the parameters walked until then; linearised at θ."""
    count, past = len(chain.windows), chain.past
    edges = np.linspace(0, count - 1, max((count - 1) // _block_length(online), 1) + 1).astype(int)
    for first, last in pairwise(edges):  # neighbours share a window
        facts = () if first else chain.facts  # they are in the marginal then
        block = replace(chain, windows=chain.windows.part(int(first), int(last) + 1), past=past, facts=facts)
        fit = weigh(block, parameters, 1)
        weights = fit.weights if online.settings.reject else block.unweighted()
        past = _widened(online, block, fit.state, weights)
    assert past is not None
    return past


def _widened(online: SmootherState, block: ContinuedChain, state: ChainState, weights: Weights) -> Marginal:
    """A block as the past of its last window, the parameters walked meanwhile."""
    marginal = block.marginalise(state, weights, len(block.windows) - 1)
    elapsed = float(block.windows.time[-1] - block.windows.time[0])
    for rows, walk in online.settings.walks:
        marginal = marginal.widen(rows, walk * np.sqrt(elapsed / 3600))
    return marginal


def _local_noise(windows: FieldWindows, noise: SensorNoise, parameters: Array) -> tuple[SensorNoise, float, float]:
    """The noise levels that short segments show, whatever the hard iron does from one to the next.

    Each group's variance becomes its weighted squares over its redundancy, again and again.

    Returns:
        The noise, the residuals' colour, and the links' redundancy.
    """
    edges = np.linspace(0, len(windows), max(len(windows) // _SEGMENT, 1) + 1).astype(int)
    parts = [windows.part(int(a), int(b)) for a, b in pairwise(edges)]
    free = np.zeros(len(parameters), dtype=bool)
    free[HARD_IRON] = True
    for _ in range(_NOISE_ROUNDS):
        starts = (begin(FieldChain(part, noise), parameters, free) for part in parts)
        fits = [adapt(descend(start, NEAR), True, None) for start in starts]
        squares, redundancy = np.sum([_squares(fit) for fit in fits], axis=0)
        noise = SensorNoise(*(np.array(noise) * np.sqrt(squares / redundancy)).tolist())
    colour = max(colour_of(np.hstack(parts)) for parts in zip(*(fit.whitened for fit in fits), strict=True))
    return noise, colour, float(redundancy[1])


def _squares(fit: Fit) -> tuple[Array, Array]:
    """Weighted squares of windows and links, and the redundancy of both, as `improved_noise` counts them."""
    chain, weights = fit.chain, fit.weights
    window, link = chain.squares(chain.residuals(fit.state))
    absorbed = chain.absorbed(fit.reduced, fit.covariance)
    unknowns = 2 * len(chain.windows) + int(fit.free.sum())
    links = 2 * float(weights.link[chain.windows.linked].sum())
    return (
        np.array([weights.window @ window, weights.link @ link]),
        np.array([3 * weights.window.sum() - absorbed, links - (unknowns - absorbed)]),
    )
