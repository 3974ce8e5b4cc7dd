"""The description of a log's contents."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.factors.chain.gyroscope_track import summed_rate
from magyc_gtsam.foreign_text import counted
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.stamps import Hole, holes

_MOST_HOLES = 3  # that a remark names


@dataclass(frozen=True)
class Source:
    """One topic, message or group of columns of a log.

    Attributes:
        name: the name that `read` accepts.
        type: message type, or the unit of columns.
        count: number of samples.
        span: first and last stamp, s since time 0 of the recording, or the log's first stamp; None if unknown.
        serves_as: possible uses in `read` ("magnetic_field", "angular_rate", "acceleration", "attitude", "channel").
        paused: s of `span` in which the log has no samples of magnetometer and gyroscope.
    """

    name: str
    type: str
    count: int
    span: tuple[float, float] | None
    serves_as: tuple[str, ...] = ()
    paused: float = 0.0

    @property
    def rate(self) -> float | None:
        """Mean sampling rate outside of pauses, Hz; None if unknown."""
        if self.span is None or self.count < 2 or self.span[1] - self.span[0] <= self.paused:
            return None
        return (self.count - 1) / (self.span[1] - self.span[0] - self.paused)

    def with_pauses(self, pauses: Sequence[Hole]) -> Source:
        """Return the source with those parts of the pauses of its log that are within its span."""
        if self.span is None:
            return self
        first, last = self.span
        inside = (min(last, each.start + each.duration) - max(first, each.start) for each in pauses)
        return replace(self, paused=sum(max(0.0, each) for each in inside))


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
        first: ns, the stamp from which the spans of `sources` count; None if unknown.
        recorded: whether these spans are of the recorder's clock, not of the sensors' stamps.
    """

    path: str
    format: str
    duration: float
    sources: tuple[Source, ...]
    warnings: tuple[str, ...] = ()
    problem: str | None = None
    turned: float | None = None
    first: int | None = None
    recorded: bool = False

    def since(self, zero: int) -> LogInfo:
        """Return the description with its spans counted from a stamp (ns); as it is if that is of another clock."""
        if self.first is None or not 0 <= zero - self.first <= self.duration * 1e9:
            return self
        elapsed = (zero - self.first) / 1e9
        spans = (each.span and (each.span[0] - elapsed, each.span[1] - elapsed) for each in self.sources)
        sources = tuple(replace(each, span=span) for each, span in zip(self.sources, spans, strict=True))
        return replace(self, first=zero, sources=sources)

    @property
    def readable(self) -> bool:
        """Whether `read` can make a recording."""
        return self.problem is None


def turned(time: Array, rate: Array) -> float:
    """Return the total rotation (rad), summed over steps of 1 s without the median rate, so that noise does not add up.

    The rotation within holes of the stamps is unknown and left out.

    Args:
        time: (n,) s.
        rate: (n, 3) rad/s.
    """
    rate = rate - np.median(rate, axis=0)
    ends = [int(np.searchsorted(time, hole.start, side="right")) for hole in holes(time)]
    return sum(_turned(*piece) for piece in zip(np.split(time, ends), np.split(rate, ends), strict=True))


def _turned(time: Array, rate: Array) -> float:
    """Return the total rotation (rad) in samples without holes."""
    angle = summed_rate(time, rate)
    seconds = np.arange(time[0], time[-1], 1.0)
    steps = np.diff([np.interp(seconds, time, column) for column in angle.T])
    return float(np.linalg.norm(steps, axis=0).sum())


def hole_remarks(recording: Recording) -> Iterator[str]:
    """Yield a remark on the holes of each sensor's stamps, or one on those that both have."""
    sensors = {"the magnetometer has": holes(recording.time[recording.magnetic_field_stamped])}
    if recording.angular_rate is not None:
        sensors["the gyroscope has"] = holes(recording.gyroscope.time)
    if len(sensors) > 1 and len({*sensors.values()}) == 1:
        sensors = {"there are": sensors["the gyroscope has"]}
    for which, found in sensors.items():
        if found:
            spans = (f"from {h.start:.1f} to {h.start + h.duration:.1f} s" for h in found[:_MOST_HOLES])
            more = f" and in {counted(len(found) - _MOST_HOLES, 'more gap')}" if len(found) > _MOST_HOLES else ""
            yield f"{which} no samples {', '.join(spans)}{more}"
