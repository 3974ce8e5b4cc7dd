"""The reason why an optimisation ended, and the convergence test of an incremental one from its last steps."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Literal


class Status(str, Enum):
    """The reason why an optimisation ended."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "max-iterations"
    DIVERGED = "diverged"  # each step is larger than the one before
    STALLED = "stalled"  # no step lowers the error, although it is not at a minimum
    INDETERMINATE = "indeterminate"  # a variable is not determined by the data
    FAILED = "failed"  # error, residual or Jacobian not finite
    INTERRUPTED = "interrupted"

    __str__ = str.__str__


Method = Literal["dogleg", "gauss-newton"]  # of an incremental optimisation

_GROWING = 4  # consecutive steps, each larger than the one before, that count as divergence
_SHARE = 0.01  # share of the error by which a step may still lower it where small changes are not relinearised
_WORTHLESS = 1e-6  # decrease of the error (half squared sigmas) that is not worth a step


@dataclass(frozen=True, eq=False)
class IncrementalResult:
    """The result of one `Incremental.update`.

    Attributes:
        status: CONVERGED if the last step moved no variable that existed before by more than the tolerance or the
            relinearisation threshold, MAX_ITERATIONS if one still moves (the next update continues), DIVERGED if the
            steps grow, STALLED if no step lowers the error away from a minimum. With any other status the update did
            not take place.
        message: the status as a sentence, with its numbers and a remedy.
        factors: handles of the added factors, in their order.
        step: largest change of a variable in the last step, in its own units, among those that the update touched and
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


class Convergence:
    """The last steps of an incremental optimisation, and the test whether they converge.

    Args:
        method, tolerance, relinearize_threshold: as in `Incremental`.
    """

    def __init__(self, method: Method, tolerance: float, relinearize_threshold: float) -> None:
        self._limit = max(tolerance, relinearize_threshold)
        self._partial = relinearize_threshold > tolerance  # small changes are not relinearised
        # A short step alone proves no minimum: a trust region may have shrunk.
        self._tests_minimum = method == "dogleg" or not self._partial
        self._steps: deque[float] = deque(maxlen=_GROWING + 1)

    def record(self, step: float) -> None:
        """Record the largest change of a variable in a step."""
        self._steps.append(step)

    def result(
        self, handles: tuple[int, ...], step: float, prediction: Callable[[], tuple[float, float]] | None
    ) -> IncrementalResult:
        """Return the result of an update that took place.

        Args:
            handles: handles of its factors.
            step: largest change of a variable in its last step.
            prediction: computes the error's predicted decrease and the error; None to omit the test for a minimum.
        """
        if step > self._limit:
            rising = len(self._steps) > _GROWING and all(a < b for a, b in itertools.pairwise(self._steps))
            if rising and step > 10 * self._steps[0]:
                message = f"steps grow, from {self._steps[0]:.1g} to {step:.1g}; start nearer, or use 'dogleg'"
                return IncrementalResult(Status.DIVERGED, message, handles, step)
            return IncrementalResult(Status.MAX_ITERATIONS, f"still moving, by {step:.1g}", handles, step)
        if self._tests_minimum and prediction is not None:
            predicted, error = prediction()
            if predicted > max(_WORTHLESS, _SHARE * error * self._partial):
                message = (
                    f"no step lowers the error, although a fall by {predicted:.2g} from {error:.3g} is predicted"
                )
                return IncrementalResult(Status.STALLED, message, handles, step)
        message = f"converged: the last step moved nothing by more than {step:.1g}"
        return IncrementalResult(Status.CONVERGED, message, handles, step)
