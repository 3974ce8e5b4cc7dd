"""What an online calibration reports beside the calibration itself."""

from __future__ import annotations

from dataclasses import dataclass

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.clipped import Clipped
from magyc_gtsam.estimators.clipped_field import ClippedField
from magyc_gtsam.estimators.stuck import Stuck
from magyc_gtsam.observability import Weakness
from magyc_gtsam.recording import Array


@dataclass(frozen=True)
class Progress:
    """How far an online calibration is.

    Attributes:
        time: s, stamp of the last sample taken; None before the first.
        duration: s from the first sample to the last.
        windows: windows formed so far.
        converged: as `OnlineCalibrator.converged`.
        sentence: the one thing to know now, in the user's words: what is waited for, which direction is
            weak and which motion helps, or that it has converged.
        weak: the weak directions, worst first, each with the motion that would determine it.
        coverage: share of the sphere of field directions (sensor frame) visited, 0 to 1.
        left_out: samples left out so far: repeated or late stamps, values that are not finite, axes that stood still,
            turns that were cut off.
        stuck: axes that stood still so far, or do so now, the largest share first; nothing is learnt from them.
        clipped: what the gyroscope's full scale cut off so far; nothing is learnt across it.
        clipped_field: what the magnetometer's full scale cut off so far, if it is enough to do harm; it is learnt from,
            and the estimate not converged.
    """

    time: float | None
    duration: float
    windows: int
    converged: bool
    sentence: str
    weak: tuple[Weakness, ...] = ()
    coverage: float = 0.0
    left_out: int = 0
    stuck: tuple[Stuck, ...] = ()
    clipped: Clipped | None = None
    clipped_field: ClippedField | None = None


@dataclass(frozen=True, eq=False)
class Change:
    """A step in hard iron: payload moved, magnet attached.

    Attributes:
        time: s, on the magnetometer's clock, and its standard deviation time_sigma.
        step: (3,) T, hard iron after less before, and its standard deviation step_sigma (3,).
        before: the calibration up to the step; None where there was none yet.
        after: the calibration since the step, as it is now; None until there is one.
    """

    time: float
    time_sigma: float
    step: Array
    step_sigma: Array
    before: Calibration | None
    after: Calibration | None
