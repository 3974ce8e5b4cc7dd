"""What an engine of `OnlineCalibrator` offers and reports: the contract between the front end and a method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.observability import Weakness
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.sensor_faults.cut_off import Clipped
from magyc_gtsam.sensor_faults.full_scale import ClippedField
from magyc_gtsam.sensor_faults.stuck import Stuck


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


class Engine(Protocol):
    """One method, running. Everything that decides its future is in `state`.

    The front end has checked and sorted the samples: per sensor the stamps ascend strictly from call to call,
    values are finite, and magnetometer samples that repeat the one before exactly are left out. The two
    streams may differ in rate and clock, and either may be empty in a call. A call may bring one
    sample or thousands; how a stream is cut into calls must not matter to the result.
    """

    def update(self, magnetometer: Samples, gyroscope: Samples) -> None:
        """Take new samples: T and rad/s at stamps in s."""

    def calibration(self) -> Calibration | None:
        """The current estimate, None before there is one. Does not change the state."""

    def converged(self) -> bool:
        """Whether covariance and stability of the estimate say that it may be used."""

    def progress(self) -> Progress:
        """How far it is and what is missing. Does not change the state."""

    def field(self) -> Array:
        """(n, 3) T, the samples of the magnetometer that are kept, oldest first. Does not change the state."""

    def changes(self) -> tuple[Change, ...]:
        """Steps in hard iron found so far, oldest first; empty where the method looks for none."""

    def state(self) -> Mapping[str, Array]:
        """All of the state as named arrays of numbers, flags or text (no objects), for `restore`."""

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from what `state` gave, bit for bit; called on a new engine with the same options."""
