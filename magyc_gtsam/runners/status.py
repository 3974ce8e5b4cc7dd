"""Status codes of an optimisation."""

from __future__ import annotations

from enum import Enum


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
