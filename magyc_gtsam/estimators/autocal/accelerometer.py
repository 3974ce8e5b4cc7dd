"""Accelerometer self-calibration by `autocal` (Hong et al. 2020, section III-C): gravity in place of the field.

    acceleration = scale · true specific force + bias

Held still in many attitudes, an accelerometer measures gravity alone, so that its samples lie on an ellipsoid; samples
with motion are outliers. The rotation of `scale` is not observable, so it is symmetric; its size follows from gravity.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.calibration.serialization import expect_whole
from magyc_gtsam.closest_point import closest_points
from magyc_gtsam.estimators.autocal.autocal import OUTLIER, covariance
from magyc_gtsam.estimators.autocal.fit import AutocalFit, autocal
from magyc_gtsam.estimators.ellipsoid.m_estimate import time_blocks
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import UNKNOWNS, symmetric_root
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.kernels import kernel as kernel_of
from magyc_gtsam.factors.numbers import numbers
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.recording import Array, Mask, Recording, Samples
from magyc_gtsam.recording.expected import expect_progress, expect_recording
from magyc_gtsam.storage.files import expect_path, write_text
from magyc_gtsam.storage.mapping import dump_yaml, load_mapping

STANDARD_GRAVITY = 9.80665  # m/s²
_FORMAT = "magyc-gtsam accelerometer calibration 1"
_UNIT_LIMITS = (0.3, 3.0)  # median norm over gravity
_LEAST_TRUSTED = 0.3  # share of samples on the ellipsoid; most may be off it while a vehicle moves
_MOST_UNEXPLAINED = 0.1  # noise over gravity
_LARGEST_SIGMA = 0.02  # sigma of bias over gravity, and of scale: about a degree of tilt
_LARGEST = 0.3  # bias over gravity, and deviation of the scale from 1, of a working instrument


@dataclass(frozen=True, eq=False)
class AccelerometerCalibration:
    """Scale and bias of an accelerometer: acceleration = scale · specific force + bias.

    Attributes:
        scale: (3, 3) symmetric: scale factors and cross-axis sensitivity.
        bias: (3,) m/s².
        covariance: (9, 9) of vech(scale) row by row and bias; None if the samples do not determine them.
        gravity: m/s², the length of the calibrated acceleration at rest.
        noise: m/s² per sample and axis, motion included; samples beyond `limit` m/s² count as outliers.
        limit: m/s², see `noise`.
        converged: whether the result can be trusted.
        message: why the method stopped, or why the result must not be trusted.
        method: "autocal".
        diagnostics, configuration: numbers and options of the method.
    """

    scale: Array
    bias: Array
    covariance: Array | None = None
    gravity: float = STANDARD_GRAVITY
    noise: float = 0.0
    limit: float = float("inf")
    converged: bool = True
    message: str = ""
    method: str = "autocal"
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    configuration: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, shape in {"scale": (3, 3), "bias": (3,), "covariance": (9, 9)}.items():
            if name == "covariance" and self.covariance is None:
                continue
            array = numbers(name, getattr(self, name))
            if array.shape != shape or not np.isfinite(array).all():
                raise MagycError(f"{name} must be {shape} finite numbers, got {shortened(array.tolist())}")
            object.__setattr__(self, name, array)

    def apply(self, acceleration: ArrayLike) -> Array:
        """Return scale⁻¹ (acceleration − bias), of the shape (N, 3) or (3,) m/s² of the input."""
        result: Array = (np.asarray(acceleration, dtype=float) - self.bias) @ np.linalg.inv(self.scale).T
        return result

    @property
    def sigma(self) -> Mapping[str, Array]:
        """Standard deviations: scale (3, 3) and bias (3,) m/s²; empty without covariance."""
        if self.covariance is None:
            return {}
        deviation = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        scale = np.empty((3, 3))
        scale[np.triu_indices(3)] = scale.T[np.triu_indices(3)] = deviation[:6]
        return {"scale": scale, "bias": deviation[6:]}

    def inliers(self, acceleration: ArrayLike) -> Mask:
        """Return (N,) bool: the samples (N, 3) m/s² that measure gravity alone."""
        samples = np.asarray(acceleration, dtype=float).T
        mask: Mask = np.abs(closest_points(self.gravity * self.scale, self.bias, samples).distance) <= self.limit
        return mask

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as JSON types."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}
        return {"format": _FORMAT} | {k: dict(v) if isinstance(v, Mapping) else v for k, v in plain.items()}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write YAML, bit for bit, replacing the file in one step."""
        write_text(expect_path("save", path), dump_yaml(self.to_dict()))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> AccelerometerCalibration:
        """Read a file written by `save`.

        Raises:
            MagycError: the file does not exist, is cut off, or is not the calibration of an accelerometer.
        """
        data = load_mapping(expect_path("AccelerometerCalibration.load", path), "calibration of an accelerometer")
        if data.pop("format", None) != _FORMAT:
            raise MagycError(f"{path}: not the calibration of an accelerometer")
        try:
            expect_whole(data, [f.name for f in fields(cls)])
            return cls(**data)
        except MagycError as error:
            raise MagycError(f"{path}: {error}") from None
        except (TypeError, ValueError) as error:
            raise MagycError(f"{path}: a damaged calibration ({shortened(error)})") from None


def accelerometer_samples(recording: Recording) -> Samples:
    """Return the accelerometer's own samples, at the stamps of the gyroscope on the same chip, without repeats.

    Raises:
        MagycError: the recording has no accelerometer.
    """
    if recording.acceleration is None:
        raise MagycError(
            f"recording {recording.name!r} has no acceleration; name the accelerometer's topic or columns"
        )
    rows = recording.magnetic_field_fresh if recording.angular_rate is None else recording.angular_rate_fresh
    time, value = recording.time[rows], recording.acceleration[rows]
    own = np.append(True, (np.diff(value, axis=0) != 0).any(axis=1))
    return Samples(time[own], value[own])


