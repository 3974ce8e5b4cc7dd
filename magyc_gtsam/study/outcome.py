"""What became of every method on one recording, side by side."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from enum import Enum

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.recording import Mask, Recording
from magyc_gtsam.runners.status import Status
from magyc_gtsam.study.heading import HeadingError

REFERENCES = ("smoother", "autocal")  # the most accurate with and without a gyroscope


class OutcomeStatus(str, Enum):
    """What became of a method."""

    TRUSTED = "trusted"
    DOUBTFUL = "doubtful"
    UNTRUSTED = "not trusted"
    FAILED = "failed"
    IMPOSSIBLE = "not possible"

    __str__ = str.__str__


@dataclass(frozen=True, eq=False)
class MethodOutcome:
    """One method on the recording.

    Attributes:
        method: its name in `methods()`; "raw" for the recording as it is.
        status: what became of it.
        reason: why it is doubtful, not trusted, failed or is not possible; else what the method says of its end.
        note: what was done to the data for this method only, "" for nothing.
        calibration: None where there is none.
        seconds: run time, wall clock; None where it did not run.
        spread: T (or counts), standard deviation of the strength of the samples calibrated, all of them.
        inlier_spread: likewise, of those in `Comparison.inlier`.
        strength: T (or counts), its mean.
        heading: against the reference attitude; None without one.
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
        """Whether the method ended at an interrupt, with the values that it had, as the graphs' runners do."""
        return self.calibration is not None and self.calibration.diagnostics.get("status") == str(
            Status.INTERRUPTED
        )


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """What `compare` returns.

    Attributes:
        recording: the data.
        raw: the recording as it is, judged like the methods.
        outcomes: one for each method, in the order of `methods()` or as asked for.
        delay: s by which the field was taken later wherever it is held against the reference attitude, one for
            all methods: most do not estimate it, and it would count as their heading error.
        delay_from: the method that estimated it; "" for none.
        inlier: (n,) of the magnetometer's own samples, whether they lie on the ellipsoid of one robust method.
        inlier_from: that method; "" where none can be trusted, and all count as inliers.
        not_run: methods that an interrupt (Ctrl-C) came before.
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
        """Whether Ctrl-C ended it before all methods were done."""
        return bool(self.not_run) or any(o.interrupted for o in self.outcomes)

    @property
    def calibrated(self) -> tuple[MethodOutcome, ...]:
        """The methods that gave parameters, trusted or not."""
        return tuple(o for o in self.outcomes if o.calibration is not None)

    @property
    def reference(self) -> MethodOutcome | None:
        """The result to hold the others against: the first of REFERENCES that can be trusted."""
        by_name = {o.method: o for o in self.trusted}
        return next((by_name[name] for name in REFERENCES if name in by_name), None)

    @property
    def recommended(self) -> MethodOutcome | None:
        """The result to use: `reference`, else the trusted one whose calibrated field varies least."""
        if self.reference is not None:
            return self.reference
        return min(self.trusted, key=lambda o: o.inlier_spread or 0.0, default=None)

    def __repr__(self) -> str:
        use = None if self.recommended is None else self.recommended.method
        return f"Comparison(use={use!r}, {len(self.trusted)} of {len(self.outcomes)} methods trusted)"

    def _repr_html_(self) -> str:
        text: str = importlib.import_module("magyc_gtsam.report.notebook").html_of(
            self
        )  # it lies above this module
        return text

    @property
    def by_trust(self) -> tuple[MethodOutcome, ...]:
        """All outcomes, the one to use first, then by status and by how much the calibrated field varies."""
        order = list(OutcomeStatus)
        return tuple(
            sorted(
                self.outcomes,
                key=lambda o: (o is not self.recommended, order.index(o.status), o.inlier_spread or 0.0),
            )
        )

    @property
    def trusted(self) -> tuple[MethodOutcome, ...]:
        """The methods whose result can be trusted."""
        return tuple(o for o in self.outcomes if o.status is OutcomeStatus.TRUSTED)
