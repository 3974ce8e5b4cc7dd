"""The solution of a batch whose Python factors are quadratics, which are made anew until nothing moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import gtsam

from magyc_gtsam.factors.alignment import AlignmentLimits
from magyc_gtsam.factors.delivered import Delivered, Sorted
from magyc_gtsam.factors.solver import View, predicted_decrease
from magyc_gtsam.factors.turned_start import Optimize, turned_start
from magyc_gtsam.factors.warm_up import narrow, robust_blocks

# Decrease of the error (half squared sigmas) that is not worth another round: a tenth of a sigma.
_WORTHLESS = 0.005


class BatchSolution(NamedTuple):
    """The solution of a batch.

    Attributes:
        graph: the other factors and the delivered ones, as quadratics at the solution.
        delivered: the Python factors, with their quadratics.
        values: the estimate.
        settled: whether it is a minimum, with no kernel narrowing.
        replaced: number of quadratics that were made anew.
    """

    graph: gtsam.NonlinearFactorGraph
    delivered: list[Delivered]
    values: gtsam.Values
    settled: bool
    replaced: int


def best_solution(
    factors: Sorted,
    values: gtsam.Values,
    limits: AlignmentLimits | None,
    optimize: Optimize | None,
    *,
    rounds: int,
    tolerance: float,
    quadratic: bool,
) -> BatchSolution:
    """Solve a batch from its start and from where its blocks turn that, and once more from where they turn a solution.

    Half a turn off, a vehicle that stays level fits its blocks with a negative soft iron: a minimum that the blocks
    themselves tell from the right one.

    Args:
        factors: of the batch.
        values: where to begin.
        limits: of the coarse alignment, which turns; None turns nothing.
        optimize, rounds, tolerance, quadratic: as in `solve_batch`.

    Returns:
        The solution with the least error.
    """
    others, fresh = factors.others, factors.fresh

    def solved(start: gtsam.Values) -> BatchSolution:
        return solve_batch(others, start, fresh, optimize, rounds=rounds, tolerance=tolerance, quadratic=quadratic)

    def turned(start: gtsam.Values) -> gtsam.Values:
        return turned_start(limits, others, start, fresh, optimize or minimum)

    first = turned(values)
    solutions = [solved(start) for start in ([values] if first is values else [first, values])]
    best = min(solutions, key=lambda solution: _error(others, fresh, solution.values))
    again = _calibration_of(values, fresh, best.values)
    if (other := turned(again)) is not again:
        solutions.append(solved(other))
    if len(solutions) == 1:
        return best
    best = min(solutions, key=lambda solution: _error(others, fresh, solution.values))
    narrow(robust_blocks(each.factor for each in fresh), best.values)
    return best._replace(replaced=sum(solution.replaced for solution in solutions))


def _calibration_of(start: gtsam.Values, fresh: Sequence[Delivered], values: gtsam.Values) -> gtsam.Values:
    """Return values with soft and hard iron as in `start`."""
    result = gtsam.Values(values)
    for details in (each.details for each in fresh if each.details is not None):
        for key in (details.soft_iron_key, details.hard_iron_key):
            result.update(key, start.atVector(key))
    return result


def solve_batch(
    others: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    fresh: Sequence[Delivered],
    optimize: Optimize | None,
    *,
    rounds: int,
    tolerance: float,
    quadratic: bool,
) -> BatchSolution:
    """Minimise the error of a graph.

    Args:
        others: the other factors of the graph.
        values: where to begin.
        fresh: the Python factors.
        optimize: (graph, values) → values; None is Levenberg–Marquardt.
        rounds: largest number of rounds.
        tolerance: staleness in standard deviations up to which a solution of `optimize` counts as settled.
        quadratic: False leaves the Python factors as they are.
    """
    graph, delivered = gtsam.NonlinearFactorGraph(others), [replace(each) for each in fresh]
    robust = robust_blocks(each.factor for each in delivered)
    narrow(robust, values)
    first, replaced, settled = graph.size(), 0, False
    for i, each in enumerate(delivered):
        if quadratic:
            each.make(View(values))
        each.slot = first + i
        graph.push_back(each.native)
    for _ in range(rounds):
        values = (optimize or minimum)(graph, values)
        narrowed = narrow(robust, values)
        stale = 0.0
        if quadratic:  # all at once: renewing only the stale ones takes more rounds
            stale = max((each.renew(View(values), 0.0) for each in delivered), default=0.0)
            for each in delivered:
                graph.replace(each.slot, each.native)
            replaced += len(delivered)
        settled = not narrowed and (_at_minimum(graph, values) if optimize is None else stale <= tolerance)
        if settled:
            break
    return BatchSolution(graph, delivered, values, settled, replaced)


def minimum(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """Return the minimum near `values` by Levenberg–Marquardt.

    GTSAM ends by default at a relative decrease of 1e-5, which with an error of 10,000 may be half a sigma away.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(0.0)
    parameters.setAbsoluteErrorTol(0.1 * _WORTHLESS)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def _error(others: gtsam.NonlinearFactorGraph, fresh: Sequence[Delivered], values: gtsam.Values) -> float:
    """Return the error of a graph, with all kernels at their stated width."""
    for _, details in robust_blocks(each.factor for each in fresh):
        details.width = 1.0
    blocks = sum(each.factor.error(values.extract(list(each.factor.keys()))) for each in fresh)
    return float(others.error(values) + blocks)


def _at_minimum(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> bool:
    """Return whether a full step is not worth it; False where the variables are not determined."""
    try:
        return predicted_decrease(graph, values) < _WORTHLESS
    except RuntimeError:
        return False
