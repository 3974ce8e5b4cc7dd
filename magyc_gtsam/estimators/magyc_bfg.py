"""MAGYC-BFG, the batch method of the MAGYC paper (section III-C): one state, all factors, one optimisation.

Each window of one second gives residual (7) on its averaged samples and the norm prior (9). Inside, the
field is in gauss, so that the paper's sigmas and tolerances mean what they meant there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import gtsam
import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors import (
    CompressedGyroDerivative,
    MagycError,
    determinant_prior,
    gyro_derivative_factor,
    norm_prior,
    unvech,
    vech,
)
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.runners.batch import BatchResult, Method, optimize

GAUSS = 1e-4  # T
INVERSE_SOFT_IRON, PSEUDO_HARD_IRON, GYRO_BIAS = KEYS = [gtsam.symbol(c, 0) for c in "ldb"]
NAMES = dict(zip(KEYS, ("the soft iron", "the hard iron", "the gyroscope bias"), strict=True))


class DerivativeWindows(NamedTuple):
    """Averages over windows: time (n,) s, field (n, 3) T, its derivative (n, 3) T/s, rate (n, 3) rad/s."""

    time: Array
    magnetic_field: Array
    derivative: Array
    angular_rate: Array


def calibrate_magyc_bfg(
    recording: Recording,
    *,
    progress: Callable[[float], None] | None = None,
    field_strength: float | None = None,
    optimizer: Method = "dogleg",
    prior: Literal["norm", "determinant"] = "norm",
    window: float = 1.0,
    compressed: bool = False,
    residual_sigma: float = 1e-3,
    prior_sigma: float = 1e-2,
    tolerance: float = 1e-7,
    max_iterations: int = 1000,
) -> Calibration:
    """Calibrate with MAGYC-BFG.

    The paper gives no covariance, and none is reported: residual (7) has the noise in its regressors,
    so that the graph's marginals would not be those of the estimate.

    Args:
        recording: with a gyroscope.
        progress: called with the share done, 0 to 1, after each iteration; how many it takes is a guess.
        field_strength: T, scales the soft iron; default det 1.
        optimizer: "dogleg" (the trust region of RISE, as in the paper), "lm" or "gauss-newton".
        prior: "norm" as in (9), or "determinant" as the authors' later package fixes it.
        window: s, over which samples are averaged.
        compressed: fold all windows into one factor of 21 rows first; the same estimate, sooner.
        residual_sigma: of (7), gauss/s.
        prior_sigma: of (9), per window.
        tolerance: relative and absolute, on the graph's error.
        max_iterations: limit.

    Raises:
        MagycError: no gyroscope, an option that is wrong, or too few windows.
    """
    priors = {"norm": norm_prior, "determinant": determinant_prior}
    if prior not in priors:
        raise MagycError(f"prior {prior!r} unknown; there are {', '.join(priors)}")
    report = progress or (lambda share: None)
    windows = derivative_windows(recording, window)
    samples = windows.magnetic_field / GAUSS, windows.derivative / GAUSS, windows.angular_rate

    # All windows' residuals (7) stand in one factor, and their equal priors (9) in one of sigma/√n.
    graph = gtsam.NonlinearFactorGraph()
    if compressed:
        graph.add(CompressedGyroDerivative.from_samples(*samples).factor(KEYS, residual_sigma))
    else:
        graph.add(gyro_derivative_factor(KEYS, *samples, residual_sigma))
    graph.add(priors[prior](INVERSE_SOFT_IRON, prior_sigma / np.sqrt(len(windows.time))))

    initial = gtsam.Values()
    initial.insert(INVERSE_SOFT_IRON, vech(np.eye(3)))
    initial.insert(PSEUDO_HARD_IRON, np.zeros(3))
    initial.insert(GYRO_BIAS, np.zeros(3))
    result = optimize(
        graph,
        initial,
        optimizer,
        relative_tolerance=tolerance,
        absolute_tolerance=tolerance,
        max_iterations=max_iterations,
        progress=lambda iteration, error: report(iteration / (iteration + 2)),
        names=NAMES,
    )
    calibration = _calibration(
        result,
        recording,
        len(windows.time),
        field_strength,
        {
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


def derivative_windows(recording: Recording, length: float = 1.0) -> DerivativeWindows:
    """Average both sensors over windows of `length` seconds, and the field's differences inside them.

    The mean of ṁ over a window is (last − first sample)/(their time). Windows whose magnetometer samples
    cover less than half of it, or without a gyroscope sample, are left out.

    Raises:
        MagycError: no gyroscope, or fewer than 4 windows (12 unknowns, 3 equations each).
    """
    if not (np.isfinite(length) and length > 0):
        raise MagycError(f"window of {length} s; it must be finite and above 0")
    mag, gyro = recording.magnetometer, recording.gyroscope
    rate = gyro.value
    if recording.angular_rate_is == "interval-mean":  # to the value at the stamp, between two intervals
        rate = np.vstack([0.5 * (rate[:-1] + rate[1:]), rate[-1:]])

    start = max(mag.time[0], gyro.time[0])
    count = int((min(mag.time[-1], gyro.time[-1]) - start) / length + 1e-6) + 1
    edges = start + length * (np.arange(count + 1) - 1e-6)  # stamps on an edge belong to what follows
    first, stop = np.searchsorted(mag.time, edges[:-1]), np.searchsorted(mag.time, edges[1:])
    gyro_first, gyro_stop = np.searchsorted(gyro.time, edges[:-1]), np.searchsorted(gyro.time, edges[1:])
    used = (stop - first >= 2) & (gyro_stop > gyro_first)
    first, stop, gyro_first, gyro_stop = first[used], stop[used], gyro_first[used], gyro_stop[used]
    span = mag.time[stop - 1] - mag.time[first]
    long = span >= 0.5 * length
    first, stop, gyro_first, gyro_stop, span = (x[long] for x in (first, stop, gyro_first, gyro_stop, span))
    if len(first) < 4:
        raise MagycError(
            f"{len(first)} windows of {length:g} s hold samples of both sensors over half their length, "
            "at least 4 are needed; record for longer, or choose a window of several samples"
        )
    return DerivativeWindows(
        _means(mag.time[:, None], first, stop)[:, 0],
        _means(mag.value, first, stop),
        (mag.value[stop - 1] - mag.value[first]) / span[:, None],
        _means(rate, gyro_first, gyro_stop),
    )


def _means(values: Array, first: np.ndarray, stop: np.ndarray) -> Array:
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    return (sums[stop] - sums[first]) / (stop - first)[:, None]


def _calibration(
    result: BatchResult,
    recording: Recording,
    windows: int,
    field_strength: float | None,
    configuration: dict[str, object],
) -> Calibration:
    """C and d, whose scale (7) cannot know, to soft iron and hard iron."""
    c = unvech(result.values.atVector(INVERSE_SOFT_IRON))
    d = result.values.atVector(PSEUDO_HARD_IRON)
    determinant = float(np.linalg.det(c))
    if abs(determinant) < 1e-12 * np.linalg.norm(c) ** 3:
        raise MagycError(
            f"magyc-bfg: the inverse soft iron became singular ({result.message}); "
            "the motion does not determine it"
        )
    hard_iron: Array = GAUSS * np.linalg.solve(c, d)
    soft_iron = np.linalg.inv(c) * np.cbrt(determinant)  # det 1; (−C, −d) solves (7) as well
    field = np.linalg.solve(soft_iron, (recording.magnetometer.value - hard_iron).T)
    strength = float(np.linalg.norm(field, axis=0).mean())
    if field_strength is not None:
        soft_iron *= strength / field_strength
    positive = bool((np.linalg.eigvalsh(soft_iron) > 0).all())
    message = result.message if positive else f"the soft iron is not positive definite; {result.message}"
    return Calibration(
        soft_iron,
        hard_iron,
        result.values.atVector(GYRO_BIAS),
        converged=result.converged and positive,
        message=message,
        method="magyc-bfg",
        field_strength=strength if field_strength is None else field_strength,
        diagnostics={
            "status": str(result.status),
            "iterations": result.iterations,
            "error": min(result.errors),
            "windows": windows,
        },
        configuration=configuration,
    )
