"""SAR-KF: the hard iron by a Kalman filter on a field that rotates with the gyroscope.

G. Troni and L. L. Whitcomb, "Field sensor bias calibration with angular-rate sensors: theory and experimental
evaluation with application to magnetometer calibration", IEEE/ASME Trans. Mechatronics 24(4), 2019, section
IV-B: the state is field and hard iron, with ṁ = −ω × (m − h) and ḣ = 0, and no signal is differentiated. The
published equations were not available; the following is derived from that model.

The state here is v = R_k (m − h), the field rotated back to the first sample's axes by the gyroscope, and h. In these
coordinates the state is constant, v' = v and h' = h, exactly and for any rotation between samples, and the measurement
is m_k = R_kᵀ v + h. The error of the gyroscope is the process noise of v. The model is linear, so the last estimate is
the best one and does not depend on the start; it depends on the ratio of the two noise levels only. The paper leaves
this ratio to be tuned; here it maximises the likelihood of the innovations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.hard_iron.turning import TurningField, to_calibration, turning_field, windows
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_finite
from magyc_gtsam.recording import Array, Recording

_SENSOR = 0.01  # noise per sample assumed by the filter, as a share of the field strength; only the ratio matters
_WIDE = 10.0  # standard deviation of the initial state, in units of the field strength
_TUNED_ON = 2000  # evenly spaced samples used to find the ratio of the noise levels
_RATIOS = (-4.0, 3.0)  # bounds of log10(process noise of v in a second / noise of a sample)
_SETTLING = 6  # initial samples whose innovations depend on the start and do not count
_REPORT = 2000  # samples between two calls of the progress callback


class Filtered(NamedTuple):
    """The final state of the filter, and statistics of the innovations.

    Attributes:
        state: (6,) v and h; covariance: (6, 6).
        square: mean of νᵀ S⁻¹ ν per axis, 1 if the noise levels are right.
        log_determinant: mean of log |S| per axis.
    """

    state: Array
    covariance: Array
    square: float
    log_determinant: float


def calibrate_sar_kf(
    recording: Recording,
    *,
    progress: Callable[[float], None] | None = None,
    field_strength: float | None = None,
    noise: tuple[float, float] | None = None,
    drift: float = 0.0,
) -> Calibration:
    """Calibrate with SAR-KF: hard iron only, soft iron a multiple of the identity, gyroscope without bias.

    Args:
        recording: with a gyroscope.
        progress: called with the share done.
        field_strength: T, scales the soft iron; default det 1.
        noise: (magnetometer T, gyroscope rad/s) per sample; None estimates their ratio from the innovations.
        drift: T/√s, random walk of the hard iron in the filter; the result is then the hard iron at the end of the
            recording.

    Raises:
        MagycError: no gyroscope, too few samples, or a negative drift.
    """
    if not is_finite(drift) or drift < 0:
        raise MagycError(f"drift: must be finite and at least 0 T/√s, got {drift!r}")
    turning = turning_field(recording)
    middle = 0.5 * (turning.field.max(axis=0) + turning.field.min(axis=0))
    radius = float(np.median(np.linalg.norm(turning.field - middle, axis=1)))
    if not radius > 0:
        raise MagycError("sar-kf: the field never changed; turn the sensor")
    scaled = TurningField(turning.time, (turning.field - middle) / radius, turning.rotation)
    gyro_step = float(np.median(np.diff(recording.gyroscope.time)))
    # White noise of the rate rotates the field by noise · √step in a second.
    ratio = _likeliest(scaled) if noise is None else noise[1] * np.sqrt(gyro_step) * radius / noise[0]
    result = filter_field(scaled, ratio, drift / radius, progress)
    if progress:
        progress(1.0)
    hard_iron = middle + radius * result.state[3:]
    sensor = radius * _SENSOR * np.sqrt(result.square) if noise is None else noise[0]
    return to_calibration(
        recording,
        hard_iron,
        float(np.linalg.norm(turning.field - hard_iron, axis=1).mean()),
        windows(turning).covariance(hard_iron),  # the filter's own covariance does not include model errors
        method="sar-kf",
        field_strength=field_strength,
        diagnostics={
            "samples": len(turning.time),
            "magnetometer_noise": float(sensor),
            "gyroscope_noise": float(ratio * sensor / radius / np.sqrt(gyro_step)),
        },
        configuration={"noise": None if noise is None else list(noise), "drift": drift},
    )


def _likeliest(turning: TurningField) -> float:
    """Return the ratio of the noise levels that maximises the likelihood of the innovations, for any scale of both."""
    thin = slice(None, None, -(-len(turning.time) // _TUNED_ON))
    some = TurningField(turning.time[thin], turning.field[thin], turning.rotation[thin])

    def surprise(exponent: float) -> float:
        result = filter_field(some, 10**exponent)
        return float(np.log(max(result.square, 1e-30)) + result.log_determinant)

    return float(10 ** minimize_scalar(surprise, bounds=_RATIOS, method="bounded", options={"xatol": 0.05}).x)


def filter_field(
    turning: TurningField, ratio: float, drift: float = 0.0, progress: Callable[[float], None] | None = None
) -> Filtered:
    """Run the Kalman filter on a field of about unit strength about some origin.

    Args:
        turning: the field in units of its strength.
        ratio: process noise of v in a second, relative to the noise of a sample.
        drift: random walk of h, in units of the field strength per √s.
        progress: called with the share done.
    """
    time, field, rotation = turning
    step = np.diff(time, prepend=time[0])
    process = np.zeros((len(time), 6))
    process[:, :3] = ((ratio * _SENSOR) ** 2 * step)[:, None]
    process[:, 3:] = (drift**2 * step)[:, None]
    measured = np.concatenate([np.swapaxes(rotation, 1, 2), np.broadcast_to(np.eye(3), rotation.shape)], axis=2)
    sensor = _SENSOR**2 * np.eye(3)
    state, covariance = np.zeros(6), _WIDE**2 * np.eye(6)
    square, log_determinant, counted = 0.0, 0.0, 0
    for k, (matrix, sample) in enumerate(zip(measured, field, strict=True)):
        covariance.flat[::7] += process[k]  # prediction: the state is constant
        cross = covariance @ matrix.T
        expected = matrix @ cross + sensor
        root = np.linalg.cholesky(expected)  # S = L Lᵀ
        whitened = np.linalg.solve(root, np.column_stack([cross.T, sample - matrix @ state]))
        gain, innovation = whitened[:, :6], whitened[:, 6]  # K = gainᵀ L⁻¹
        state = state + innovation @ gain
        covariance -= gain.T @ gain  # exactly symmetric, unlike the usual P − K H P
        if k >= _SETTLING:
            square += float(innovation @ innovation)
            log_determinant += 2 * float(np.log(root.diagonal()).sum())
            counted += 3
        if progress and k % _REPORT == 0:
            progress(k / len(time))
    counted = max(counted, 1)
    return Filtered(state, covariance, square / counted, log_determinant / counted)
