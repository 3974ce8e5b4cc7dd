"""A common interface for reading and updating iSAM2 and both fixed-lag smoothers."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import gtsam
import numpy as np

from magyc_gtsam.factors.constraints import exact_covariance
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.variables import Array

Solver = gtsam.ISAM2 | gtsam.IncrementalFixedLagSmoother | gtsam.BatchFixedLagSmoother
_READ = (gtsam.ISAM2, gtsam.FixedLagSmoother, gtsam.Values)


def with_factors(
    graph: gtsam.NonlinearFactorGraph, factors: Sequence[gtsam.NonlinearFactor]
) -> gtsam.NonlinearFactorGraph:
    """Return a graph with these factors appended; the graph itself where there are none."""
    if not factors:
        return graph
    result = gtsam.NonlinearFactorGraph(graph)
    for factor in factors:
        result.push_back(factor)
    return result


class View:
    """A solver's estimate, overlaid with the new values of the coming update."""

    def __init__(self, solver: Solver | gtsam.Values, new: gtsam.Values | None = None) -> None:
        _check_solver(solver)
        self.solver, self.new = solver, gtsam.Values() if new is None else new
        self._held: gtsam.Values | None = None
        self._estimate: gtsam.Values | None = None

    def exists(self, key: int) -> bool:
        """Whether the key has a value."""
        if self.new.exists(key):
            return True
        if isinstance(self.solver, gtsam.Values):
            return bool(self.solver.exists(key))
        if isinstance(self.solver, gtsam.ISAM2):
            return bool(self.solver.valueExists(key))
        if self._held is None:
            self._held = self.solver.getLinearizationPoint()
        return bool(self._held.exists(key))

    @property
    def state(self) -> tuple[int, int, int] | None:
        """Numbers of iSAM2's variables, slots and factors, one of which changes where any of them goes.

        None for solvers that drop variables in an update.
        """
        if not isinstance(self.solver, gtsam.ISAM2):
            return None
        factors = self.solver.getFactorsUnsafe()
        return int(self.solver.getLinearizationPoint().size()), int(factors.size()), int(factors.nrFactors())

    def values(self, keys: Sequence[int]) -> gtsam.Values:
        """Return the values of these keys, all of which must exist."""
        if isinstance(self.solver, gtsam.Values):
            return self.solver.extract(list(keys))
        old = [key for key in keys if not self.new.exists(key)]
        point = self.solver.calculateEstimate(old) if old else gtsam.Values()
        if len(old) < len(keys):
            point.insert(self.new)
        return point

    def linearized(self, keys: Sequence[int]) -> gtsam.Values:
        """Return the solver's linearisation points of these keys, all of which it must hold."""
        held = self.solver if isinstance(self.solver, gtsam.Values) else self.solver.getLinearizationPoint()
        return held.extract(list(keys))

    def estimate(self) -> gtsam.Values:
        """Return all values that the solver holds, without those of the coming update; not to be changed."""
        if isinstance(self.solver, gtsam.Values):
            return self.solver
        if self._estimate is None:
            self._estimate = self.solver.calculateEstimate()
        return self._estimate

    def factors(self) -> gtsam.NonlinearFactorGraph:
        """Return a copy of the solver's graph, indexed by slots."""
        if isinstance(self.solver, gtsam.Values):
            raise MagycError("the values of a batch have no graph")
        if isinstance(self.solver, gtsam.IncrementalFixedLagSmoother):
            return gtsam.NonlinearFactorGraph(self.solver.getISAM2().getFactorsUnsafe())
        if isinstance(self.solver, gtsam.BatchFixedLagSmoother):
            return gtsam.NonlinearFactorGraph(self.solver.getFactors())
        return gtsam.NonlinearFactorGraph(self.solver.getFactorsUnsafe())

    def placed(self, graph: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
        """Return factors of the solver with its marginals at the point where they hold.

        What iSAM2 and the incremental smoother leave of marginalised variables is linear about their linearisation
        point, but does not contain it, and would be taken to be about any estimate. Such a factor is recognised by its
        linearisation being the same at both.
        """
        if isinstance(self.solver, gtsam.Values | gtsam.BatchFixedLagSmoother):
            return graph
        before, now = self.solver.getLinearizationPoint(), self.estimate()
        result = gtsam.NonlinearFactorGraph(graph)
        for i in range(graph.size()):
            factor = graph.at(i) if graph.exists(i) else None
            if isinstance(factor, gtsam.LinearContainerFactor):
                keys = list(factor.keys())
                point = before.extract(keys)
                there, here = factor.linearize(point), factor.linearize(now.extract(keys))
                if np.array_equal(there.augmentedInformation(), here.augmentedInformation()):
                    result.replace(i, gtsam.LinearContainerFactor(factor.factor(), point))
        return result

    def covariance(self, keys: Sequence[int]) -> Array | None:
        """Return the joint covariance of keys that the solver holds, in their order; None where it is not available."""
        if isinstance(self.solver, gtsam.Values):
            return None
        try:
            if isinstance(self.solver, gtsam.BatchFixedLagSmoother):
                marginals = gtsam.Marginals(self.solver.getFactors(), self.solver.calculateEstimate())
                joint = marginals.jointMarginalCovariance(list(keys))
            else:
                isam = self.solver if isinstance(self.solver, gtsam.ISAM2) else self.solver.getISAM2()
                joint = isam.jointMarginalCovariance(list(keys))
        except RuntimeError:  # the variables are not determined
            return None
        return exact_covariance(joint, keys, self.factors)


def update_solver(
    solver: Solver,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    timestamps: Mapping[int, float] | None,
    remove: Sequence[int],
    last: Sequence[Collection[int]] = (),
) -> Any:
    """Update the solver and return its result.

    Args:
        solver, graph, values, timestamps: as in `NativeFactors.update`.
        remove: slots of factors to remove.
        last: groups of keys that iSAM2 eliminates after all others, in this order; empty for iSAM2's own order.
    """
    if isinstance(solver, gtsam.ISAM2):
        if not last:
            return solver.update(graph, values, list(remove)) if remove else solver.update(graph, values)
        groups = gtsam.KeyGroupMap()
        for group, keys in enumerate(last, 1):
            for key in keys:
                groups.insert2(key, group)
        return solver.update(graph, values, list(remove), groups)
    _check_solver(solver)
    try:
        stamps: Any = dict(timestamps or {})
    except (TypeError, ValueError):
        raise MagycError(
            f"native factors: `timestamps` is a {type(timestamps).__name__}; give {{key: s}} of the keys that are new "
            "or must stay"
        ) from None
    if missing := [key for key in list(values.keys()) if key not in stamps]:
        raise MagycError(
            f"native factors: {len(missing)} new keys without a time stamp, {gtsam.DefaultKeyFormatter(missing[0])} "
            "first; a fixed-lag smoother needs `timestamps`, {key: s}, of every new key, and at each update of those "
            "that must stay"
        )
    return solver.update(graph, values, stamps, list(remove))


def predicted_decrease(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> float:
    """Return the decrease of the linearised graph's error by the full Gauss–Newton step."""
    linear = graph.linearize(values)
    step = linear.optimize()
    return float(linear.error(values.zeroVectors()) - linear.error(step))


def new_slots(solver: Solver, result: Any, last: Sequence[gtsam.NonlinearFactor]) -> list[int]:
    """Return the slots of the last factors that an update added, in their order; −1 for one that has already left."""
    if isinstance(solver, gtsam.BatchFixedLagSmoother):  # its result does not contain them
        factors = solver.getFactors()
        held = [(i, factors.at(i)) for i in range(factors.size()) if factors.exists(i)]
        return [next((i for i, factor in reversed(held) if factor is each), -1) for each in last]
    done = result if isinstance(solver, gtsam.ISAM2) else solver.getISAM2Result()
    slots = list(done.getNewFactorsIndices())
    return slots[len(slots) - len(last) :]


def _check_solver(solver: object) -> None:
    """Raise an error for objects that are not a supported solver."""
    if not isinstance(solver, _READ):
        raise MagycError(
            f"solver is a {type(solver).__name__}; accepted: ISAM2, IncrementalFixedLagSmoother, "
            "BatchFixedLagSmoother, and Values for a batch"
        )
