"""`magfactor3`: GTSAM's MagFactor3, m = s · bRw · f + h with known attitude; scale and hard iron unknown.

GTSAM has one factor per sample (here `factors.scaled_magnetometer_factor`). The model is linear in the unknowns, so
the minimum of the whole graph is computed here in closed form. With u_k = R_kᵀ f, R_k the attitude (sensor→world), and
means over the samples:

    s = Σ (u − ū)·(m − m̄) / Σ ‖u − ū‖²,   h = m̄ − s ū                              if f is known,
    g = (I − MᵀM)⁻¹ (mean(R m) − Mᵀ m̄),   h = m̄ − M g,   M = mean(Rᵀ),   g = s f    if it is not.

The second form is this project's: attitudes from cameras or gyrocompasses have their own horizontal axes, in which the
field is unknown. Its three components are then estimated too, and only the scale needs the field strength.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.hard_iron.turning import clustered_covariance, to_calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_finite, numbers
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.time_base import interpolated

_LEAST = 6  # samples with an attitude
_CIRCULAR = (
    "the log's attitude is an estimate that this magnetometer took part in, so that its hard iron is in both and does "
    "not show: use smoother, or an attitude from elsewhere"
)
_STILL = 1e-9  # share of the full spread of directions below which the sensor did not turn


def calibrate_magfactor3(
    recording: Recording,
    *,
    progress: Callable[[float], None] | None = None,
    field_strength: float | None = None,
    field: Sequence[float] | None = None,
    delay: float = 0.0,
) -> Calibration:
    """Calibrate with the model of MagFactor3: hard iron and one scale for all axes.

    Args:
        recording: with attitude.
        progress: called with the share done.
        field_strength: T; sets the scale instead of the length of `field`. None without `field`: det 1.
        field: (3,) T, the field in the attitude's world axes; None estimates its direction too.
        delay: s by which the magnetometer lags the attitude.

    Raises:
        MagycError: no attitude, a `field` that is not 1e-6 to 1e-3 T, or a sensor that did not turn.
    """
    if not is_finite(delay):
        raise MagycError(f"delay: must be a finite number of s, got {delay!r}")
    known = None if field is None else numbers("field", field)
    if known is not None and (known.shape != (3,) or not 1e-6 < np.linalg.norm(known) < 1e-3):
        raise MagycError(f"field: {field!r} must be (3,) T with a length between 1e-6 and 1e-3 T")
    measured, attitude = _with_attitude(recording, delay)
    mean = measured.mean(axis=0)
    if known is None:
        world = attitude.apply(measured).mean(axis=0)
        turn = attitude.inv().as_matrix().mean(axis=0)  # M
        spread = np.eye(3) - turn.T @ turn
        if not np.linalg.eigvalsh(spread)[0] > _STILL:
            raise MagycError(
                "magfactor3: the sensor turned about one axis at most; turn it about two, or give `field`"
            )
        scaled = np.linalg.solve(spread, world - turn.T @ mean)  # g = s f
        hard_iron = mean - turn @ scaled
        strength = float(np.linalg.norm(scaled))
        left = measured - attitude.inv().apply(scaled) - hard_iron
        normal = len(measured) * np.block([[np.eye(3), turn.T], [turn, np.eye(3)]])
        scores = np.hstack([attitude.apply(left), left])
    else:
        body = attitude.inv().apply(known)
        direction = body.mean(axis=0)
        variance = float(np.mean(np.sum((body - direction) ** 2, axis=1)))
        if not variance > _STILL * float(known @ known):
            raise MagycError("magfactor3: the sensor did not turn against the field; turn it")
        scale = float(np.mean(np.sum((body - direction) * (measured - mean), axis=1))) / variance
        hard_iron = mean - scale * direction
        strength = scale * float(np.linalg.norm(known))
        left = measured - scale * body - hard_iron
        normal = len(measured) * np.block(
            [[np.mean(np.sum(body**2, axis=1)), direction], [direction[:, None], np.eye(3)]]
        )
        scores = np.hstack([np.sum(body * left, axis=1, keepdims=True), left])
        if strength <= 0:
            raise MagycError(
                "magfactor3: the scale came out negative; `field` is not in the attitude's world axes"
            )
        field_strength = float(np.linalg.norm(known)) if field_strength is None else field_strength
    if progress:
        progress(1.0)
    return to_calibration(
        recording,
        hard_iron,
        strength,
        clustered_covariance(normal, scores)[-3:, -3:],
        method="magfactor3",
        field_strength=field_strength,
        diagnostics={"samples": len(measured), "residual": float(np.sqrt(np.mean(left**2)))},
        configuration={"field": None if known is None else known.tolist(), "delay": delay},
        problems=(_CIRCULAR,) if recording.attitude_is == "estimate" else (),
    )


def _with_attitude(recording: Recording, delay: float) -> tuple[Array, Rotation]:
    """Return the field (n, 3) T at the times with a known attitude, and that attitude."""
    if recording.attitude is None:
        raise MagycError(
            f"recording {recording.name!r} has no attitude, which magfactor3 needs; name its topic or columns "
            "(attitude=), or choose another method"
        )
    known = recording.magnetic_field_fresh & np.isfinite(recording.attitude).all(axis=1)
    if known.sum() < _LEAST:
        raise MagycError(f"{known.sum()} samples of the field have an attitude, at least {_LEAST} are needed")
    field, attitude = recording.magnetic_field[known], Rotation.from_quat(recording.attitude[known])
    if delay:
        time, own = recording.magnetometer
        late = recording.time[known] + delay
        field = interpolated(late, time, own)
    return field, attitude
