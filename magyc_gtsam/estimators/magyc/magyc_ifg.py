"""MAGYC-IFG, the incremental method of the MAGYC paper (section III-C), run over a whole recording.

Every window of one second adds residual (7) and the norm prior (9) to iSAM2, which then makes one step. The same
method runs online in `OnlineCalibrator("magyc-ifg")`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.magyc.derivative_windows import derivative_windows
from magyc_gtsam.estimators.magyc.graph import MagycGraph
from magyc_gtsam.estimators.magyc.state import Prior, calibration_of
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.observability import GYRO_BIAS_LIMIT, HARD_IRON_LIMIT, SOFT_IRON_LIMIT
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.runners.isam import Method
from magyc_gtsam.runners.status import Status


def calibrate_magyc_ifg(
    recording: Recording,
    *,
    progress: Callable[[float], None] | None = None,
    field_strength: float | None = None,
    robust: str | None = None,
    optimizer: Method = "dogleg",
    prior: Prior = "norm",
    window: float = 1.0,
    compressed: bool = True,
    estimate: Literal["mean", "current"] = "mean",
    residual_sigma: float = 1e-3,
    prior_sigma: float = 1e-2,
) -> Calibration:
    """Calibrate with MAGYC-IFG.

    No covariance is reported; see `state.calibration_of`.

    Args:
        recording: with a gyroscope.
        progress: called with the share done, 0 to 1.
        field_strength: T, scales the soft iron; default det 1.
        robust: name of a kernel ("huber", "cauchy", "geman-mcclure", "l1") that weights each window, with
            `compressed=False` only. Its width is in units of `residual_sigma`, which must then be that of the data: √2
            times the magnetometer's noise over the window.
        optimizer: "dogleg" (RISE, as in the paper) or "gauss-newton".
        prior: "norm" as in (9), or "determinant" as the authors' later package fixes it.
        window: s, over which samples are averaged.
        compressed: whether to replace one exact factor at each update, in constant time; False keeps all factors in
            iSAM2 as published. The estimates are the same.
        estimate: "mean" of the last 20 % of the estimates, as in the paper, or the "current" one.
        residual_sigma: of (7), gauss/s.
        prior_sigma: of (9), per window.

    Raises:
        MagycError: no gyroscope, an invalid option, too few windows, or no estimate at the end.
        KeyboardInterrupt: interrupted before the first estimate; a later interrupt ends with the current estimate.
    """
    check_estimate(estimate)
    report = progress or (lambda share: None)
    graph = MagycGraph(
        compressed=compressed,
        optimizer=optimizer,
        prior=prior,
        residual_sigma=residual_sigma,
        prior_sigma=prior_sigma,
        robust=robust,
    )
    windows = derivative_windows(recording, window)
    count = len(windows.time)
    estimates = []
    for index, sample in enumerate(zip(*windows.in_gauss(), strict=True)):
        if graph.add(*sample).status is Status.INTERRUPTED:
            break
        estimates.append(graph.current())
        report((index + 1) / (count + 1))
    parameters = graph.mean() if estimate == "mean" else graph.current()
    if parameters is None and graph.result.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if parameters is None:
        raise MagycError(f"magyc-ifg: no estimate after {graph.message}")
    updated = graph.result.updated
    calibration = calibration_of(
        parameters,
        graph.state.covariance(graph.residuals) if updated else None,
        recording,
        method="magyc-ifg",
        message=graph.message,
        converged=updated,
        field_strength=field_strength,
        diagnostics={
            "status": str(graph.result.status),
            "windows": count,
            "settled_after": settled_after(estimates, recording),
        },
        configuration=graph.configuration
        | {"window": window, "estimate": estimate, "field_strength": field_strength},
    )
    report(1.0)
    return calibration


def check_estimate(estimate: str) -> None:
    """Raise `MagycError` unless `estimate` is "mean" or "current"."""
    if estimate not in ("mean", "current"):
        raise MagycError(f"estimate {estimate!r} unknown; there are mean, current")


def settled_after(estimates: list[Array | None], recording: Recording) -> float:
    """Return the share of the updates after which the estimate stayed within the limits about the last one.

    The limits are those of `observability`: 5 % of the field for the hard iron, 5 % for the soft iron,
    15 mrad/s for the bias.
    """
    last = estimates[-1]
    if last is None:
        return 1.0
    strength = float(np.median(np.linalg.norm(recording.magnetometer.value - last[6:9], axis=1)))
    limits = np.repeat([SOFT_IRON_LIMIT, HARD_IRON_LIMIT * strength, GYRO_BIAS_LIMIT], [6, 3, 3])
    away = [e is None or bool((np.abs(e - last) > limits).any()) for e in estimates]
    return (int(np.flatnonzero(away)[-1]) + 1) / len(away) if any(away) else 0.0
