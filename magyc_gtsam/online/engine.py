"""What an engine of `OnlineCalibrator` offers: the contract between the front end and a method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.online.values import Change, Progress
from magyc_gtsam.recording import Array, Samples


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

    def changes(self) -> tuple[Change, ...]:
        """Steps in hard iron found so far, oldest first; empty where the method looks for none."""

    def state(self) -> Mapping[str, Array]:
        """All of the state as named arrays of numbers, flags or text (no objects), for `restore`."""

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from what `state` gave, bit for bit; called on a new engine with the same options."""
