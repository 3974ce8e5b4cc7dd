"""MAGYC-BFG, the batch method of the MAGYC paper (section III-C): one state, all factors, one optimisation.

Each window of one second gives residual (7) on its averaged samples and the norm prior (9).
"""

from __future__ import annotations

from collections.abc import Callable

import gtsam

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.magyc.derivative_windows import derivative_windows
from magyc_gtsam.estimators.magyc.state import (
    KEYS,
    NAMES,
    MagycState,
    Prior,
    calibration_of,
    initial_values,
    scale_prior,
)
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.gyro_derivative import CompressedGyroDerivative, gyro_derivative_factor
from magyc_gtsam.factors.numbers import is_positive
from magyc_gtsam.recording import Recording
from magyc_gtsam.runners.batch import Method, optimize


def calibrate_magyc_bfg(
    recording: Recording,
    *,
    progress: Callable[[float], None] | None = None,
    field_strength: float | None = None,
    optimizer: Method = "dogleg",
    prior: Prior = "norm",
    window: float = 1.0,
    compressed: bool = False,
    residual_sigma: float = 1e-3,
    prior_sigma: float = 1e-2,
    tolerance: float = 1e-7,
    max_iterations: int = 1000,
) -> Calibration:
    """Calibrate with MAGYC-BFG.

    The paper gives no covariance, and none is reported: residual (7) has noise in its regressors, so that the
    estimate is biased and the graph's marginals are not its spread. They only show which parameters the motion leaves
    undetermined (`observability`); such a result does not count as converged.

    Args:
        recording: with a gyroscope.
        progress: called with the share done, 0 to 1, after each iteration; the number of iterations is a guess.
        field_strength: T, scales the soft iron; default det 1.
        optimizer: "dogleg" (the trust region of RISE, as in the paper), "lm" or "gauss-newton".
        prior: "norm" as in (9), or "determinant" as the authors' later package fixes it.
        window: s, over which samples are averaged.
        compressed: whether to compress all windows into one factor of 21 rows first; same estimate, faster.
        residual_sigma: of (7), gauss/s.
        prior_sigma: of (9), per window.
        tolerance: relative and absolute, on the graph's error.
        max_iterations: limit.

    Raises:
        MagycError: no gyroscope, an invalid option, or too few windows.
    """
    report = progress or (lambda share: None)
    for name, value in (
        ("residual_sigma", residual_sigma),
        ("prior_sigma", prior_sigma),
        ("tolerance", tolerance),
    ):
        if not is_positive(value):
            raise MagycError(f"{name}: must be finite and above 0, got {value!r}")
    windows = derivative_windows(recording, window)
    samples = windows.in_gauss()
    residuals = CompressedGyroDerivative.from_samples(*samples)

    # One factor holds the residuals (7) of all windows, and one of sigma/√n their equal priors (9).
    graph = gtsam.NonlinearFactorGraph()
    if compressed:
        graph.add(residuals.factor(*KEYS, residual_sigma))
    else:
        graph.add(gyro_derivative_factor(*KEYS, *samples, residual_sigma))
    graph.add(scale_prior(prior, prior_sigma, len(windows.time)))

    result = optimize(
        graph,
        initial_values(),
        optimizer,
        relative_tolerance=tolerance,
        absolute_tolerance=tolerance,
        max_iterations=max_iterations,
        progress=lambda iteration, error: report(iteration / (iteration + 2)),
        names=NAMES,
    )
    state = MagycState.of(result.values)
    calibration = calibration_of(
        state.parameters,
        state.covariance(residuals) if result.converged else None,
        recording,
        method="magyc-bfg",
        message=result.message,
        converged=result.converged,
        field_strength=field_strength,
        diagnostics={
            "status": str(result.status),
            "iterations": result.iterations,
            "error": min(result.errors),
            "windows": len(windows.time),
        },
        configuration={
            "optimizer": optimizer,
            "prior": prior,
            "window": window,
            "compressed": compressed,
            "residual_sigma": residual_sigma,
            "prior_sigma": prior_sigma,
            "tolerance": tolerance,
            "max_iterations": max_iterations,
            "field_strength": field_strength,
        },
    )
    report(1.0)
    return calibration
