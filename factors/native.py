"""Python factors delivered as native ones, and linearised again when the estimate has moved.

GTSAM hands each Python factor a copy of all `Values`, so that one of them costs more the larger the graph is.
`NativeFactors` gives the graph a `LinearContainerFactor` instead, a quadratic that GTSAM evaluates by itself
without Python, keeps the Python factor aside, and replaces the quadratic when it has grown stale: when its
gradient at the present estimate differs from the factor's own by more than `tolerance` standard deviations.

    native = NativeFactors()
    native.add(graph, factor, isam, new_values)          # instead of graph.push_back(factor)
    remove = native.refresh(graph, isam)                 # pushes replacements; slots to give up
    result = isam.update(graph, new_values, remove)
    native.placed(result.getNewFactorsIndices())

In a batch the graph is the same throughout: `while native.renew(graph, values): values = optimise(...)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Array, measured
from magyc_gtsam.factors.pose import MICROTESLA, check_unit
from magyc_gtsam.factors.soft_iron import vech

Estimate = gtsam.Values | gtsam.ISAM2 | gtsam.IncrementalFixedLagSmoother | gtsam.BatchFixedLagSmoother


@dataclass
class _Delivered:
    """A Python factor, the quadratic that stands for it, and the quadratic's slot in the solver's graph."""

    factor: gtsam.NonlinearFactor
    native: gtsam.LinearContainerFactor
    slot: int


def native_factor(factor: gtsam.NonlinearFactor, point: gtsam.Values) -> gtsam.LinearContainerFactor:
    """The factor's quadratic at `point`, which must hold its keys: native, picklable, free of Python.

    Of a `field_chain_factor` at its solution it is the whole log's marginal, a prior for the next mission.
    """
    return gtsam.LinearContainerFactor(_square_root(factor, point), point)


def calibration_prior(
    soft_iron_key: int,
    hard_iron_key: int,
    soft_iron: ArrayLike,
    hard_iron: ArrayLike,
    covariance: ArrayLike,
    *,
    field_unit: float = MICROTESLA,
) -> gtsam.LinearContainerFactor:
    """A calibration that is known already as a native prior on (A, h), with all its correlations.

    Args:
        soft_iron_key, hard_iron_key: 6-vector; 3-vector or `Point3` in `field_unit`.
        soft_iron: (3, 3), scaled to the true field (`magyc_gtsam.calibrate(..., field_strength=...)`).
        hard_iron: (3,) T.
        covariance: (9, 9) or larger, of vech(soft iron), hard iron T and what follows, which is left out.
        field_unit: T per unit of the key h.

    Raises:
        MagycError: a singular covariance, as that of a soft iron of determinant 1.
    """
    check_unit(field_unit)
    unit = np.concatenate([np.ones(6), np.full(3, field_unit)])
    spread = np.asarray(covariance, dtype=float)[:9, :9] / unit / unit[:, None]
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    correlation = spread / scale / scale[:, None]
    if not np.isfinite(spread).all() or np.linalg.eigvalsh(correlation)[0] < 1e-9:
        raise MagycError(
            "calibration prior: the covariance is singular, as where the soft iron's determinant is fixed at 1; "
            "calibrate with `field_strength` given, or leave that constraint to the graph"
        )
    root = np.linalg.inv(np.linalg.cholesky(correlation)) / scale
    point = gtsam.Values()
    point.insert(soft_iron_key, vech(soft_iron))
    point.insert(hard_iron_key, measured("hard iron", hard_iron, (3,)) / field_unit)
    noise = gtsam.noiseModel.Unit.Create(9)
    linear = gtsam.JacobianFactor(soft_iron_key, root[:, :6], hard_iron_key, root[:, 6:], np.zeros(9), noise)
    return gtsam.LinearContainerFactor(linear, point)


class NativeFactors:
    """Delivers Python factors as native ones and keeps them fresh.

    In iSAM2 a replacement costs what the elimination from that factor to the root costs. So the factors
    are checked together and seldom: each time that their number has grown by `growth`.

    Args:
        tolerance: standard deviations, of each variable given one factor alone, by which that factor's
            stale gradient may shift the variable.
        growth: of the number of factors between two checks.

    Attributes:
        replaced: number of replacements so far.
    """

    def __init__(self, tolerance: float = 0.05, growth: float = 2.0) -> None:
        if not (tolerance > 0 and growth > 1):
            raise MagycError(f"native factors: tolerance {tolerance} must be above 0, growth {growth} above 1")
        self.tolerance, self.growth = tolerance, growth
        self.replaced = 0
        self._delivered: list[_Delivered] = []
        self._pending: list[tuple[int, int]] = []  # (which, position in the graph of the coming update)
        self._next = 2.0

    def __len__(self) -> int:
        return len(self._delivered)

    def add(
        self,
        graph: gtsam.NonlinearFactorGraph,
        factor: gtsam.NonlinearFactor,
        estimate: Estimate,
        new_values: gtsam.Values | None = None,
    ) -> None:
        """Push the factor's quadratic at the present estimate into `graph`.

        Args:
            graph: the new factors of the next update, or the whole graph of a batch.
            factor: e.g. a `keyframe_field_factor`.
            estimate: `ISAM2`, a fixed-lag smoother, or `Values`, holding the keys that exist already.
            new_values: the values of the next update, holding the keys that do not.
        """
        native = native_factor(factor, _point(factor, estimate, new_values))
        self._delivered.append(_Delivered(factor, native, graph.size()))
        self._push(graph, len(self) - 1)

    def refresh(
        self, graph: gtsam.NonlinearFactorGraph, estimate: gtsam.ISAM2, *, everything: bool = False
    ) -> list[int]:
        """Push fresh quadratics for stale ones into `graph`; the slots of the stale ones, to be removed.

        Call it before each update, and `placed` after it.

        Args:
            graph: the new factors of the next update.
            estimate: the solver.
            everything: check now, as after a loop closure or before the final result; until it returns
                nothing, if the result is to be that of a batch.
        """
        if len(self) < self._next and not everything:
            return []
        self._next = self.growth * max(len(self), 1)
        waiting = {which for which, _ in self._pending}  # the solver does not have them yet
        remove = []
        for which, delivered in enumerate(self._delivered):
            if which not in waiting and self._renewed(delivered, _point(delivered.factor, estimate)):
                remove.append(delivered.slot)
                self._push(graph, which)
        return remove

    def placed(self, indices: Sequence[int]) -> None:
        """Learn the slots of what was pushed, from `ISAM2Result.getNewFactorsIndices()` of the update."""
        for which, position in self._pending:
            self._delivered[which].slot = int(indices[position])
        self._pending.clear()

    def renew(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> int:
        """Replace the stale quadratics of a batch graph in place; how many there were."""
        self._pending.clear()
        stale = [delivered for delivered in self._delivered if self._renewed(delivered, values)]
        for delivered in stale:
            graph.replace(delivered.slot, delivered.native)
        return len(stale)

    def _push(self, graph: gtsam.NonlinearFactorGraph, which: int) -> None:
        if self._pending and graph.size() <= self._pending[-1][1]:
            raise MagycError("native factors: after each update call `placed` with its new indices")
        self._pending.append((which, graph.size()))
        graph.push_back(self._delivered[which].native)

    def _renewed(self, delivered: _Delivered, point: gtsam.Values) -> bool:
        """Whether the quadratic was stale at `point`; it is a new one then."""
        exact = _square_root(delivered.factor, point)
        if _shift(exact, delivered.native.linearize(point)) <= self.tolerance:
            return False
        delivered.native = gtsam.LinearContainerFactor(exact, point)
        self.replaced += 1
        return True


def _point(
    factor: gtsam.NonlinearFactor, estimate: Estimate, new_values: gtsam.Values | None = None
) -> gtsam.Values:
    """A linearisation point that holds the factor's keys, the new values first."""
    if isinstance(estimate, gtsam.Values):
        point = gtsam.Values(estimate) if new_values is not None else estimate
    else:
        keys = factor.keys()
        old = [key for key in keys if new_values is None or not new_values.exists(key)]
        point = estimate.calculateEstimate(old) if old else gtsam.Values()
    if new_values is not None:
        point.insert(new_values)
    return point


def _square_root(factor: gtsam.NonlinearFactor, point: gtsam.Values) -> gtsam.JacobianFactor:
    """The factor's linearisation in as few rows as its keys have columns, and one for the rest."""
    return gtsam.JacobianFactor(gtsam.HessianFactor(factor.linearize(point)))


def _shift(exact: gtsam.GaussianFactor, stale: gtsam.GaussianFactor) -> float:
    """Largest difference of two gradients, in standard deviations of each variable given the factor alone."""
    first, second = exact.augmentedInformation(), stale.augmentedInformation()
    information: Array = np.diag(first)[:-1]
    difference = np.abs(first[:-1, -1] - second[:-1, -1])[information > 0]
    return float((difference / np.sqrt(information[information > 0])).max())
