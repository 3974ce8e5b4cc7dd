"""The description of a log's contents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.chain.gyroscope_track import summed_rate
from magyc_gtsam.recording import Array


@dataclass(frozen=True)
class Source:
    """One topic, message or group of columns of a log.

    Attributes:
        name: the name that `read` accepts.
        type: message type, or the unit of columns.
        count: number of samples.
        span: first and last stamp, s since the log's first stamp; None if unknown.
        serves_as: possible uses in `read` ("magnetic_field", "angular_rate", "acceleration", "attitude", "channel").
    """

    name: str
    type: str
    count: int
    span: tuple[float, float] | None
    serves_as: tuple[str, ...] = ()

    @property
    def rate(self) -> float | None:
        """Mean sampling rate, Hz; None if unknown."""
        if self.span is None or self.count < 2 or self.span[1] <= self.span[0]:
            return None
        return (self.count - 1) / (self.span[1] - self.span[0])


@dataclass(frozen=True)
class LogInfo:
    """The description of a log.

    Attributes:
        path: the file.
        format: such as "MCAP (ROS 2)", "CSV", "PX4 ULog" or "ArduPilot dataflash".
        duration: s.
        sources: all topics, messages or columns.
        warnings: remarks on conversions, omissions and damage.
        problem: why `read` cannot make a recording; None if it can.
        turned: rad, total rotation of the instrument; None without a gyroscope or if there is a problem.
    """

    path: str
    format: str
    duration: float
    sources: tuple[Source, ...]
    warnings: tuple[str, ...] = ()
    problem: str | None = None
    turned: float | None = None

    @property
    def readable(self) -> bool:
        """Whether `read` can make a recording."""
        return self.problem is None


def turned(time: Array, rate: Array) -> float:
    """Return the total rotation (rad), summed over steps of 1 s without the median rate, so that noise does not add up.

    Args:
        time: (n,) s.
        rate: (n, 3) rad/s.
    """
    angle = summed_rate(time, rate - np.median(rate, axis=0))
    seconds = np.arange(time[0], time[-1], 1.0)
    steps = np.diff([np.interp(seconds, time, column) for column in angle.T])
    return float(np.linalg.norm(steps, axis=0).sum())
