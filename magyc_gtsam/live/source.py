"""What sources of samples that are still coming have in common."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from magyc_gtsam.recording import Samples

SENSORS = ("magnetic_field", "angular_rate")


def none() -> Samples:
    """No samples."""
    return Samples(np.empty(0), np.empty((0, 3)))


class NewSamples(NamedTuple):
    """New samples of both sensors, T and rad/s at their own stamps in s, in the order in which they came."""

    magnetometer: Samples
    gyroscope: Samples

    def __bool__(self) -> bool:
        return bool(len(self.magnetometer.time) or len(self.gyroscope.time))


def nothing() -> NewSamples:
    """No samples of either sensor."""
    return NewSamples(none(), none())


class LiveSource(Protocol):
    """Samples as they come.

    Attributes:
        name: what to call it.
        ended: nothing will come any more.
        received: bytes that have come so far.
        lost: messages, lines or records that are known to be lost, or could not be used.
        notes: what had to be left out so far, one sentence each, oldest first.
        waiting_for: what has not been seen yet of what is needed, "" for nothing.
    """

    name: str
    ended: bool
    received: int
    notes: list[str]

    @property
    def lost(self) -> int: ...

    @property
    def waiting_for(self) -> str: ...

    def read(self, wait: float) -> NewSamples:
        """What has come since the last call; where that is nothing, wait for at most so many seconds."""

    def close(self) -> None:
        """Let go of file, socket or port."""
