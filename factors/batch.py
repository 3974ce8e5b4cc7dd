"""The solution of a batch whose Python factors are quadratics, which are made anew until nothing moves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import gtsam

from magyc_gtsam.factors.admission import Optimize
from magyc_gtsam.factors.delivered import Delivered
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.solver import View, predicted_decrease
from magyc_gtsam.factors.variables import key_name
from magyc_gtsam.factors.warm_up import narrow, robust_blocks

# Decrease of the error (half squared sigmas) that is not worth another round: a tenth of a sigma.
_WORTHLESS = 0.005


class BatchSolution(NamedTuple):
    """The solution of a batch.

    Attributes:
        values: the estimate.
        settled: whether it is a minimum, with no kernel narrowing.
        replaced: number of quadratics that were made anew.
    """

    values: gtsam.Values
    settled: bool
    replaced: int


def expect_values(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    """Raise an error unless every variable of a graph has a value."""
    absent = [key_name(key) for key in graph.keyVector() if not values.exists(key)]
    if absent:
        raise MagycError(
            f"native factors: no value for {', '.join(absent[:5])}{' and others' if len(absent) > 5 else ''}; insert "
            "one for each variable of the graph"
        )


def solve_batch(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    delivered: Sequence[Delivered],
    optimize: Optimize | None,
    *,
    rounds: int,
    tolerance: float,
    quadratic: bool,
) -> BatchSolution:
    """Minimise the error of a graph, to which the delivered factors are added.

    Args:
        graph: the other factors; the delivered ones are appended.
        values: where to begin.
        delivered: the Python factors.
        optimize: (graph, values) → values; None is Levenberg–Marquardt.
        rounds: largest number of rounds.
        tolerance: staleness in standard deviations up to which a solution of `optimize` counts as settled.
        quadratic: False leaves the Python factors as they are.
    """
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
    return BatchSolution(values, settled, replaced)


def minimum(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """Return the minimum near `values` by Levenberg–Marquardt.

    GTSAM ends by default at a relative decrease of 1e-5, which with an error of 10,000 may be half a sigma away.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(0.0)
    parameters.setAbsoluteErrorTol(0.1 * _WORTHLESS)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def _at_minimum(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> bool:
    """Return whether a full step is not worth it; False where the variables are not determined."""
    try:
        return predicted_decrease(graph, values) < _WORTHLESS
    except RuntimeError:
        return False
