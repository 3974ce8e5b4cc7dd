"""The interface of live sources of samples."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from magyc_gtsam.recording import Samples

SENSORS = ("magnetic_field", "angular_rate")
MEANS = (  # noted of a log that says so, which an MCAP file does at its end
    "the angular rates of this log are means over the intervals before their stamps; unless they were read so, run "
    "again with --angular-rate-is interval-mean"
)


def none() -> Samples:
    """Return zero samples of one sensor."""
    return Samples(np.empty(0), np.empty((0, 3)))


def samples_of(rows: list[list[float]]) -> Samples:
    """Return the samples in rows [time, x, y, z]."""
    if not rows:
        return none()
    table = np.array(rows)
    return Samples(table[:, 0], table[:, 1:])


class NewSamples(NamedTuple):
    """New samples of both sensors in T and rad/s, each with its stamps in s, in the order of arrival."""

    magnetometer: Samples
    gyroscope: Samples

    def __bool__(self) -> bool:
        return bool(len(self.magnetometer.time) or len(self.gyroscope.time))


def nothing() -> NewSamples:
    """Return zero samples of both sensors."""
    return NewSamples(none(), none())


class LiveSource(Protocol):
    """A source of samples while they are measured.

    Attributes:
        name: the source's name in messages.
        ended: whether the source has ended.
        received: number of bytes so far.
        lost: number of messages, lines or records that were lost or invalid.
        notes: remarks on data that was left out, one sentence each, oldest first.
        waiting_for: needed data that has not arrived yet, in words; "" for none.
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
        """Return the samples since the last call; if there are none, wait for up to `wait` s."""

    def close(self) -> None:
        """Close the file, socket or port."""
