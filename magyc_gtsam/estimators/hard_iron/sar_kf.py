"""SAR-KF: the hard iron by a Kalman filter on a field that turns with the gyroscope.

G. Troni and L. L. Whitcomb, "Field sensor bias calibration with angular-rate sensors: theory and experimental
evaluation with application to magnetometer calibration", IEEE/ASME Trans. Mechatronics 24(4), 2019, section
IV-B: the state is field and hard iron, ṁ = −ω × (m − h) and ḣ = 0, and nothing is differentiated. The printed
equations were not at hand; what follows is derived from that model.

The state here is v = R_k (m − h), the field turned back to the first sample's axes by the gyroscope, and h. In it
the model stands still, v' = v and h' = h, exactly and for any rotation between samples, and the measurement is
m_k = R_kᵀ v + h. What the gyroscope gets wrong is the process noise of v. As all is linear, the last estimate is
the best one and the start is forgotten; it depends on the ratio of the two noises only. The paper leaves that to
be tuned; here it is the one under which the innovations are the likeliest.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.hard_iron.turning import TurningField, to_calibration, turning_field, windows
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording

_SENSOR = 0.01  # noise per sample that the filter takes, as a share of the field: its own unit
_WIDE = 10.0  # deviation of the start, likewise in units of the field
_TUNED_ON = 2000  # samples, evenly spaced, on which the noises' ratio is found
_RATIOS = (-4.0, 3.0)  # its decimal logarithm, of field lost by turning in a second over noise of a sample
_SETTLING = 6  # samples before which the innovations are those of the start
_REPORT = 2000  # samples between two calls of the progress callback


class Filtered(NamedTuple):
    """The last state v, h (6,) with its covariance (6, 6), and what the innovations were.

    square: mean of νᵀ S⁻¹ ν per axis, 1 where the noises are right; log_determinant: mean of log |S| per axis.
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
    """Calibrate by SAR-KF: hard iron only, soft iron a multiple of the identity, gyroscope without bias.

    Args:
        recording: with a gyroscope.
        progress: called with the share done.
        field_strength: T, scales the soft iron; default det 1.
        noise: (magnetometer T, gyroscope rad/s) per sample; None finds their ratio from the innovations.
        drift: T/√s, random walk of the hard iron that the filter allows for; the last estimate then is that of
            the recording's end.

    Raises:
        MagycError: no gyroscope, too few samples, or noise levels that are not positive.
    """
    if noise is not None and not (len(noise) == 2 and min(noise) > 0 and np.isfinite(noise).all()):
        raise MagycError(f"noise: must be a pair above 0 (magnetometer T, gyroscope rad/s), got {noise!r}")
    if not (np.isfinite(drift) and drift >= 0):
        raise MagycError(f"drift: must be finite and at least 0 T/√s, got {drift!r}")
    turning = turning_field(recording)
    middle = 0.5 * (turning.field.max(axis=0) + turning.field.min(axis=0))
    radius = float(np.median(np.linalg.norm(turning.field - middle, axis=1)))
    if not radius > 0:
        raise MagycError("sar-kf: the field never changed; turn the sensor")
    scaled = TurningField(turning.time, (turning.field - middle) / radius, turning.rotation)
    gyro_step = float(np.median(np.diff(recording.gyroscope.time)))
    # White noise of the rate turns the field by noise · √step in a second.
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
        windows(turning).covariance(hard_iron),  # the filter's own knows nothing of what its model leaves out
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
    """The ratio of the noises that makes the innovations likeliest, whatever the noises' scale."""
    thin = slice(None, None, -(-len(turning.time) // _TUNED_ON))
    some = TurningField(turning.time[thin], turning.field[thin], turning.rotation[thin])

    def surprise(exponent: float) -> float:
        result = filter_field(some, 10**exponent)
        return float(np.log(max(result.square, 1e-30)) + result.log_determinant)

    return float(10 ** minimize_scalar(surprise, bounds=_RATIOS, method="bounded", options={"xatol": 0.05}).x)


def filter_field(
    turning: TurningField, ratio: float, drift: float = 0.0, progress: Callable[[float], None] | None = None
) -> Filtered:
    """The Kalman filter on a field of about unit strength about some origin.

    Args:
        turning: the field in units of its strength.
        ratio: of the deviation that v gains in a second to the noise of a sample.
        drift: that h gains, in units of the field's strength per √s.
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
        covariance.flat[::7] += process[k]  # prediction: the state stands still
        cross = covariance @ matrix.T
        expected = matrix @ cross + sensor
        root = np.linalg.cholesky(expected)  # S = L Lᵀ
        whitened = np.linalg.solve(root, np.column_stack([cross.T, sample - matrix @ state]))
        gain, innovation = whitened[:, :6], whitened[:, 6]  # K = gainᵀ L⁻¹
        state = state + innovation @ gain
        covariance -= gain.T @ gain  # symmetric to the last bit, which the usual P − K H P is not
        if k >= _SETTLING:
            square += float(innovation @ innovation)
            log_determinant += 2 * float(np.log(root.diagonal()).sum())
            counted += 3
        if progress and k % _REPORT == 0:
            progress(k / len(time))
    counted = max(counted, 1)
    return Filtered(state, covariance, square / counted, log_determinant / counted)
