"""Batch optimisation of any GTSAM graph, with a result that states why it stopped and whether it converged.

GTSAM's own `optimize()` blocks the interpreter for its whole run, returns the initial values when a residual is NaN,
counts a failed step as convergence, and with Levenberg–Marquardt does not notice an undetermined variable. This module
runs the iterations one by one and checks the final state.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import gtsam
import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import NonFiniteError
from magyc_gtsam.factors.solver import predicted_decrease
from magyc_gtsam.factors.warm_up import narrow, robust_blocks
from magyc_gtsam.runners.status import Status

Method = Literal["lm", "dogleg", "gauss-newton"]
Progress = Callable[[int, float], None]

_OPTIMIZERS = {
    "lm": (gtsam.LevenbergMarquardtOptimizer, gtsam.LevenbergMarquardtParams),
    "dogleg": (gtsam.DoglegOptimizer, gtsam.DoglegParams),
    "gauss-newton": (gtsam.GaussNewtonOptimizer, gtsam.GaussNewtonParams),
}


@dataclass(frozen=True, eq=False)
class BatchResult:
    """The result of `optimize`.

    Attributes:
        values: values of the lowest error; the initial ones if no iteration lowered it.
        status: why the optimisation ended.
        message: the status as a sentence, with its numbers and a remedy.
        iterations: number of iterations.
        errors: GTSAM's error, half the sum of squared whitened residuals, at the start and after each
            iteration.
    """

    values: gtsam.Values
    status: Status
    message: str
    iterations: int
    errors: tuple[float, ...]

    @property
    def converged(self) -> bool:
        """Whether the stopping rule was met at a minimum that the data determine."""
        return self.status is Status.CONVERGED


def optimize(
    graph: gtsam.NonlinearFactorGraph,
    initial: gtsam.Values,
    method: Method = "lm",
    *,
    relative_tolerance: float = 1e-7,
    absolute_tolerance: float = 1e-7,
    max_iterations: int = 100,
    progress: Progress | None = None,
    names: Mapping[int, str] | None = None,
) -> BatchResult:
    """Minimise the error of a graph.

    A kernel inside a block of samples starts as wide as the blocks' misfit and narrows whenever a minimum is reached
    (`kernels.narrowed`), so that a wrong start does not make every sample an outlier. A kernel in a noise model of
    GTSAM keeps its width.

    Args:
        graph, initial: the problem; `initial` holds every key of the graph and is not changed.
        method: "lm" (Levenberg–Marquardt), "dogleg" (Powell's, the trust region of RISE) or "gauss-newton". Dogleg
            stops at a step of 1e-5, so variables should be scaled to about 1.
        relative_tolerance, absolute_tolerance: the optimisation ends when an iteration lowers the error by less than
            this share of the error or this amount, whichever is larger.
        max_iterations: largest number of iterations.
        progress: called with (iteration, error) after each iteration; a KeyboardInterrupt raised in it, as by Ctrl-C,
            ends the optimisation with the best values.
        names: names of keys for messages.

    Raises:
        MagycError: the method is unknown, keys have no initial value, or a factor's error function returns a wrong
            shape. Numerical failures are reported by the status, not by an exception.
    """
    if method not in _OPTIMIZERS:
        raise MagycError(f"optimizer {method!r} unknown; there are {', '.join(_OPTIMIZERS)}")
    keys = graph.keyVector()
    missing = [key for key in keys if not initial.exists(key)]
    if missing:
        raise MagycError(f"no initial value for {', '.join(called(key, names) for key in missing)}")
    blocks = robust_blocks(graph.at(i) for i in range(graph.size()))
    narrow(blocks, initial)
    tolerances = relative_tolerance, absolute_tolerance
    result = _minimised(graph, initial, method, *tolerances, max_iterations, progress, names)
    while result.status in (Status.CONVERGED, Status.STALLED) and narrow(blocks, result.values):
        left = max_iterations - result.iterations
        step = _minimised(graph, result.values, method, *tolerances, left, progress, names, result.iterations)
        result = replace(
            step, iterations=result.iterations + step.iterations, errors=result.errors + step.errors[1:]
        )
    return result


def _minimised(
    graph: gtsam.NonlinearFactorGraph,
    initial: gtsam.Values,
    method: Method,
    relative_tolerance: float,
    absolute_tolerance: float,
    max_iterations: int,
    progress: Progress | None,
    names: Mapping[int, str] | None,
    before: int = 0,
) -> BatchResult:
    """Minimise the error with the kernels as they are, after `before` iterations with wider ones."""
    best = initial
    errors: list[float] = []

    def result(status: Status, message: str) -> BatchResult:
        return BatchResult(best, status, message, max(len(errors) - 1, 0), tuple(errors))

    def tolerance() -> float:
        return max(absolute_tolerance, relative_tolerance * min(errors))

    try:
        errors.append(graph.error(initial))
        if not np.isfinite(errors[0]):
            return result(Status.FAILED, f"the error is {errors[0]} at the initial values")
        optimizer_type, parameters_type = _OPTIMIZERS[method]
        parameters = parameters_type()
        # Levenberg–Marquardt also ends its search for a damping by these tolerances, too early by default.
        parameters.setRelativeErrorTol(relative_tolerance)
        parameters.setAbsoluteErrorTol(absolute_tolerance)
        optimizer = optimizer_type(graph, initial, parameters)
        decrease = np.inf
        while decrease > tolerance():
            if len(errors) > max_iterations:
                return result(
                    Status.MAX_ITERATIONS,
                    f"not converged after {before + max_iterations} iterations{_last(errors)}; allow more iterations",
                )
            optimizer.iterate()
            errors.append(optimizer.error())
            if not np.isfinite(errors[-1]):
                return result(
                    Status.FAILED, f"the error became {errors[-1]} in iteration {before + len(errors) - 1}"
                )
            decrease = min(errors[:-1]) - errors[-1]
            if decrease > 0:
                best = gtsam.Values(optimizer.values())  # a copy: the next iteration frees the original
            if progress is not None:
                progress(before + len(errors) - 1, errors[-1])
        # The full Gauss–Newton step distinguishes a minimum from a failed step; solving for it also finds
        # undetermined variables, which damping hides.
        predicted = predicted_decrease(graph, best)
        if decrease <= 0 and predicted > tolerance():
            return result(
                Status.STALLED,
                f"{_obstacle(optimizer)}, although a fall by {predicted:.2g} from {min(errors):.3g} is predicted",
            )
        return result(Status.CONVERGED, f"converged in {before + len(errors) - 1} iterations{_last(errors)}")
    except KeyboardInterrupt:
        return result(
            Status.INTERRUPTED,
            f"interrupted in iteration {before + len(errors)}; the best values so far are returned",
        )
    except NonFiniteError as problem:
        return result(Status.FAILED, str(problem))
    except RuntimeError as problem:
        key = undetermined(problem)
        if key is None:
            raise
        return result(
            Status.INDETERMINATE,
            f"{called(key, names)} is not determined by the data; move more, or add a prior",
        )


def undetermined(problem: RuntimeError) -> int | None:
    """Return the key that GTSAM could not eliminate; None for any other error."""
    key = re.search(r"Indeterminate linear system.*?(\d+)", str(problem), re.DOTALL)
    return None if key is None else int(key[1])


def called(key: int, names: Mapping[int, str] | None) -> str:
    """Return a key's name for messages: the caller's name, or GTSAM's."""
    return (names or {}).get(key) or str(gtsam.DefaultKeyFormatter(key))


def _obstacle(optimizer: Any) -> str:
    if isinstance(optimizer, gtsam.LevenbergMarquardtOptimizer):
        return f"no step lowers the error, with damping up to {optimizer.lambda_():.0e}"
    if isinstance(optimizer, gtsam.DoglegOptimizer):
        return f"no step lowers the error, with a trust region down to {optimizer.getDelta():.0e}"
    return "the undamped step raises the error (use 'lm' or 'dogleg')"


def _last(errors: list[float]) -> str:
    if len(errors) < 2:
        return ""
    return f"; the last one changed the error by {errors[-1] - errors[-2]:.1g} to {errors[-1]:.6g}"
