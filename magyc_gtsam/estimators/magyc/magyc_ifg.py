"""MAGYC-IFG, the incremental method of the MAGYC paper (section III-C), run over a whole recording.

Every window of one second adds residual (7) and the norm prior (9) to iSAM2, which then makes one step. The same
method runs online in `OnlineCalibrator("magyc-ifg")`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.magyc.derivative_windows import derivative_windows
from magyc_gtsam.estimators.magyc.graph import MagycGraph
from magyc_gtsam.estimators.magyc.options import IncrementalOptions
from magyc_gtsam.estimators.magyc.state import limits_about
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.runners.status import Status


def calibrate_magyc_ifg(
    recording: Recording, *, progress: Callable[[float], None] | None = None, **chosen: Any
) -> Calibration:
    """Calibrate with MAGYC-IFG; `chosen` are `IncrementalOptions`.

    No covariance is reported; see `state.calibration_of`.

    Args:
        recording: with a gyroscope.
        progress: called with the share done, 0 to 1.

    Raises:
        MagycError: no gyroscope, an invalid option, too few windows, or no estimate at the end.
        KeyboardInterrupt: interrupted before the first estimate; a later interrupt ends with the current estimate.
    """
    options = IncrementalOptions(**chosen)
    report = progress or (lambda share: None)
    graph = MagycGraph(options)
    windows = derivative_windows(recording, options.window)
    count = len(windows.time)
    estimates = []
    for index, sample in enumerate(zip(*windows.in_gauss(), strict=True)):
        if graph.add(*sample).status is Status.INTERRUPTED:
            break
        estimates.append(graph.current())
        report((index + 1) / (count + 1))
    parameters = graph.estimate()
    if parameters is None and graph.result.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if parameters is None:
        raise MagycError(f"magyc-ifg: no estimate after {graph.message}")
    calibration = graph.calibration(
        parameters, recording, windows=count, settled_after=settled_after(estimates, recording)
    )
    report(1.0)
    return calibration


def settled_after(estimates: list[Array | None], recording: Recording) -> float:
    """Return the share of the updates after which the estimate stayed within the limits about the last one.

    The limits are those of `observability`: 5 % of the field for the hard iron, 5 % for the soft iron,
    15 mrad/s for the bias.
    """
    last = estimates[-1]
    if last is None:
        return 1.0
    limits = limits_about(last, recording.magnetometer.value)
    away = [e is None or bool((np.abs(e - last) > limits).any()) for e in estimates]
    return (int(np.flatnonzero(away)[-1]) + 1) / len(away) if any(away) else 0.0
