"""The information of one log on the instrument, compressed to one Gaussian factor.

The factor is on (s, h, b): the soft iron's shape (`coordinates`), the hard iron in µT and the gyroscope bias in
mrad/s; or on (s, g, h, b) where the scales g of the gyroscope's axes, in ‰, are estimated
(`calibrate(gyroscope_scale=)`). The parameters that all logs of an instrument share come first. The delay is nearly
independent of the factor's parameters (it changes no sigma of soft or hard iron by more than 1 %) and is kept
separately. Noise levels, field directions and robust weights are eliminated, so that a log is never read again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.estimators.smoother.gyroscope_scale import SCALED_AXES
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import clauses
from magyc_gtsam.history.coordinates import SHAPE, shape_of, shape_slope, soft_iron_of, soft_iron_slope
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.applied import CALIBRATED, is_calibrated
from magyc_gtsam.recording.autopilot import Autopilot
from magyc_gtsam.recording.axes import OWN_AXES
from magyc_gtsam.recording.fingerprint import fingerprint
from magyc_gtsam.recording.stamps import moment
from magyc_gtsam.recording.time_zero import time_zero_of

HARD_IRON, GYRO_BIAS = slice(-6, -3), slice(-3, None)
SHARED, OBSERVED = slice(None, -6), slice(None, -3)  # indices of s, or of s and g; and of these with h
SCALE = slice(SHAPE, SHAPE + 3)  # indices of g, where it is estimated
SIZE, SIZE_WITH_SCALE = SHAPE + 6, SHAPE + 9
MICROTESLA, MILLIRADIAN, PER_MILLE = 1e-6, 1e-3, 1e-3
_SHAPES: dict[str, tuple[tuple[int, ...], ...]] = {
    "mean": ((SIZE,), (SIZE_WITH_SCALE,)),
    "covariance": ((SIZE, SIZE), (SIZE_WITH_SCALE, SIZE_WITH_SCALE)),
    "noise_covariance": ((SIZE, SIZE), (SIZE_WITH_SCALE, SIZE_WITH_SCALE)),
    "misalignment": ((3,),),
    "misalignment_covariance": ((3, 3),),
}
_WEAK = 10.0  # ratio of the weak prior's deviation to the prior's; the weak priors of a hundred logs count as one prior
_UNKNOWN_BIAS = 1e3  # mrad/s, standard deviation of a bias that the method does not estimate
# s since 1970, September 2001. A clock below this does not show the date; those that were never set begin in 1970, 1980
# and 2000.
_CALENDAR = 1e9


@dataclass(frozen=True, eq=False)
class LogFactor:
    """The information of one log on the instrument.

    Attributes:
        name: name of the log.
        time: s since 1970 of its middle; None if its clock does not show the date.
        mean: (11,) s, h µT, b mrad/s, or (14,) s, g ‰, h, b; None without a trusted calibration.
        covariance: (11, 11) or (14, 14) of `mean`.
        noise_covariance: its part by the sensors' noise; None if the method does not separate it.
        delay, delay_sigma: s; the sigma is None if the delay was not estimated.
        misalignment, misalignment_covariance: (3,) rad, (3, 3); None if the log did not show one.
        log_scale, log_scale_sigma: logarithm of the scale of the soft iron; None if the field strength was not given.
        field_strength: field strength, T, estimated or given.
        problem: why the log has no information; "" if it has.
        gyroscope_axes, autopilot: of its recording.
        left_out: sentences on its parts that were left out because a sensor was faulty.
        samples: fingerprint of its recording; "" in a history of an earlier version, of a file that cannot be read, of
            a copy of another log, and of a calibrated log.
    """

    name: str
    time: float | None
    mean: Array | None
    covariance: Array | None
    delay: float = 0.0
    delay_sigma: float | None = None
    misalignment: Array | None = None
    misalignment_covariance: Array | None = None
    log_scale: float | None = None
    log_scale_sigma: float | None = None
    field_strength: float | None = None
    problem: str = ""
    samples: str = ""
    noise_covariance: Array | None = None
    gyroscope_axes: str = OWN_AXES
    autopilot: Autopilot | None = None
    left_out: tuple[str, ...] = ()

    @property
    def counts(self) -> bool:
        """Whether time passes until this log: a file that cannot be read and a copy are no logs of their own."""
        return self.mean is not None or bool(self.samples)

    @property
    def model_error(self) -> Array:
        """The covariance, of the size of `covariance`, that is due to effects which the model lacks."""
        assert self.covariance is not None
        noise = self.noise_covariance
        return np.zeros_like(self.covariance) if noise is None else self.covariance - noise

    def to_dict(self) -> dict[str, Any]:
        """Return the factor as JSON types."""
        arrays = {name: getattr(self, name) for name in _SHAPES}
        values = asdict(self) | {name: None if value is None else value.tolist() for name, value in arrays.items()}
        autopilot = None if self.autopilot is None else self.autopilot.to_dict()
        return values | {"autopilot": autopilot, "left_out": list(self.left_out)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> LogFactor:
        """Return the factor that `to_dict` described.

        Raises:
            MagycError: a value is missing or has a wrong shape.
        """
        try:
            values = dict(data)
            for name, shapes in _SHAPES.items():
                if values.get(name) is not None:
                    values[name] = np.array(values[name], dtype=np.float64)
                    if values[name].shape not in shapes or not np.isfinite(values[name]).all():
                        wanted = " or ".join(map(str, shapes))
                        raise MagycError(f"history: {name} of a log must be {wanted} finite numbers")
            values["left_out"] = tuple(values.get("left_out", ()))
            if values.get("autopilot") is not None:
                values["autopilot"] = Autopilot.from_dict(values["autopilot"])
            factor = cls(**values)
            mean, covariance = values["mean"], values["covariance"]
            sizes = {
                values[name].shape for name in ("covariance", "noise_covariance") if values.get(name) is not None
            }
            if mean is not None and (covariance is None or sizes != {mean.shape * 2}):
                raise MagycError(f"history: mean and covariance of log {factor.name!r} have different sizes")
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, MagycError):
                raise
            raise MagycError(f"history: damaged entry of a log ({error})") from None
        if (factor.mean is None) != bool(factor.problem):
            raise MagycError(f"history: log {factor.name!r} has neither a calibration nor a problem, or both")
        return factor


def factor_of(recording: Recording, time: float | None, options: dict[str, Any]) -> LogFactor:
    """Calibrate a log and compress it; the factor of a log that cannot be calibrated, or is already, states the reason.

    Args:
        recording: the log.
        time: s since 1970; None takes it from the recording.
        options: options of `calibrate`.
    """
    when = _middle_of(recording) if time is None else moment("time", time)
    if is_calibrated(recording):
        return LogFactor(recording.name, when, None, None, problem=CALIBRATED)
    try:
        calibration = calibrate(recording, **options)
    except MagycError as problem:
        factor = LogFactor(recording.name, when, None, None, problem=str(problem))
    else:
        factor = compress(calibration, recording.name, when)
    return replace(
        factor,
        samples=fingerprint(recording),
        gyroscope_axes=recording.gyroscope_axes,
        autopilot=recording.autopilot,
    )


def compress(calibration: Calibration, name: str, time: float | None) -> LogFactor:
    """Return the factor of one log's calibration, or only the reason if it is not trusted.

    Raises:
        MagycError: the method states no covariance.
    """
    if not calibration.trusted:
        cause = next(iter(clauses(calibration.message)), "the calibration did not converge")
        return LogFactor(name, time, None, None, problem=cause)
    if calibration.covariance is None:
        raise MagycError(
            f"method {calibration.method!r} states no covariance, which a history needs; use 'smoother'"
        )
    shape, log_scale = shape_of(calibration.soft_iron)
    scale = next((term for term in calibration.terms if term.name == "gyro-scale"), None)
    size = SIZE if scale is None else SIZE_WITH_SCALE
    mean, slope = np.zeros(size), np.zeros((size, 15))  # slope: derivative by vech(S), h, b and g in SI units
    mean[:SHAPE], slope[:SHAPE, :6] = shape, shape_slope(calibration.soft_iron)
    mean[HARD_IRON], slope[HARD_IRON, 6:9] = calibration.hard_iron / MICROTESLA, np.eye(3) / MICROTESLA
    if calibration.gyro_bias is not None:
        mean[GYRO_BIAS], slope[GYRO_BIAS, 9:12] = calibration.gyro_bias / MILLIRADIAN, np.eye(3) / MILLIRADIAN
    if scale is not None:
        mean[SCALE], slope[SCALE, 12:] = scale.value / PER_MILLE, np.eye(3) / PER_MILLE
    prior = None if scale is None else calibration.configuration.get("gyroscope_scale")  # None from a history
    at = mean
    covariances: list[Array | None] = []
    for known in (calibration.covariance, calibration.noise_covariance):
        if known is None:
            covariances.append(None)
            continue
        whole = np.zeros((15, 15))
        rows = len(known)  # 12, or 9 without a bias
        whole[:rows, :rows] = known
        if scale is not None:
            whole[12:, 12:] = scale.covariance
            whole[:12, 12:] = calibration.diagnostics["gyroscope_scale"]
            whole[12:, :12] = whole[:12, 12:].T
        covariance = slope @ whole @ slope.T
        if prior is not None:
            moved, covariance = _with_weak_prior(at, covariance, prior)
            mean = moved if not covariances else mean
        if calibration.gyro_bias is None:
            covariance[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * _UNKNOWN_BIAS**2
        covariances.append(0.5 * (covariance + covariance.T))
    strength_given = calibration.configuration.get("field_strength") is not None
    # The derivative of ln ∛det S by vech(S).
    by_scale = vech(np.linalg.inv(calibration.soft_iron)) * np.array([1, 2, 2, 1, 2, 1]) / 3
    of_scale = float(np.sqrt(max(by_scale @ calibration.covariance[:6, :6] @ by_scale, 0.0)))
    skew = next((term for term in calibration.terms if term.name == "misalignment"), None)
    return LogFactor(
        name,
        time,
        mean,
        covariances[0],
        noise_covariance=covariances[1],
        delay=calibration.delay,
        delay_sigma=calibration.delay_sigma,
        misalignment=None if skew is None else skew.value,
        misalignment_covariance=None if skew is None else skew.covariance,
        log_scale=log_scale if strength_given else None,
        log_scale_sigma=of_scale if strength_given else None,
        field_strength=calibration.field_strength,
        left_out=tuple(calibration.diagnostics.get("left_out", ())),
    )


def _with_weak_prior(mean: Array, covariance: Array, deviation: float) -> tuple[Array, Array]:
    """Return (s, g, h, b) with the prior on g replaced by a weak one.

    The prior belongs to the instrument, which has it once, and not to each of its logs.

    Args:
        mean, covariance: (14,) and (14, 14) with the prior g ~ N(0, deviation²).
        deviation: relative.
    """
    information = np.linalg.inv(covariance)
    weighted = information @ mean
    information[SCALE, SCALE] -= (1 - _WEAK**-2) * (PER_MILLE / deviation) ** 2 * np.eye(3)
    covariance = np.linalg.inv(information)
    return covariance @ weighted, covariance


def calibration_of(
    mean: Array,
    covariance: Array,
    *,
    delay: tuple[float, float | None],
    terms: tuple[Term, ...],
    log_scale: tuple[float, float],
    field_strength: float | None,
    message: str,
    diagnostics: Mapping[str, Any],
) -> Calibration:
    """Return the `Calibration` of (s, h, b), or (s, g, h, b), and their covariance; the inverse of `compress`."""
    slope = np.zeros((12, len(mean)))
    slope[:6, :SHAPE] = soft_iron_slope(mean[:SHAPE], log_scale[0])
    soft_iron = soft_iron_of(mean[:SHAPE], log_scale[0])
    slope[6:9, HARD_IRON] = np.eye(3) * MICROTESLA
    slope[9:, GYRO_BIAS] = np.eye(3) * MILLIRADIAN
    if len(mean) == SIZE_WITH_SCALE:
        scale = Term("gyro-scale", mean[SCALE] * PER_MILLE, covariance[SCALE, SCALE] * PER_MILLE**2, SCALED_AXES)
        terms = (*terms, scale)
        diagnostics = {**diagnostics, "gyroscope_scale": (slope @ covariance[:, SCALE] * PER_MILLE).tolist()}
    return Calibration(
        soft_iron=soft_iron,
        hard_iron=mean[HARD_IRON] * MICROTESLA,
        gyro_bias=mean[GYRO_BIAS] * MILLIRADIAN,
        covariance=slope @ covariance @ slope.T + _of_scale(soft_iron, log_scale[1]),
        delay=delay[0],
        delay_sigma=delay[1],
        terms=terms,
        message=message,
        method="history",
        field_strength=field_strength,
        diagnostics=diagnostics,
    )


def _of_scale(soft_iron: Array, sigma: float) -> Array:
    """Return the covariance (12, 12) of (vech S, h, b) by a scale of S of relative sigma."""
    slope = np.concatenate([vech(soft_iron), np.zeros(6)])
    return sigma**2 * np.outer(slope, slope)


def _middle_of(recording: Recording) -> float | None:
    """Return the middle of a recording in s since 1970; None if its clock does not show the date."""
    middle = 0.5 * float(recording.time[0] + recording.time[-1]) + time_zero_of(recording) / 1e9
    return middle if middle > _CALENDAR else None
