"""`autocal`: autocalibration of a magnetometer, robust against disturbed samples (Hong, Kang and Kim 2020).

The two stages are in `autocal.fit`, the same problem as a GTSAM graph in `autocal.graph`. This module has the
covariance, the classification of samples, and the entry point of the registry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.closest_point import closest_points
from magyc_gtsam.estimators.autocal.fit import WIDTH, AutocalFit, autocal, noise_of, relative_width
from magyc_gtsam.estimators.ellipsoid.m_estimate import (
    Blocks,
    distance_jacobian,
    l1_curvature,
    m_covariance,
    time_blocks,
)
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import Ellipsoid, normalised_field, to_calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.kernels import KERNELS
from magyc_gtsam.factors.kernels import kernel as kernel_of
from magyc_gtsam.recording import Array, Mask, Recording

Solver = Literal["array", "graph"]

OUTLIER = 5.0  # widths τ from which a sample counts as an outlier (Table III)
_LEAST_TRUSTED = 0.5  # share of inliers below which the result must not be trusted


def covariance(fit: AutocalFit, kernel_name: str, blocks: Blocks | None = None) -> Array | None:
    """Return the covariance (9, 9) of vech(√(K Kᵀ)) and b of a fit; None if the samples do not determine them.

    `kernel_name` is the kernel of the fit, and `blocks` is as in `m_covariance`.
    """
    rho, tuning = KERNELS[kernel_name], relative_width(kernel_name, fit.width / fit.sigma)
    e = np.abs(fit.distance) / fit.sigma
    flat = kernel_name == "l1"
    return m_covariance(
        distance_jacobian(fit.matrix, fit.direction, fit.normal),
        rho.weight(e, tuning) * fit.distance,
        l1_curvature(fit.distance, fit.sigma) if flat else rho.curvature(e, tuning),
        blocks,
    )


def inliers(data: Recording | ArrayLike, calibration: Calibration, limit: float | None = None) -> Mask:
    """Return which samples lie on the ellipsoid of a calibration of any method, as in Fig. 7 of the paper.

    Args:
        data: a recording, whose magnetometer samples (`recording.magnetometer`) are classified, or (n, 3) T.
        calibration: the ellipsoid soft_iron · field_strength · x̂ + hard_iron.
        limit: T, largest distance from the ellipsoid of an inlier; None takes 5 √3 times the noise per axis
            (Table III of the paper), from `calibration.noise` or else from the samples' median distance.

    Returns:
        (n,) bool, True for inliers.
    """
    samples = data.magnetometer.value if isinstance(data, Recording) else np.asarray(data, dtype=float)
    strength = calibration.field_strength
    if strength is None:
        strength = float(np.median(np.linalg.norm(calibration.apply(samples), axis=1)))
    distance = closest_points(strength * calibration.soft_iron, calibration.hard_iron, samples.T).distance
    if limit is None:
        noise = calibration.noise.get("magnetic_field", noise_of(distance))
        limit = OUTLIER * WIDTH * max(noise, 1e-9 * strength)  # rounding is not a disturbance
    mask: Mask = np.abs(distance) <= limit
    return mask


def calibrate_autocal(
    recording: Recording,
    *,
    field_strength: float | None = None,
    noise: tuple[float, float] | None = None,
    kernel: str = "cauchy",
    width: float | None = None,
    solver: Solver = "array",
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Calibrate the magnetometer alone, robustly against disturbed samples.

    Args:
        recording: with a magnetometer.
        field_strength: T, strength of the true field; None: det soft iron = 1.
        noise: (magnetometer T, not used) per sample; None estimates it.
        kernel: "cauchy" (the paper's choice), "huber", "l1" or "geman-mcclure".
        width: T, τ of the kernel; None takes √3 times the noise, the paper's choice in its units.
        solver: "array", or "graph" for a refinement by GTSAM (for checks; minutes for thousands of samples).
        progress: called with the share done, 0 to 1.

    Raises:
        MagycError: too few samples, no spread along an axis, or samples that do not lie on an ellipsoid.
    """
    report = progress or (lambda _: None)
    _check_options(kernel, width, solver)
    report(0.0)
    samples = normalised_field(recording)
    sigma = None if noise is None else noise[0] / samples.unit
    relative = None if width is None else width / samples.unit
    fit = autocal(samples.value, kernel, sigma=sigma, width=relative)
    if solver == "graph":
        from magyc_gtsam.estimators.autocal.graph import refine_graph

        fit = refine_graph(samples.value, fit.matrix, fit.offset, kernel, sigma=fit.sigma, width=fit.width)
    within = np.abs(fit.distance) <= OUTLIER * fit.width
    reasons = [] if fit.converged else [fit.message]
    if within.mean() < _LEAST_TRUSTED:
        reasons.append(
            f"{1 - within.mean():.0%} of the samples are outliers, at most {1 - _LEAST_TRUSTED:.0%} is tolerated"
        )
    configuration = {"kernel": kernel, "width": width, "solver": solver}
    result = to_calibration(
        recording,
        samples,
        Ellipsoid(
            fit.matrix,
            fit.offset,
            not reasons,
            "; ".join(reasons) or fit.message,
            covariance=covariance(fit, kernel, time_blocks(recording.magnetometer.time)),
            weights=within.astype(float),
            radial=False,
            diagnostics={
                "iterations": fit.iterations,
                "cost": fit.cost,
                "outliers": int((~within).sum()),
                "trusted_share": float(within.mean()),
                "kernel_width": fit.width * samples.unit,
            },
        ),
        method="autocal",
        field_strength=field_strength,
        configuration=configuration | ({} if noise is None else {"noise": list(noise)}),
    )
    report(1.0)
    return replace(result, noise={"magnetic_field": fit.sigma * samples.unit})


def _check_options(kernel_name: Any, width: Any, solver: Any) -> None:
    kernel_of(kernel_name)
    if solver not in get_args(Solver):
        raise MagycError(f"solver: {solver!r} is not one of {', '.join(get_args(Solver))}")
    if width is not None and (
        isinstance(width, bool) or not isinstance(width, (int, float)) or not 0 < width < 1e-3
    ):
        raise MagycError(f"width: must be above 0 and below 1e-3 T, got {width!r}")
