"""Common parts of the methods without soft iron: the rotation of the sensor, and the assessment of m = s u + h."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.chain.gyroscope_track import GyroscopeTrack
from magyc_gtsam.factors.chain.rotations import matrices
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_positive
from magyc_gtsam.observability import HARD_IRON_LIMIT, assess
from magyc_gtsam.recording import Array, Recording

_STRETCHES = 30  # stretches of a recording over which scores are summed
_LEAST_WINDOWS = 8
_STILL = 1e-12  # rad², mean square of a window's rotation about the axis of least rotation


class TurningField(NamedTuple):
    """Magnetometer samples and the orientation of the sensor: time (n,) s, field (n, 3) T, rotation (n, 3, 3).

    `rotation` maps from the sensor's axes at a sample to those at the first gyroscope sample.
    """

    time: Array
    field: Array
    rotation: Array


def turning_field(recording: Recording) -> TurningField:
    """Return the magnetometer's samples with the rotation up to each, by the gyroscope without bias correction.

    Raises:
        MagycError: no gyroscope, or fewer than 4 magnetometer samples within its time span.
    """
    time, field = recording.magnetometer
    gyro_time, rate = recording.gyroscope
    inside = (time >= gyro_time[0]) & (time <= gyro_time[-1])
    if inside.sum() < 4:
        raise MagycError(
            f"{inside.sum()} magnetometer samples while the gyroscope ran, at least 4 are needed; record longer"
        )
    time, field = time[inside], field[inside]
    track = GyroscopeTrack.integrate(gyro_time, rate, interval_mean=recording.angular_rate_is == "interval-mean")
    rotation = matrices(track.rotation_at(time)[0])
    return TurningField(time, field, np.ascontiguousarray(rotation.T).reshape(-1, 3, 3))


class Windows(NamedTuple):
    """The equations (ΔR − I) h = ΔR m' − m of short windows: design (n, 3, 3) and change (n, 3) T."""

    design: Array
    change: Array

    @property
    def normal(self) -> Array:
        """(3, 3) normal matrix of the least-squares problem."""
        normal: Array = np.einsum("nij,nik->jk", self.design, self.design)
        return normal

    def left(self, hard_iron: Array) -> Array:
        """Return the residuals (n, 3) T of a hard iron."""
        return self.change - self.design @ hard_iron

    def covariance(self, hard_iron: Array) -> Array:
        """Return the covariance (3, 3) T² of a hard iron, from its residuals; see `clustered_covariance`."""
        return clustered_covariance(self.normal, np.einsum("nij,ni->nj", self.design, self.left(hard_iron)))


def windows(turning: TurningField, length: float = 1.0) -> Windows:
    """Return the windows of `length` seconds, one starting at every sample.

    ΔR maps from the axes at the end of a window to those at its start.

    Raises:
        MagycError: a length that is not positive, too few windows, or a sensor that hardly turned.
    """
    if not is_positive(length):
        raise MagycError(f"window: must be finite and above 0 s, got {length!r}")
    time, field, rotation = turning
    last = np.searchsorted(time, time + length * (1 - 1e-6))
    first = np.flatnonzero(last < len(time))
    last = last[first]
    whole = time[last] - time[first] < 1.5 * length + np.median(np.diff(time))  # no gap in the data inside
    first, last = first[whole], last[whole]
    if len(first) < _LEAST_WINDOWS:
        raise MagycError(
            f"{len(first)} windows of {length:g} s, at least {_LEAST_WINDOWS} are needed; record longer, or choose "
            "a shorter window"
        )
    turn = np.einsum("nji,njk->nik", rotation[first], rotation[last])
    system = Windows(turn - np.eye(3), np.einsum("nij,nj->ni", turn, field[last]) - field[first])
    if not np.linalg.eigvalsh(system.normal)[0] > _STILL * len(first):
        raise MagycError(
            "the sensor did not turn about two axes, by its gyroscope; turn it, or choose another method"
        )
    return system


def clustered_covariance(normal: Array, scores: Array) -> Array:
    """Return the covariance (p, p) of a least-squares estimate with autocorrelated residuals.

    N⁻¹ (Σ_b s_b s_bᵀ) N⁻¹ with the scores Jᵀr summed over stretches b of the recording (Liang and Zeger 1986):
    unmodelled effects such as soft iron or a gyroscope bias do not average out like noise.

    Args:
        normal: (p, p) JᵀJ.
        scores: (n, p) Jᵀr of every sample, in order of time.
    """
    first = np.linspace(0, len(scores), _STRETCHES, endpoint=False).astype(int)
    sums = np.add.reduceat(scores, np.unique(first), axis=0)
    inverse = np.linalg.inv(normal)
    covariance: Array = inverse @ (sums.T @ sums) @ inverse * len(sums) / max(len(sums) - 1, 1)
    return covariance


def to_calibration(
    recording: Recording,
    hard_iron: Array,
    strength: float,
    covariance: Array,
    *,
    method: str,
    field_strength: float | None,
    diagnostics: Mapping[str, Any],
    configuration: Mapping[str, Any],
    problems: Sequence[str] = (),
) -> Calibration:
    """Return the calibration m = s u + h, with its scale fixed and its fit assessed.

    No covariance is reported: that of the method assumes that the soft iron is a multiple of the identity and the
    gyroscope or the attitude has no error, and is not the estimate's spread otherwise. It only shows which parameters
    the motion leaves undetermined.

    Args:
        recording: the data.
        hard_iron: (3,) T.
        strength: T, of the field as measured by the instrument.
        covariance: (3, 3) T², of the hard iron as if the model were true.
        method: its name in `methods()`.
        field_strength: T, scales the soft iron; None: det 1.
        diagnostics, configuration: the method's own.
        problems: reasons not to trust the result, whatever its fit.
    """
    shown, unit = recording.field_shown
    whole = np.zeros((9, 9))
    whole[6:, 6:] = covariance
    observability = assess(whole, np.eye(3), strength, recording, hard_iron)
    reasons = list(problems)
    if not observability.observable:
        reasons.append(f"not observable: {observability.weak[0].sentence}")
    left = float(np.linalg.norm(recording.magnetometer.value - hard_iron, axis=1).std())
    if left > HARD_IRON_LIMIT * strength:
        reasons.append(
            f"without its hard iron the field still varies by {left * shown:.1f} {unit} (at most "
            f"{HARD_IRON_LIMIT:.0%} of it is tolerated): there is soft iron, or the field or the instrument changed "
            "during the recording; choose a method with soft iron, or an interval (start=, end=)"
        )
    scale = 1.0 if field_strength is None else strength / field_strength
    return Calibration(
        scale * np.eye(3),
        hard_iron,
        converged=not reasons,
        message="; ".join(reasons) or "solved",
        method=method,
        field_strength=strength if field_strength is None else field_strength,
        observability=observability,
        diagnostics=diagnostics,
        configuration=dict(configuration) | ({} if field_strength is None else {"field_strength": field_strength}),
    )
