"""Steps in hard iron: a generalised likelihood ratio over the times at which the step may have happened.

At the best fit without a step, one added parameter Δ (3), the hard iron of all windows from n on less that before,
would lower the cost by λ(n)/2, λ(n) = gᵀ S⁻¹ g with g and S the gradient and information of Δ after θ and all
directions are eliminated (Willsky and Jones 1976, here on a smoother instead of a filter). All n share one
factorisation. λ is χ² of 3 degrees of freedom where nothing happened.

Where the field itself is another one from a place on, an offset that stands still in the world explains the
windows better than one that turns with the sensor. Telling them apart takes turning: until then, only what is larger
than any place's field would be is called a step.

A stretch that is merely disturbed also gives a large λ. So a candidate is fitted in earnest: the windows before
it, then, with their hard iron forgotten, those after it. Robust cost, in which a disturbed window counts no more
than a rejected one, must fall by the same limit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dtbtrs

from magyc_gtsam.estimators.chain_fit import NEAR, Fit, adapt, begin, descend, misfit
from magyc_gtsam.factors.field_chain import PARAMETERS, Reduced, State
from magyc_gtsam.factors.rotations import Array
from magyc_gtsam.factors.soft_iron import unvech
from magyc_gtsam.online.summary import HARD_IRON, ContinuedChain, Summary, take

LIMIT = 40.0  # of λ; benchmarks/online.py counts the false alarms
MARGIN = 20.0  # by which λ tells a step in the sensor from one in the world
ALIKE, TURNED = (
    5.0,
    2.5,
)  # λ and rad, after such a turn a step that looks alike in both is taken to be the sensor's
_NO_PLACE = 0.5  # of the field strength, a change of the field that no place explains
SMALLEST = 1.5e-6  # T, smaller steps are not worth a new beginning; the field of a room varies by as much
_AFTER = 5  # windows after a step before it is believed
_BEFORE = 3


@dataclass(frozen=True, eq=False)
class Step:
    """A step between two windows of a chain.

    Attributes:
        window: index of the first window after it.
        time, time_sigma: s.
        value, sigma: (3,) T.
        before: fit of the windows before it.
        past: their summary, the hard iron forgotten, for a chain that begins at window − 1.
        after: fit of that chain.
    """

    window: int
    time: float
    time_sigma: float
    value: Array
    sigma: Array
    before: Fit
    past: Summary
    after: Fit


def find_step(fit: Fit, colour: float = 1.0) -> Step | None:
    """The most likely step inside the chain of `fit` (a `ContinuedChain` with a past), if there is one.

    Args:
        fit: the chain at its minimum without a step.
        colour: by how much neighbouring windows repeat each other's misfit; λ counts for so much less.
    """
    chain = fit.chain
    assert isinstance(chain, ContinuedChain)
    limit = LIMIT * colour
    reduced = chain.eliminate(fit.state, chain.unweighted())
    ratio, step, covariance = likelihood_ratio(chain, fit.state, reduced, in_sensor(len(chain.windows)))
    ratio = ratio[: len(chain.windows) - _AFTER + 1]
    ratio[:_BEFORE] = 0.0
    n = int(np.argmax(ratio))
    if ratio[n] < limit or np.linalg.norm(step[n]) < SMALLEST:
        return None
    rival = likelihood_ratio(chain, fit.state, reduced, chain.seen(fit.state.parameters))[0][_BEFORE : len(ratio)]
    strength = np.cbrt(abs(np.linalg.det(unvech(fit.state.parameters[:6]))))
    lead = (ratio[n] - rival.max()) / colour
    told = lead > MARGIN or (lead > -ALIKE and _turned(chain.windows.rotation[:, :, n:]) > TURNED)
    if not told and np.linalg.norm(step[n]) < _NO_PLACE * strength:
        return None
    before = _fitted(fit, replace(chain, windows=take(chain.windows, 0, n)), fit.state.parameters)
    assert isinstance(before.chain, ContinuedChain)
    past = before.chain.condense(before.state, before.weights, n - 1).forget(HARD_IRON)
    parameters = before.state.parameters.copy()
    parameters[HARD_IRON] += step[n]
    rest = replace(chain, windows=take(chain.windows, n - 1, len(chain.windows)), past=past)
    after = _fitted(fit, rest, parameters)
    value = (after.state.parameters - before.state.parameters)[HARD_IRON]
    gain = _cost(fit) - _cost(before) - _cost(after)
    if gain < limit or np.linalg.norm(value) < SMALLEST:
        return None
    # When: between two windows, each pair as likely as its λ says.
    between = 0.5 * (chain.windows.time[1:] + chain.windows.time[:-1])[: len(ratio) - 1]
    likely = np.exp(0.5 * (ratio[1:] - ratio[n]))
    likely /= likely.sum()
    time = float(likely @ between)
    spacing = float(chain.windows.time[n] - chain.windows.time[n - 1])
    spread = float(likely @ (between - time) ** 2) + spacing**2 / 12
    return Step(n, time, float(np.sqrt(spread)), value, np.sqrt(np.diag(covariance[n])), before, past, after)


def _turned(rotation: Array) -> float:
    """rad, the largest turn of the windows (3, 3, n) from the first."""
    trace = np.einsum("ij,ijn->n", rotation[:, :, 0], rotation)
    return float(np.arccos(np.clip(0.5 * (trace.min() - 1), -1, 1)))


def in_sensor(count: int) -> Array:
    """(3, 3, n), the column of a step that turns with the sensor."""
    return np.repeat(np.eye(3)[:, :, None], count, axis=2)


def likelihood_ratio(
    chain: ContinuedChain, state: State, reduced: Reduced, column: Array
) -> tuple[Array, Array, Array]:
    """λ (n,) of a step before each window, the step Δ (n, 3) and its covariance (n, 3, 3).

    Args:
        chain, state, reduced: a chain, linearised without robust weights.
        column: (3, 3, n) what Δ adds to the field of each window it applies to.
    """
    n = len(chain.windows)
    scale = chain.window_scale
    column = column * scale
    residual = chain.residuals(state).window * scale
    # Sums over all windows from n on, of Δ's information, cross information and gradient.
    own = _from(np.einsum("kin,kjn->nij", column, column))
    cross = _from(np.einsum("pkn,kin->npi", reduced.on_parameters, column))
    pull = _from(np.einsum("kn,kin->ni", residual, column))
    # Δ's border with the directions, window by window, eliminated.
    border = np.zeros((n, 2, n, 3))
    every = np.arange(n)
    border[every, :, every] = np.einsum("kan,kin->nai", reduced.on_direction, column)
    border = np.cumsum(border[:, :, ::-1], axis=2)[:, :, ::-1]  # a step before n moves n and all that follow
    half, _ = dtbtrs(reduced.factor, border.reshape(2 * n, 3 * n), uplo="L")
    half = half.reshape(2 * n, n, 3)
    information = own - np.einsum("rni,rnj->nij", half, half)
    cross = cross - np.einsum("rni,rp->npi", half, reduced.half[:, :PARAMETERS])
    gradient = pull - np.einsum("rni,r->ni", half, reduced.half[:, PARAMETERS])
    known = Fit(chain, state, chain.unweighted(), reduced, np.diag(reduced.information) > 0).covariance
    information = information - np.einsum("npi,pq,nqj->nij", cross, known, cross)
    gradient = gradient - np.einsum("npi,pq,q->ni", cross, known, reduced.gradient)
    value, vector = np.linalg.eigh(information)
    value = np.maximum(value, 1e-9 * value[:, -1:] + 1e-300)
    covariance = np.einsum("nik,nk,njk->nij", vector, 1 / value, vector)
    step = -np.einsum("nij,nj->ni", covariance, gradient)
    return -np.einsum("ni,ni->n", step, gradient), step, covariance


def _from(values: Array) -> Array:
    """Sums over the first axis from each index on."""
    return np.cumsum(values[::-1], axis=0)[::-1]


def _fitted(fit: Fit, chain: ContinuedChain, parameters: Array) -> Fit:
    return adapt(descend(begin(chain, parameters, fit.free), NEAR), True, None)


def _cost(fit: Fit) -> float:
    """Twice the robust cost, the past's share with it."""
    assert isinstance(fit.chain, ContinuedChain)
    return misfit(fit, fit.chain.noise) + 2 * fit.chain.past_cost(fit.state)
