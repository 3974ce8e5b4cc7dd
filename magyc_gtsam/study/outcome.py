"""The outcomes of all methods on one recording."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from magyc_gtsam import metrics
from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Mask, Recording
from magyc_gtsam.recording.time_base import interpolated
from magyc_gtsam.runners.status import Status


class HeadingError(NamedTuple):
    """Magnetic minus reference heading about its mean: time (n,) s since the first row, error (n,) deg."""

    time: Array
    error: Array

    @property
    def deviation(self) -> float:
        """The standard deviation, deg."""
        return float(self.error.std())


def heading_error(recording: Recording, calibration: Calibration, delay: float | None = None) -> HeadingError:
    """Return the direction of the horizontal calibrated field in the reference's world axes, which should be constant.

    Args:
        recording: a recording with attitude, whose world z axis is vertical.
        calibration: calibration of its magnetometer.
        delay: lag of the magnetometer, s; None takes the calibration's.

    Raises:
        MagycError: the recording has no reference attitude.
    """
    attitude = recording.attitude
    known = np.zeros(0, dtype=bool) if attitude is None else np.isfinite(attitude).all(axis=1)
    if attitude is None or not known.any():
        raise MagycError(f"recording {recording.name!r} has no reference attitude")
    time, field = recording.magnetometer
    late = np.clip(recording.time[known] + (calibration.delay if delay is None else delay), time[0], time[-1])
    calibrated = calibration.corrected(interpolated(late, time, field))
    error = metrics.heading_error(calibrated, attitude[known])
    return HeadingError(recording.time[known] - recording.time[0], np.rad2deg(error))


REFERENCES = ("smoother", "autocal")  # the most accurate methods with and without a gyroscope


class OutcomeStatus(str, Enum):
    """The outcome of a method."""

    TRUSTED = "trusted"
    DOUBTFUL = "doubtful"
    UNTRUSTED = "not trusted"
    FAILED = "failed"
    IMPOSSIBLE = "not possible"

    __str__ = str.__str__


@dataclass(frozen=True, eq=False)
class MethodOutcome:
    """The outcome of one method on the recording.

    Attributes:
        method: its name in `methods()`; "raw" for the uncalibrated recording.
        status: status of the outcome.
        reason: why it is doubtful, not trusted, failed or impossible; otherwise the method's message.
        note: changes to the data for this method only; "" for none.
        calibration: the calibration; None without one.
        seconds: run time, wall clock; None if it did not run.
        spread: T (or counts), standard deviation of the strength of all calibrated samples.
        inlier_spread: standard deviation of the strength of the samples in `Comparison.inlier`.
        strength: T (or counts), mean strength.
        heading: heading error against the reference attitude; None without one.
    """

    method: str
    status: OutcomeStatus
    reason: str
    note: str = ""
    calibration: Calibration | None = None
    seconds: float | None = None
    spread: float | None = None
    inlier_spread: float | None = None
    strength: float | None = None
    heading: HeadingError | None = None

    @property
    def interrupted(self) -> bool:
        """Whether an interrupt ended the method, which then keeps the values it had."""
        return self.calibration is not None and self.calibration.diagnostics.get("status") == str(
            Status.INTERRUPTED
        )


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """The result of `compare`.

    Attributes:
        recording: the recording.
        raw: the uncalibrated recording, judged like the methods.
        outcomes: one per method, in the order of `methods()` or as requested.
        delay: lag of the magnetometer, s, used for all methods in the comparison with the reference attitude, since
            most do not estimate it and it would count as their heading error.
        delay_from: the method that estimated it; "" for none.
        inlier: (n,) whether each magnetometer sample lies on the ellipsoid of one robust method.
        inlier_from: the robust method; "" if none is trusted, in which case all samples are inliers.
        not_run: methods that were not run because of an interrupt (Ctrl-C).
    """

    recording: Recording
    raw: MethodOutcome
    outcomes: tuple[MethodOutcome, ...]
    delay: float
    delay_from: str
    inlier: Mask
    inlier_from: str
    not_run: tuple[str, ...] = ()

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the comparison before all methods were done."""
        return bool(self.not_run) or any(o.interrupted for o in self.outcomes)

    @property
    def calibrated(self) -> tuple[MethodOutcome, ...]:
        """The methods that gave parameters, trusted or not."""
        return tuple(o for o in self.outcomes if o.calibration is not None)

    @property
    def reference(self) -> MethodOutcome | None:
        """The outcome to compare the others with: the first trusted one of REFERENCES."""
        by_name = {o.method: o for o in self.trusted}
        return next((by_name[name] for name in REFERENCES if name in by_name), None)

    @property
    def recommended(self) -> MethodOutcome | None:
        """The outcome to use: `reference`, otherwise the trusted one whose calibrated field varies least."""
        if self.reference is not None:
            return self.reference
        return min(self.trusted, key=lambda o: o.inlier_spread or 0.0, default=None)

    def __repr__(self) -> str:
        use = None if self.recommended is None else self.recommended.method
        return f"Comparison(use={use!r}, {len(self.trusted)} of {len(self.outcomes)} methods trusted)"

    def _repr_html_(self) -> str:
        text: str = importlib.import_module("magyc_gtsam.report.notebook").html_of(
            self
        )  # a higher layer than this module
        return text

    @property
    def by_trust(self) -> tuple[MethodOutcome, ...]:
        """All outcomes, the recommended one first, then by status and spread of the calibrated field."""
        order = list(OutcomeStatus)
        return tuple(
            sorted(
                self.outcomes,
                key=lambda o: (o is not self.recommended, order.index(o.status), o.inlier_spread or 0.0),
            )
        )

    @property
    def trusted(self) -> tuple[MethodOutcome, ...]:
        """The methods with a trusted result."""
        return tuple(o for o in self.outcomes if o.status is OutcomeStatus.TRUSTED)
