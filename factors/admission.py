"""Admission of blocks to a graph: at once, or once its heading is settled; until then they and their variables wait."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np

from magyc_gtsam.factors.alignment import (
    AlignmentLimits,
    CoarseAlignment,
    HeadingVerdict,
    heading_sigma,
    rotation_of,
)
from magyc_gtsam.factors.constraints import HELD, without_constraints
from magyc_gtsam.factors.delivered import Delivered
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.solver import View
from magyc_gtsam.factors.variables import Array, choose, vector

_WEAK_PRIOR = np.diag(
    np.r_[np.full(6, 1 / 0.5**2), np.full(3, 1.0)]
)  # information on soft iron and on hard iron, the latter relative to the field
_NO_IRON = np.r_[1.0, 0, 0, 1, 0, 1, 0, 0, 0]

Optimize = Callable[[gtsam.NonlinearFactorGraph, gtsam.Values], gtsam.Values]


@dataclass(eq=False)
class Admission:
    """The changes to the blocks of a graph in one update.

    Attributes:
        entering: factors that enter now.
        leaving: factors that leave the graph and wait.
        pull: prior that turns the graph from now on.
        remove: slots of factors that leave the graph for good, besides those of `leaving`.
        turned: whether the graph is being or has been turned, which invalidates all earlier verdicts.
    """

    entering: list[Delivered]
    leaving: list[Delivered] = field(default_factory=list)
    pull: gtsam.NonlinearFactor | None = None
    remove: list[int] = field(default_factory=list)
    turned: bool = False


class AdmissionControl:
    """Keeps blocks waiting while the coarse alignment contradicts the heading, and turns the graph by a prior.

    Args:
        limits: limits of the coarse alignment; None lets every block enter at once.

    Attributes:
        waiting: factors that wait.
        entered: whether blocks have entered.
        pull: prior that turns the graph while they wait; `pull_slot` is its slot in the solver.
    """

    def __init__(self, limits: AlignmentLimits | None) -> None:
        self._alignment = None if limits is None else CoarseAlignment(limits)
        self.waiting: list[Delivered] = []
        self.entered = limits is None
        self.pull: gtsam.NonlinearFactor | None = None
        self.pull_slot = -1
        self._values = gtsam.Values()
        self._prior: tuple[Array, Array] | None = None

    def admit(
        self, view: View, fresh: list[Delivered], delivered: list[Delivered], others: gtsam.NonlinearFactorGraph
    ) -> Admission:
        """Decide which blocks enter and leave in an update that brings the factors `fresh` and `others`."""
        alignment = self._alignment
        blocks = [each for each in fresh if each.is_block] if fresh else fresh
        if alignment is None or not blocks:
            return self._as_before(fresh, blocks)
        for each in blocks:
            assert each.details is not None
            alignment.add(each.details)
        last = blocks[-1].details
        assert last is not None
        if self._prior is None:
            self._prior = _calibration_before(view, others, last)
        if alignment.full and self.entered:
            self._alignment = None
            return Admission(fresh)
        point = view.values(alignment.needed)
        verdict = alignment.judge(point, *self._prior) if alignment.due else HeadingVerdict.UNDECIDED
        if verdict is HeadingVerdict.NEAR:
            admission = Admission(self.waiting + fresh, turned=not self.entered)
            self._alignment, self.entered, self.waiting = None, True, []
            if self.pull is not None:
                admission.remove.append(self.pull_slot)
                self.pull = None
            return admission
        if verdict is HeadingVerdict.FAR or (
            verdict is HeadingVerdict.APART and self.entered and alignment.apart >= alignment.limits.persistence
        ):
            leaving = [each for each in delivered if each.details is not None]
            self.waiting += leaving + blocks
            self.entered = False
            admission = Admission([each for each in fresh if each not in blocks], leaving, turned=True)
            if verdict is HeadingVerdict.APART:  # the graph alone, or later blocks, will decide
                return admission
            if self.pull is not None:
                admission.remove.append(self.pull_slot)
            self.pull, self.pull_slot = alignment.pull(point, last.attitude_key), -1
            admission.pull = self.pull
            return admission
        undecided = verdict is HeadingVerdict.UNDECIDED
        if undecided and not self.entered and self.pull is None and self._sure(view, point, last.attitude_key):
            self.entered = True
            entering, self.waiting = self.waiting + fresh, []
            return Admission(entering)
        return self._as_before(fresh, blocks)

    def _as_before(self, fresh: list[Delivered], blocks: list[Delivered]) -> Admission:
        """Admit the fresh factors where blocks have entered before; otherwise keep their blocks waiting."""
        if self.entered:
            return Admission(fresh)
        self.waiting += blocks
        return Admission([each for each in fresh if each not in blocks])

    def start(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        fresh: list[Delivered],
        optimize: Optimize,
    ) -> gtsam.Values:
        """Return the initial values of a batch in which all blocks enter, turned where the blocks contradict their
        heading.
        """
        self.entered, alignment = True, self._alignment
        if alignment is None:
            return values
        for each in fresh:
            if each.is_block:
                assert each.details is not None
                alignment.add(each.details)
        if not len(alignment):
            return values
        prior = _calibration_before(View(values), graph, alignment.last)
        for _ in range(alignment.limits.persistence):
            verdict = alignment.judge(values, *prior)
        if verdict is not HeadingVerdict.FAR:
            return values
        return self._turned(graph, values, alignment.last, optimize)

    def _sure(self, view: View, point: gtsam.Values, key: int) -> bool:
        """Whether the graph's own heading is certain enough, at the last pose that the solver holds."""
        assert self._alignment is not None
        held = [each for each in self._alignment.attitudes if not view.new.exists(each) and view.exists(each)]
        if not held:
            return False
        covariance, limit = view.covariance(held[-1:]), self._alignment.limits.confident
        if covariance is None or heading_sigma(point, held[-1], covariance) >= limit:
            return False
        # iSAM2's covariance is that where it linearised: of a graph that turns, and waits for its next
        # relinearisation (`relinearizeSkip`), it says nothing.
        before = rotation_of(view.linearized(held[-1:]), held[-1])
        return bool(np.linalg.norm(before - rotation_of(point, held[-1])) < np.sqrt(2) * limit)

    def _turned(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        last: BlockDetails,
        optimize: Optimize,
    ) -> gtsam.Values:
        """Return the values of a batch after optimising its other factors with a prior on the heading."""
        assert self._alignment is not None
        turning = gtsam.NonlinearFactorGraph()
        turning.push_back(graph)
        turning.push_back(self._alignment.pull(values, last.attitude_key))
        loose = gtsam.noiseModel.Isotropic.Sigma
        for key in {last.soft_iron_key, last.hard_iron_key} - set(turning.keyVector()):
            turning.addPriorVector(key, values.atVector(key), loose(values.atVector(key).size, 1.0))
        known = set(turning.keyVector())
        start = gtsam.Values(values)
        for key in list(values.keys()):
            if key not in known:
                start.erase(key)
        found = optimize(turning, start)
        result = gtsam.Values(values)
        result.update(found)
        return result

    @property
    def defers(self) -> bool:
        """Whether blocks or variables are waiting."""
        return bool(self.waiting) or not self._values.empty()

    @property
    def changing(self) -> list[object]:
        """The objects that an update changes."""
        return [self] if self._alignment is None else [self, self._alignment]

    def joined(self, new: gtsam.Values) -> gtsam.Values:
        """Return new values together with those that are kept until their factor enters."""
        if self._values.empty():
            return new
        result = gtsam.Values(self._values)
        result.insert(new)
        return result

    def covered(self, new: gtsam.Values, pushed: gtsam.NonlinearFactorGraph) -> gtsam.Values:
        """Return those of the `joined` values that a factor of this update uses; keep the others."""
        if not self.defers:
            return new
        used, result = set(pushed.keyVector()), gtsam.Values(new)
        self._values = gtsam.Values(new)
        for key in list(new.keys()):
            (self._values if key in used else result).erase(key)
        return result

    def placed(self, slot: int) -> None:
        """Record the slot of the prior that turns the graph; −1 where its attitude has already left the solver."""
        self.pull_slot = slot
        if slot < 0:
            self.pull = None

    def forget(self, view: View) -> None:
        """Remove the factors on keys that have left the solver."""
        self.waiting = [each for each in self.waiting if all(map(view.exists, each.factor.keys()))]
        if self._alignment is not None:
            self._alignment.drop([key for key in self._alignment.needed if not view.exists(key)])


def _calibration_before(
    view: View, graph: gtsam.NonlinearFactorGraph, details: BlockDetails
) -> tuple[Array, Array]:
    """Return mean (9,) and information (9, 9) of soft and hard iron before any block, from the solver or from priors,
    new ones or those of the solver; a weak prior for what has none.
    """
    keys = [details.soft_iron_key, details.hard_iron_key]
    strength = 50e-6 if details.field is None else float(np.linalg.norm(details.field))
    unit = np.r_[np.ones(6), np.full(3, details.field_unit / strength)]
    weak = _WEAK_PRIOR * unit * unit[:, None]
    point = view.values(keys)
    start = np.concatenate(
        [
            choose("coarse alignment", vector(size), point, key)(point, key)[0]
            for key, size in zip(keys, (6, 3), strict=True)
        ]
    )
    covariance = None if any(map(view.new.exists, keys)) else view.covariance(keys)
    if covariance is not None:
        covariance += np.diag(np.where(np.diag(covariance) > 0, 0.0, (HELD / unit) ** 2))
        known, gradient, seen = np.linalg.inv(covariance), np.zeros(9), np.full(9, True)
    else:
        priors = _priors(view, graph, keys)
        held = set(priors.keyVector())
        seen = np.repeat([key in held for key in keys], (6, 3))
        known, gradient = np.zeros((9, 9)), np.zeros(9)
        if held:
            ordering = gtsam.Ordering()
            for key in (each for each in keys if each in held):
                ordering.push_back(key)
            square, right = without_constraints(priors.linearize(point), keys, unit).hessian(ordering)
            known[np.ix_(seen, seen)], gradient[seen] = square, right
    information = weak * np.where(seen, 1e-3, 1.0)  # makes it regular beside priors
    right = information @ _NO_IRON + gradient + known @ start
    return np.linalg.solve(information + known, right), information + known


def _priors(view: View, graph: gtsam.NonlinearFactorGraph, keys: Sequence[int]) -> gtsam.NonlinearFactorGraph:
    """Return the factors on nothing but these keys, among new ones and those of the solver."""
    priors = gtsam.NonlinearFactorGraph()
    for factors in [graph] if isinstance(view.solver, gtsam.Values) else [graph, view.factors()]:
        for i in range(factors.size()):
            if factors.exists(i) and set(factors.at(i).keys()) <= set(keys):
                priors.push_back(factors.at(i))
    return view.placed(priors)
