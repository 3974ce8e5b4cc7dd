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
from magyc_gtsam.factors.gyro_derivative import Samples, gyro_derivative_error
from magyc_gtsam.factors.soft_iron import SYMMETRIC_UNITS
from magyc_gtsam.observability import assess
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
    so that the estimate is biased and the graph's marginals are not its spread. They only serve to say
    what the motion left undetermined (`observability`); such a result does not count as converged.

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
        samples,
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
    samples, gyro_samples = stop - first, gyro_stop - gyro_first
    used = (samples >= max(2, 0.5 * np.median(samples))) & (gyro_samples >= max(1, 0.5 * np.median(gyro_samples)))
    first, stop, gyro_first, gyro_stop = first[used], stop[used], gyro_first[used], gyro_stop[used]
    if len(first) < 4:
        raise MagycError(
            f"{len(first)} windows of {length:g} s hold two or more samples of the magnetometer and one of "
            "the gyroscope, at least 4 are needed; record for longer, or choose a longer window"
        )
    span = mag.time[stop - 1] - mag.time[first]
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
    samples: Samples,
    field_strength: float | None,
    configuration: dict[str, object],
) -> Calibration:
    """C and d, whose scale (7) cannot know, to soft iron and hard iron."""
    l = result.values.atVector(INVERSE_SOFT_IRON)  # noqa: E741
    d = result.values.atVector(PSEUDO_HARD_IRON)
    b = result.values.atVector(GYRO_BIAS)
    c = unvech(l)
    determinant = float(np.linalg.det(c))
    if abs(determinant) < 1e-12 * np.linalg.norm(c) ** 3:
        raise MagycError(
            f"magyc-bfg: the inverse soft iron became singular ({result.message}); "
            "the motion does not determine it"
        )
    soft_iron = np.linalg.inv(c) * np.cbrt(determinant)  # det 1; (−C, −d) solves (7) as well
    hard_iron: Array = np.asarray(np.linalg.solve(c, d) * GAUSS, dtype=np.float64)
    field = np.linalg.solve(soft_iron, (recording.magnetometer.value - hard_iron).T)
    strength = float(np.linalg.norm(field, axis=0).mean())

    reasons, observability = [] if result.converged else [result.message], None
    if np.linalg.eigvalsh(soft_iron)[0] <= 0:
        reasons.append("the soft iron is not positive definite")
    elif result.converged:
        observability = assess(_covariance(samples, l, d, b), soft_iron, strength, recording)
        if not observability.observable:
            reasons.append(f"not observable: {observability.weak[0].sentence}")
    if field_strength is not None:
        soft_iron, strength = soft_iron * (strength / field_strength), field_strength
    return Calibration(
        soft_iron,
        hard_iron,
        b,
        converged=not reasons,
        message="; ".join(reasons) or result.message,
        method="magyc-bfg",
        field_strength=strength,
        observability=observability,
        diagnostics={
            "status": str(result.status),
            "iterations": result.iterations,
            "error": min(result.errors),
            "windows": len(samples[0]),
        },
        configuration=configuration,
    )


def _covariance(samples: Samples, l: Array, d: Array, b: Array) -> Array:  # noqa: E741
    """Of vech(A) at det A = 1, h in T and b, as if only the residuals (7) were noisy: (12, 12)."""
    residual, jacobians = gyro_derivative_error(samples, l, d, b, want_jacobians=True)
    jacobian = np.concatenate(jacobians, axis=2).reshape(-1, 12)
    variance = np.sum(residual**2) / max(residual.size - 12, 1)
    scale = np.concatenate([l, d, np.zeros(3)])  # the direction that (7) leaves free: determined exactly
    scale *= np.linalg.norm(jacobian) / (scale @ scale)
    graph = np.linalg.inv(jacobian.T @ jacobian + np.outer(scale, scale)) * variance

    # dA = A (tr(C⁻¹ dC)/3 − dC C⁻¹) at det A = 1, and dh = C⁻¹ (dd − dC h).
    inverse = np.linalg.inv(unvech(l))
    soft_iron, h = inverse / np.cbrt(np.linalg.det(inverse)), inverse @ d
    relative = SYMMETRIC_UNITS @ inverse
    trace = np.trace(relative, axis1=1, axis2=2) / 3
    mapping = np.zeros((12, 12))
    mapping[:6, :6] = vech(soft_iron @ (trace[:, None, None] * np.eye(3) - relative)).T
    mapping[6:9, :6] = -GAUSS * inverse @ (SYMMETRIC_UNITS @ h).T
    mapping[6:9, 6:9] = GAUSS * inverse
    mapping[9:, 9:] = np.eye(3)
    covariance: Array = mapping @ graph @ mapping.T
    return covariance
