"""The interface between `OnlineCalibrator` and the engine of a method, and the sensor faults in an engine's reports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.observability import Weakness
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.sensor_faults.cut_off import Clipped
from magyc_gtsam.sensor_faults.faults import SensorFaults
from magyc_gtsam.sensor_faults.full_scale import ClippedField
from magyc_gtsam.sensor_faults.stuck_finding import Stuck


@dataclass(frozen=True)
class Progress:
    """The progress of an online calibration.

    Attributes:
        time: stamp of the last sample taken, s; None before the first.
        duration: time from the first sample to the last, s.
        windows: number of windows formed so far.
        converged: as `OnlineCalibrator.converged`.
        sentence: the most important fact for the user: what is missing, which direction is weak and which motion helps,
            or that the estimate has converged.
        weak: the weak directions, worst first, each with the motion that would determine it.
        coverage: share of the sphere of field directions (sensor frame) visited, 0 to 1.
        left_out: number of samples left out so far: repeated or late stamps, values that are not finite, zeros in place
            of values, spikes, stuck axes, rotations beyond the full scale.
        stuck: axes that were or are stuck, the largest share first; their samples are not used.
        clipped: rotations beyond the gyroscope's full scale so far; windows are not linked across them.
        clipped_field: fields beyond the magnetometer's full scale so far, if there are enough to do harm; the samples
            are used, and the estimate is not converged.
        disagree: whether there is no calibration because the axes or units of the sensors disagree.
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
    disagree: bool = False


@dataclass(frozen=True, eq=False)
class Change:
    """A step in hard iron, for example when payload is moved or a magnet attached.

    Attributes:
        time, time_sigma: time of the step on the magnetometer's clock and its standard deviation, s.
        step, step_sigma: (3,) T, hard iron after the step minus before, and its standard deviation.
        before: the calibration before the step; None if there was none yet.
        after: the present calibration since the step; None until there is one.
    """

    time: float
    time_sigma: float
    step: Array
    step_sigma: Array
    before: Calibration | None
    after: Calibration | None


class Engine(Protocol):
    """A running method. Everything that determines its future results is in `state`.

    The front end has checked and sorted the samples: the stamps of each sensor ascend strictly from call to call,
    values are finite, and magnetometer samples that repeat the one before exactly are left out. The two streams may
    differ in rate and clock, and either may be empty in a call. The result must not depend on how a stream is cut into
    calls.
    """

    def update(self, magnetometer: Samples, gyroscope: Samples) -> None:
        """Take new samples: T and rad/s at stamps in s."""

    def calibration(self) -> Calibration | None:
        """Return the current estimate, None before there is one. Does not change the state."""

    def converged(self) -> bool:
        """Return whether the last refit is trusted and stable, without a new estimate. Does not change the state."""

    def progress(self) -> Progress:
        """Return the progress and the missing motion. Does not change the state."""

    def field(self) -> Array:
        """Return the magnetometer samples (n, 3) T that are kept, oldest first. Does not change the state."""

    def changes(self) -> tuple[Change, ...]:
        """Return the steps in hard iron found so far, oldest first; empty for a method that does not look for them."""

    def state(self) -> Mapping[str, Array]:
        """Return the whole state as named arrays of numbers, flags or text (no objects), for `restore`."""

    def restore(self, state: Mapping[str, Array]) -> None:
        """Restore the result of `state` bit for bit; called on a new engine with the same options."""


def refusal(faults: SensorFaults) -> str:
    """Return the reason why the remaining samples allow no calibration; empty if they do."""
    harmful = faults.stuck_bit, faults.stuck_rate_bit, faults.clipped, faults.clipped_field
    return "; ".join(fault.sentence for fault in harmful if fault is not None and fault.too_often)


def with_faults(progress: Progress, faults: SensorFaults) -> Progress:
    """Return the progress with the faults of the sensors added."""
    every, clipped, clipped_field = faults.stuck(progress.duration), faults.clipped, faults.clipped_field
    refused = refusal(faults)
    if not every and clipped is None and clipped_field is None and not refused and not faults.dropped:
        return progress
    now = faults.stuck(progress.duration, now=True)
    sentence = progress.sentence
    if refused:
        sentence = refused
    elif now:
        sentence = f"{now[0].where}: it is not used until it moves"
    elif clipped is not None and faults.cut_off.now:
        sentence = f"{clipped.where}: samples are not used across it"
    return replace(
        progress,
        sentence=sentence,
        converged=progress.converged and not refused,
        stuck=every,
        clipped=clipped,
        clipped_field=clipped_field,
        left_out=progress.left_out + faults.dropped,
    )


def with_left_out(calibration: Calibration | None, faults: SensorFaults, duration: float) -> Calibration | None:
    """Return the calibration after `duration` s with a note of the samples left out, as in the batch methods."""
    where = [
        fault.where
        for fault in (*faults.stuck(duration), *faults.single_samples, faults.clipped)
        if fault is not None
    ]
    refused = refusal(faults)
    if calibration is None or not (where or refused):
        return calibration
    diagnostics = {**calibration.diagnostics} | ({"left_out": where} if where else {})
    if refused:
        return replace(calibration, converged=False, message=refused, diagnostics=diagnostics)
    message = f"{calibration.message}; left out: {'; '.join(where)}"
    return replace(calibration, message=message, diagnostics=diagnostics)