def calibrate_accelerometer(
    recording: Recording,
    *,
    gravity: float = STANDARD_GRAVITY,
    noise: float | None = None,
    kernel: str = "cauchy",
    progress: Callable[[float], None] | None = None,
) -> AccelerometerCalibration:
    """Calibrate the accelerometer with gravity, robustly against motion.

    Args:
        recording: with an accelerometer that was held, or turned slowly, in attitudes all over the sphere.
        gravity: m/s², at the place of the recording.
        noise: m/s² per sample and axis; None estimates it, motion included.
        kernel: "cauchy", "huber", "l1" or "geman-mcclure".
        progress: called with the share done, 0 to 1.

    Raises:
        MagycError: no accelerometer, too few samples, a wrong unit, or samples that do not lie on an ellipsoid.
    """
    expect_recording("mg.calibrate_accelerometer", recording)
    expect_progress(progress)
    report = progress or (lambda _: None)
    report(0.0)
    kernel_of(kernel)
    for name, number, low, high in (("gravity", gravity, 9.7, 9.9), ("noise", noise, 0.0, 9.7)):
        if number is None and name == "noise":
            continue
        if isinstance(number, bool) or not isinstance(number, (int, float)) or not low < number < high:
            raise MagycError(
                f"{name} of the accelerometer: must be between {low:g} and {high:g} m/s², got {number!r}"
            )
    time, samples = accelerometer_samples(recording)
    _check(samples, gravity)
    try:
        fit = autocal(samples, kernel, sigma=noise)
    except MagycError:
        raise MagycError(
            "acceleration: too little motion, the samples do not lie on an ellipsoid: hold the instrument still "
            "in six or more attitudes, or turn it slowly all over"
        ) from None
    known = covariance(fit, kernel, time_blocks(time))
    if known is not None:
        known[:6] /= gravity
        known[:, :6] /= gravity
    scale = symmetric_root(fit.matrix) / gravity
    within = np.abs(fit.distance) <= OUTLIER * fit.width
    reasons = _reasons(fit, known, scale, gravity, float(within.mean()))
    report(1.0)
    return AccelerometerCalibration(
        scale=scale,
        bias=fit.offset,
        covariance=known,
        gravity=gravity,
        noise=fit.sigma,
        limit=OUTLIER * fit.width,
        converged=not reasons,
        message="; ".join(reasons) or fit.message,
        diagnostics={
            "samples": len(samples),
            "outliers": int((~within).sum()),
            "iterations": fit.iterations,
            "cost": fit.cost,
        },
        configuration={"gravity": gravity, "kernel": kernel, "noise": noise},
    )


def _check(samples: Array, gravity: float) -> None:
    if len(samples) <= UNKNOWNS:
        raise MagycError(
            f"acceleration: {len(samples)} samples, more than {UNKNOWNS} are needed for as many parameters"
        )
    norm = float(np.median(np.linalg.norm(samples, axis=1)))
    low, high = _UNIT_LIMITS
    if not low * gravity < norm < high * gravity:
        likely = "; likely unit: g" if low < norm < high else ""
        raise MagycError(
            f"acceleration: median norm {norm:.4g} is not gravity in m/s² ({gravity:g}){likely}; convert it, or read "
            "it in its unit (acceleration_unit=)"
        )
    extent = np.linalg.svd(samples - samples.mean(axis=0), compute_uv=False) / np.sqrt(len(samples))
    if not extent[2] > 1e-3 * gravity:
        raise MagycError(
            f"acceleration: too little motion, the samples deviate by {extent[2]:.2g} m/s² along their flattest axis "
            f"(at least {1e-3 * gravity:.2g}): hold the instrument in attitudes all over the sphere"
        )


def _reasons(fit: AutocalFit, known: Array | None, scale: Array, gravity: float, trusted: float) -> list[str]:
    """Return the reasons not to trust the result; empty if there are none."""
    remedy = "hold it still in six or more attitudes, or turn it slowly all over"
    reasons: list[str] = []
    if known is None:
        reasons.append(f"too little motion, the attitudes leave the parameters undetermined: {remedy}")
    else:
        for what, block, unit, size in (
            ("bias", known[6:, 6:], " m/s²", gravity),
            ("scale", known[:6, :6] * 1e4, " %", 1e2),
        ):
            sigma, limit = float(np.sqrt(np.linalg.eigvalsh(block)[-1])), _LARGEST_SIGMA * size
            if sigma > limit and not reasons:
                reasons.append(f"too little motion, {what} ±{sigma:.2g}{unit} (limit {limit:.2g}): {remedy}")
    away = float(np.abs(np.linalg.eigvalsh(scale) - 1).max())
    bias = float(np.linalg.norm(fit.offset)) / gravity
    if not reasons and max(away, bias) > _LARGEST:
        reasons.append(
            f"no instrument has a scale off by {away:.0%} and a bias of {bias:.0%} of gravity (limit {_LARGEST:.0%}): "
            f"it was moved too fast or too little; {remedy}"
        )
    if fit.sigma > _MOST_UNEXPLAINED * gravity:
        reasons.append(
            f"motion leaves {fit.sigma:.2g} m/s² unexplained (limit {_MOST_UNEXPLAINED * gravity:.2g}): {remedy}"
        )
    if trusted < _LEAST_TRUSTED:
        reasons.append(
            f"{1 - trusted:.0%} of the samples are motion, at most {1 - _LEAST_TRUSTED:.0%} is tolerated"
        )
    if not fit.converged:
        reasons.append(fit.message)
    return reasons
