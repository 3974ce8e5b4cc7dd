"""What a log holds, before anything is calibrated with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.chain.gyroscope_track import summed_rate
from magyc_gtsam.recording import Array


@dataclass(frozen=True)
class Source:
    """One topic, message or group of columns of a log.

    Args:
        name: as `read` takes it.
        type: message type, or the unit of columns.
        count: samples.
        span: first and last stamp, s since the log's first stamp; None where the log does not say.
        serves_as: what `read` could use it for ("magnetic_field", "angular_rate", "acceleration",
            "attitude", "channel").
    """

    name: str
    type: str
    count: int
    span: tuple[float, float] | None
    serves_as: tuple[str, ...] = ()

    @property
    def rate(self) -> float | None:
        """Mean samples per second; None where it cannot be told."""
        if self.span is None or self.count < 2 or self.span[1] <= self.span[0]:
            return None
        return (self.count - 1) / (self.span[1] - self.span[0])


@dataclass(frozen=True)
class LogInfo:
    """Description of a log.

    Args:
        path: the file.
        format: "MCAP (ROS 2)", "CSV", "PX4 ULog" or "ArduPilot dataflash".
        duration: s.
        sources: all topics, messages or columns.
        warnings: what had to be done to read it, and what is wrong with it.
        problem: why `read` makes no recording of it, None where it does.
        turned: rad, the path that the attitude went; None without a gyroscope, or where there is a problem.
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
        """Whether `read` makes a recording of it."""
        return self.problem is None


def turned(time: Array, rate: Array) -> float:
    """rad; in steps of a second, so that the noise of the samples does not add up, nor the usual bias."""
    angle = summed_rate(time, rate - np.median(rate, axis=0))
    seconds = np.arange(time[0], time[-1], 1.0)
    steps = np.diff([np.interp(seconds, time, column) for column in angle.T])
    return float(np.linalg.norm(steps, axis=0).sum())
