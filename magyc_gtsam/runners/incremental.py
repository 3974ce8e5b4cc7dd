"""Incremental optimisation of any GTSAM graph as it grows: iSAM2, with Dogleg (RISE) or Gauss–Newton.

GTSAM's `ISAM2` is left half updated when an update throws (a variable that nothing determines yet, a
residual that is NaN) and must not be used afterwards. Here an update takes place whole or not at all, and
the result says why. Factors keep the handle under which they were added, whatever iSAM2 does.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import gtsam
import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import NonFiniteError, factor_details
from magyc_gtsam.factors.kernels import narrowed
from magyc_gtsam.runners.batch import called, predicted_decrease, undetermined
from magyc_gtsam.runners.status import Status

Method = Literal["dogleg", "gauss-newton"]

_OPTIMIZERS = {"dogleg": gtsam.ISAM2DoglegParams, "gauss-newton": gtsam.ISAM2GaussNewtonParams}
_FACTORIZATIONS = {"cholesky": "CHOLESKY", "qr": "QR"}
_REFRESH = 10  # variables per update between two looks at the whole graph
_GROWING = 4  # steps in a row, each larger than the one before
_RECENT = 40  # blocks by whose misfit a kernel's width is set
_SHARE = 0.01  # of the error that a step may still promise where what moves little is not linearised again
_WORTHLESS = 1e-6  # decrease of the error, which counts half squared sigmas, that is not worth a step


@dataclass(frozen=True, eq=False)
class IncrementalResult:
    """What one `Incremental.update` did.

    Attributes:
        status: CONVERGED where the last step moved no variable that existed before by more than the tolerance, or
            than what is linearised again; MAX_ITERATIONS where one still moves (the next update goes on),
            DIVERGED where steps grow, STALLED where no step lowers the error though it is no minimum; else the
            update did not take place.
        message: the same in words, with the numbers behind it and a remedy.
        factors: handles of the factors added, in their order.
        step: largest change of a variable in the last step, in its own units, of those that the update touched and
            that existed before; NaN without a step.
    """

    status: Status
    message: str
    factors: tuple[int, ...] = ()
    step: float = float("nan")

    @property
    def updated(self) -> bool:
        """Whether the update took place."""
        return self.status in (Status.CONVERGED, Status.MAX_ITERATIONS, Status.DIVERGED, Status.STALLED)


class Incremental:
    """A graph that grows, and its estimate after every update.

    An update costs what iSAM2 itself needs for the variables that it touches: the estimate of the others is brought up
    to date, and the graph looked at as a whole, only each time that the number of updates since has reached a
    tenth of the number of variables, or when `values` is read. A kernel inside a block of samples starts wide and
    narrows by itself (`kernels.narrowed`).

    Args:
        method: "dogleg" (RISE: a trust region keeps poor early data from throwing the estimate away) or
            "gauss-newton".
        relinearize_threshold: change of a variable, in its own units, from which the factors on it are
            linearised again. 0 does so at every step, so that the estimate is a batch's, at a cost that
            grows with the number of factors on it.
        radius: first trust region of "dogleg", in the units of the variables.
        tolerance: on a step, for `Status.CONVERGED`.
        factorization: "cholesky", or "qr" for badly scaled information.
        names: what to call keys in messages.

    Raises:
        MagycError: an option that is wrong.
    """

    def __init__(
        self,
        method: Method = "dogleg",
        *,
        relinearize_threshold: float = 0.0,
        radius: float = 1.0,
        tolerance: float = 1e-7,
        factorization: Literal["cholesky", "qr"] = "cholesky",
        names: Mapping[int, str] | None = None,
    ) -> None:
        for what, given, known in (
            ("optimizer", method, _OPTIMIZERS),
            ("factorization", factorization, _FACTORIZATIONS),
        ):
            if given not in known:
                raise MagycError(f"{what} {given!r} unknown; there are {', '.join(known)}")
        if not (np.isfinite(relinearize_threshold) and relinearize_threshold >= 0):
            raise MagycError(
                f"relinearize_threshold: must be finite and not negative, got {relinearize_threshold}"
            )
        for what, value in (("radius", radius), ("tolerance", tolerance)):
            if not (np.isfinite(value) and value > 0):
                raise MagycError(f"{what}: must be finite and above 0, got {value}")
        optimizer = _OPTIMIZERS[method]()
        if method == "dogleg":
            optimizer.setInitialDelta(radius)
        self._parameters = gtsam.ISAM2Params()
        self._parameters.setOptimizationParams(optimizer)
        self._parameters.setRelinearizeThreshold(relinearize_threshold)
        self._parameters.relinearizeSkip = 1
        self._parameters.setFactorization(_FACTORIZATIONS[factorization])
        self._parameters.findUnusedFactorSlots = True  # else replaced factors leave their places behind
        self._tolerance = tolerance
        self._names = names
        self._isam = gtsam.ISAM2(self._parameters)
        self._values = gtsam.Values()
        self._factors: dict[int, Any] = {}
        self._slots: dict[int, int] = {}
        self._next_handle = 0
        self._limit = max(tolerance, relinearize_threshold)
        self._trusts = method == "dogleg" or relinearize_threshold <= tolerance  # a region that may have shrunk
        self._since = 0  # updates since the whole estimate was read
        self._current = True
        self._steps: deque[float] = deque(maxlen=_GROWING + 1)
        self._robust: list[Any] = []

    @property
    def values(self) -> gtsam.Values:
        """The estimate after the last update that took place; a copy."""
        self._read_all()
        return gtsam.Values(self._values)

    @property
    def factors(self) -> Mapping[int, Any]:
        """The factors in the graph by their handles; a copy."""
        return dict(self._factors)

    def error(self) -> float:
        """GTSAM's error at the estimate: half the sum of squared whitened residuals, or of their kernels."""
        self._read_all()
        return float(self._graph().error(self._values))

    def covariance(self, key: int) -> np.ndarray:
        """Marginal covariance of one variable, linearised where iSAM2 last did.

        Raises:
            MagycError: the key is not in the graph.
        """
        if not self._values.exists(key):
            raise MagycError(f"{called(key, self._names)} is not in the graph")
        return np.asarray(self._isam.marginalCovariance(key))

    def update(
        self,
        factors: gtsam.NonlinearFactorGraph | Iterable[Any] = (),
        initial: gtsam.Values | None = None,
        *,
        remove: Iterable[int] = (),
        steps: int = 1,
    ) -> IncrementalResult:
        """Add factors, remove others and improve the estimate: all of it or, with the reason, nothing.

        To replace a factor (a compressed one by its successor), add one and remove the other in one update.

        Args:
            factors: to be added; their noise models may be robust.
            initial: of the variables that are new; others in it are not looked at.
            remove: handles of earlier factors.
            steps: most steps to make; it ends where one moves nothing by more than the tolerance.

        Raises:
            MagycError: a handle that is not known, a new variable without initial value, or a factor whose
                error function has a wrong shape. Numerical trouble is no exception but a status.
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
        whole, moved, before = False, 0.0, list[gtsam.Values]()
        try:
            self._warm_up(members, new)
            slots = [self._slots[handle] for handle in removed]
            result = self._isam.update(added, new, slots)
            found = result.getNewFactorsIndices()
            before.append(new)
            self._values.insert(new)
            moved = self._step(result, before, fresh, lost)
            for _ in range(steps - 1):
                if not moved > self._tolerance:  # nor goes on from NaN
                    break
                moved = self._step(self._isam.update(), before, [], lost)
            whole = math.isfinite(moved)
        except (KeyboardInterrupt, NonFiniteError, RuntimeError) as problem:
            return self._not_updated(problem)
        finally:
            if not whole:
                self._restore(before)
        if not whole:
            return IncrementalResult(Status.FAILED, f"the step became {moved}; nothing was updated")

        for handle in removed:
            del self._factors[handle], self._slots[handle]
        first, self._next_handle = self._next_handle, self._next_handle + len(members)
        handles = tuple(range(first, self._next_handle))
        self._factors.update(zip(handles, members, strict=True))
        self._slots.update(zip(handles, found, strict=True))
        self._current = False
        self._since += 1
        if removed:
            for key in result.getUnusedKeys():  # variables that lost their last factor
                if self._values.exists(key):
                    self._values.erase(key)
        if _REFRESH * self._since >= self._values.size():
            self._read_all()
        return self._verdict(handles, moved, steps)

    def _warm_up(self, added: list[Any], new: gtsam.Values) -> None:
        """Set the widths of the kernels in blocks by how the last ones fitted."""
        for factor in added:
            details = factor_details(factor)
            if getattr(details, "robust", None) is None:
                continue
            keys = list(factor.keys())
            fresh = [key for key in keys if new.exists(key)]
            point = self._values.extract([key for key in keys if not new.exists(key)])
            point.insert(new.extract(fresh))
            factor.error(point)  # sets the block's misfit
            self._robust.append(details)
        if self._robust:
            width = narrowed([details.misfit for details in self._robust[-_RECENT:]])
            for details in self._robust[-_RECENT:]:
                details.width = width

    def _new_variables(self, factors: gtsam.NonlinearFactorGraph, initial: gtsam.Values | None) -> gtsam.Values:
        keys = [key for key in factors.keyVector() if not self._values.exists(key)]
        missing = [key for key in keys if initial is None or not initial.exists(key)]
        if missing:
            raise MagycError(f"no initial value for {', '.join(called(key, self._names) for key in missing)}")
        return gtsam.Values() if initial is None else initial.extract(keys)

    def _step(self, result: gtsam.ISAM2Result, before: list[gtsam.Values], new: list[int], lost: bool) -> float:
        """Read what a step touched; by how much it moved a variable that existed before at most.

        Args:
            result: of the step.
            before: of this update, what each of its steps replaced; one more afterwards.
            new: the new variables, which `values` holds already.
            lost: whether factors were removed, so that variables may have gone.
        """
        keys = list(result.getMarkedKeys())
        if lost:
            keys = [key for key in keys if self._isam.valueExists(key)]
        after, replaced = self._isam.calculateEstimate(keys), self._values.extract(keys)
        before.append(replaced)
        self._values.update(after)
        if new and len(keys) > len(new):
            replaced.update(after.extract(new))
        step = float(abs(replaced.localCoordinates(after).vector()).max()) if keys else 0.0
        self._steps.append(step)
        return step

    def _read_all(self) -> None:
        """Bring the whole estimate up to date."""
        if not self._current:
            self._values, self._current, self._since = self._isam.calculateEstimate(), True, 0

    def _verdict(self, handles: tuple[int, ...], step: float, steps: int) -> IncrementalResult:
        if step > self._limit:
            rising = len(self._steps) > _GROWING and all(a < b for a, b in itertools.pairwise(self._steps))
            if rising and step > 10 * self._steps[0]:
                message = f"steps grow, from {self._steps[0]:.1g} to {step:.1g}; start nearer, or use 'dogleg'"
                return IncrementalResult(Status.DIVERGED, message, handles, step)
            return IncrementalResult(Status.MAX_ITERATIONS, f"still moving, by {step:.1g}", handles, step)
        if self._trusts and (self._current or steps > 1):
            # A minimum, or a trust region that shrank to nothing?
            self._read_all()
            promised = predicted_decrease(self._graph(), self._values)
            if promised > max(_WORTHLESS, _SHARE * self.error() * bool(self._limit > self._tolerance)):
                message = f"no step lowers the error, though {promised:.2g} of {self.error():.3g} are to be won"
                return IncrementalResult(Status.STALLED, message, handles, step)
        message = f"converged: the last step moved nothing by more than {step:.1g}"
        return IncrementalResult(Status.CONVERGED, message, handles, step)

    def _not_updated(self, problem: BaseException) -> IncrementalResult:
        """The status of an update that threw; what is not the numbers' fault goes on to the caller."""
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
        """The state before an update that did not take place: one that threw leaves iSAM2 unusable.

        Args:
            before: its new variables, and what each of its steps replaced.
        """
        for replaced in reversed(before[1:]):
            self._values.update(replaced)
        for key in before[0].keys() if before else ():
            if self._values.exists(key):
                self._values.erase(key)
        self._isam = gtsam.ISAM2(self._parameters)
        if self._factors:
            slots = self._isam.update(self._graph(), self._values).getNewFactorsIndices()
            self._current = True
            self._slots = dict(zip(self._factors, slots, strict=True))


def _as_graph(factors: gtsam.NonlinearFactorGraph | Iterable[Any]) -> gtsam.NonlinearFactorGraph:
    if isinstance(factors, gtsam.NonlinearFactorGraph):
        return factors
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph
