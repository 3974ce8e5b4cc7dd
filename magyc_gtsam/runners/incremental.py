"""Incremental optimisation of a growing GTSAM graph by iSAM2, with Dogleg (RISE) or Gauss–Newton.

GTSAM's `ISAM2` is left half updated when an update throws, for example at an undetermined variable or a NaN residual,
and must not be used afterwards. Here an update takes place completely or not at all, and the result says why. Factors
keep the handles under which they were added, whatever iSAM2 does.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from typing import Any

import gtsam
import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import NonFiniteError
from magyc_gtsam.factors.solver import predicted_decrease
from magyc_gtsam.factors.warm_up import WarmUp, robust_blocks
from magyc_gtsam.runners.batch import called, undetermined
from magyc_gtsam.runners.isam import Factorization, Method, isam_parameters
from magyc_gtsam.runners.status import Convergence, IncrementalResult, Status

_REFRESH = 10  # variables per update between two reads of the whole estimate


class Incremental:
    """A growing graph, and its estimate after every update.

    An update costs what iSAM2 needs for the variables that it touches. The estimate of the other variables is brought
    up to date, and the minimum tested on the whole graph, only when the number of updates since has reached a tenth
    of the number of variables, or when `values` is read. A kernel inside a block of samples starts wide and narrows by
    itself (`kernels.narrowed`).

    Args:
        method: "dogleg" (RISE, whose trust region limits the effect of poor early data) or "gauss-newton".
        relinearize_threshold: change of a variable, in its own units, from which its factors are linearised again. 0
            relinearises at every step, so that the estimate equals a batch's, at a cost that grows with the number of
            factors on the variable.
        radius: first trust region of "dogleg", in the units of the variables.
        tolerance: largest step for `Status.CONVERGED`.
        factorization: "cholesky", or "qr" for badly scaled information.
        names: names of keys for messages.

    Raises:
        MagycError: an option is invalid.
    """

    def __init__(
        self,
        method: Method = "dogleg",
        *,
        relinearize_threshold: float = 0.0,
        radius: float = 1.0,
        tolerance: float = 1e-7,
        factorization: Factorization = "cholesky",
        names: Mapping[int, str] | None = None,
    ) -> None:
        self._parameters = isam_parameters(method, relinearize_threshold, radius, tolerance, factorization)
        self._tolerance = tolerance
        self._names = names
        self._isam = gtsam.ISAM2(self._parameters)
        self._values = gtsam.Values()
        self._factors: dict[int, Any] = {}
        self._slots: dict[int, int] = {}
        self._next_handle = 0
        self._convergence = Convergence(method, tolerance, relinearize_threshold)
        self._since = 0  # number of updates since the whole estimate was read
        self._current = True
        self._unsolved = False  # whether iSAM2 is empty, because the factors determine nothing at the estimate
        self._kernels = WarmUp()

    @property
    def values(self) -> gtsam.Values:
        """A copy of the estimate after the last update that took place."""
        self._read_all()
        return gtsam.Values(self._values)

    @property
    def factors(self) -> Mapping[int, Any]:
        """A copy of the factors in the graph by their handles."""
        return dict(self._factors)

    def error(self) -> float:
        """Return GTSAM's error at the estimate: half the sum of squared whitened residuals, or of their kernels."""
        self._read_all()
        return float(self._graph().error(self._values))

    def covariance(self, key: int) -> np.ndarray:
        """Return the marginal covariance of one variable, at iSAM2's last linearisation point.

        Raises:
            MagycError: the key is not in the graph, or not determined.
        """
        if not self._values.exists(key) or self._unsolved:
            problem = "not determined; add data, or a prior" if self._unsolved else "not in the graph"
            raise MagycError(f"{called(key, self._names)} is {problem}")
        return np.asarray(self._isam.marginalCovariance(key))

    def update(
        self,
        factors: gtsam.NonlinearFactorGraph | Iterable[Any] = (),
        initial: gtsam.Values | None = None,
        *,
        remove: Iterable[int] = (),
        steps: int = 1,
    ) -> IncrementalResult:
        """Add factors, remove others and improve the estimate, either completely or not at all.

        To replace a factor (a compressed one by its successor), add one and remove the other in one update.

        Args:
            factors: factors to add; their noise models may be robust.
            initial: initial values of the new variables; others are ignored.
            remove: handles of factors to remove.
            steps: largest number of steps; the update ends when a step moves nothing by more than the tolerance.

        Raises:
            MagycError: a handle is unknown, a new variable has no initial value, or a factor's error function returns a
                wrong shape. Numerical failures are reported by the status, not by an exception.
        """
        if steps < 1:
            raise MagycError(f"steps: must be at least 1, got {steps}")
        added = _as_graph(factors)
        members = [added.at(i) for i in range(added.size())]
        removed = list(dict.fromkeys(remove))
        unknown = [handle for handle in removed if handle not in self._factors]
        if unknown:
            raise MagycError(f"no factor {unknown[0]} in the graph; handles are what `update` returned")
        new = self._new_variables(added, initial)
        fresh, lost = new.keys(), bool(removed)
        complete, moved, before = False, 0.0, list[gtsam.Values]()
        try:
            self._warm_up(members, new)
            result, new_slots = self._added(added, new, removed)
            before.append(new)
            self._values.insert(new)
            moved = self._step(result, before, fresh, lost)
            for _ in range(steps - 1):
                if not moved > self._tolerance:  # also false for NaN
                    break
                moved = self._step(self._isam.update(), before, [], lost)
            complete = math.isfinite(moved)
        except (KeyboardInterrupt, NonFiniteError, RuntimeError) as problem:
            return self._not_updated(problem)
        finally:
            if not complete:
                self._restore(before)
        if not complete:
            return IncrementalResult(Status.FAILED, f"the step became {moved}; nothing was updated")

        for handle in removed:
            del self._factors[handle], self._slots[handle]
        first, self._next_handle = self._next_handle, self._next_handle + len(members)
        handles = tuple(range(first, self._next_handle))
        self._factors.update(zip(handles, members, strict=True))
        self._slots.update(zip(handles, new_slots, strict=True))
        self._current = False
        self._since += 1
        if removed:
            for key in result.getUnusedKeys():  # variables whose last factor was removed
                if self._values.exists(key):
                    self._values.erase(key)
        if _REFRESH * self._since >= self._values.size():
            self._read_all()
        prediction = self._prediction if self._current or steps > 1 else None
        try:
            return self._convergence.result(handles, moved, prediction)
        except RuntimeError as problem:  # the full step from the new estimate does not exist
            lost_key = undetermined(problem)
            if lost_key is None:
                raise
            message = (
                f"{called(lost_key, self._names)} is not determined at the new estimate; add data, or a prior"
            )
            return IncrementalResult(Status.STALLED, message, handles, moved)

    def _added(
        self, added: gtsam.NonlinearFactorGraph, new: gtsam.Values, removed: list[int]
    ) -> tuple[gtsam.ISAM2Result, list[int]]:
        """Add factors to iSAM2 and remove others; return its result and the slots of the added ones."""
        if not self._unsolved:
            result = self._isam.update(added, new, [self._slots[handle] for handle in removed])
            return result, result.getNewFactorsIndices()
        kept = [handle for handle in self._factors if handle not in removed]
        every = _as_graph(
            [*(self._factors[handle] for handle in kept), *(added.at(i) for i in range(added.size()))]
        )
        start = self._values.extract([key for key in every.keyVector() if not new.exists(key)])
        start.insert(new)
        result = self._isam.update(every, start)
        slots = result.getNewFactorsIndices()
        self._slots.update(zip(kept, slots, strict=False))
        self._unsolved = False
        return result, slots[len(kept) :]

    def _warm_up(self, added: list[Any], new: gtsam.Values) -> None:
        """Set the widths of the kernels in blocks from the misfit of the last blocks."""
        for block in robust_blocks(added):
            keys = list(block.factor.keys())
            fresh = [key for key in keys if new.exists(key)]
            point = self._values.extract([key for key in keys if not new.exists(key)])
            point.insert(new.extract(fresh))
            self._kernels.add(block, point)
        self._kernels.narrow()

    def _new_variables(self, factors: gtsam.NonlinearFactorGraph, initial: gtsam.Values | None) -> gtsam.Values:
        keys = [key for key in factors.keyVector() if not self._values.exists(key)]
        missing = [key for key in keys if initial is None or not initial.exists(key)]
        if missing:
            raise MagycError(f"no initial value for {', '.join(called(key, self._names) for key in missing)}")
        return gtsam.Values() if initial is None else initial.extract(keys)

    def _step(self, result: gtsam.ISAM2Result, before: list[gtsam.Values], new: list[int], lost: bool) -> float:
        """Read the variables that a step touched, and return the largest change of a variable that existed before.

        Args:
            result: result of the step.
            before: the values that each step of this update replaced; this step's are appended.
            new: the new variables, which `values` already holds.
            lost: whether factors were removed, so that variables may have gone.
        """
        marked = result.getMarkedKeys()
        keys = list(
            itertools.islice(marked, len(marked))
        )  # the end is a C++ exception, slower than reading the keys
        if lost:
            keys = [key for key in keys if self._isam.valueExists(key)]
        after, replaced = self._isam.calculateEstimate(keys), self._values.extract(keys)
        before.append(replaced)
        self._values.update(after)
        if new and len(keys) > len(new):
            replaced.update(after.extract(new))
        step = float(abs(replaced.localCoordinates(after).vector()).max()) if keys else 0.0
        self._convergence.record(step)
        return step

    def _read_all(self) -> None:
        """Bring the estimate of all variables up to date."""
        if not self._current:
            self._values, self._current, self._since = self._isam.calculateEstimate(), True, 0

    def _prediction(self) -> tuple[float, float]:
        """Return the predicted decrease of the error by a full step, and the error."""
        self._read_all()
        return predicted_decrease(self._graph(), self._values), self.error()

    def _not_updated(self, problem: BaseException) -> IncrementalResult:
        """Return the result of an update that raised; raise again any error that is not a numerical failure."""
        if isinstance(problem, KeyboardInterrupt):
            return IncrementalResult(Status.INTERRUPTED, "interrupted; nothing was updated")
        if isinstance(problem, NonFiniteError):
            return IncrementalResult(Status.FAILED, f"{problem}; nothing was updated")
        key = undetermined(problem) if isinstance(problem, RuntimeError) else None
        if key is None:
            raise problem
        message = f"{called(key, self._names)} is not determined; add data, or a prior; nothing was updated"
        return IncrementalResult(Status.INDETERMINATE, message)

    def _graph(self) -> gtsam.NonlinearFactorGraph:
        return _as_graph(self._factors.values())

    def _restore(self, before: list[gtsam.Values]) -> None:
        """Restore the state before an update that did not take place, which may have left iSAM2 unusable."""
        for replaced in reversed(before[1:]):
            self._values.update(replaced)
        for key in before[0].keys() if before else ():
            if self._values.exists(key):
                self._values.erase(key)
        self._isam = gtsam.ISAM2(self._parameters)
        if self._factors:
            try:
                slots = self._isam.update(self._graph(), self._values).getNewFactorsIndices()
            except RuntimeError as problem:
                if undetermined(problem) is None:
                    raise
                # The last step led to where the factors determine nothing: they are added again with the next ones.
                self._isam, self._current, self._unsolved = gtsam.ISAM2(self._parameters), True, True
                return
            self._current, self._unsolved = True, False
            self._slots = dict(zip(self._factors, slots, strict=True))


def _as_graph(factors: gtsam.NonlinearFactorGraph | Iterable[Any]) -> gtsam.NonlinearFactorGraph:
    if isinstance(factors, gtsam.NonlinearFactorGraph):
        return factors
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph
