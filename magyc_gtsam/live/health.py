"""The health of a live source: sampling rates, lost samples and lateness."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from magyc_gtsam.live.source import NewSamples
from magyc_gtsam.recording import Array

_MEMORY = 5.0  # s over which rate and lateness are measured
# s over which the quickest sample gives the offset between the two clocks; 50 ppm of drift are 3 ms in this time.
_CLOCK_MEMORY = 60.0
_LEAP = 60.0  # s; a longer step of the stamps is a pause or a wrong stamp: no samples are lost or late by it
_STEPS = 200  # last steps of the stamps, whose median is the period
_FEWEST_STEPS = 20  # needed to know the period
_MISSING = 1.6  # periods; a longer step has missing samples


@dataclass(frozen=True)
class StreamHealth:
    """The state of a live source.

    Attributes:
        rate: Hz, of magnetometer and gyroscope by their stamps, over the samples that arrived in the last 5 s.
        taken: number of samples so far.
        missing: number of samples missing so far, by the steps of the stamps up to a minute.
        late: s, largest delay of the last 5 s relative to the quickest sample of the minute before.
        link: s, one-way delay of the link; None if the source does not measure it.
    """

    rate: tuple[float, float] = (0.0, 0.0)
    taken: int = 0
    missing: int = 0
    late: float = 0.0
    link: float | None = None

    @property
    def sentence(self) -> str:
        """The state in one line."""
        share = self.missing / max(self.taken + self.missing, 1)
        delay = f"{self.late * 1e3:.0f} ms late" + (
            f", link {self.link * 1e3:.1f} ms" if self.link is not None else ""
        )
        return f"{self.rate[0]:.1f} and {self.rate[1]:.1f} Hz, {share:.1%} lost, {delay}"

    def to_dict(self) -> dict[str, Any]:
        """Return JSON types, with units in the names."""
        return {
            "rate_hz": list(self.rate),
            "taken": self.taken,
            "missing": self.missing,
            "late_s": self.late,
            "link_s": self.link,
            "sentence": self.sentence,
        }


class StreamMonitor:
    """Computes the `StreamHealth` of a source in constant memory."""

    def __init__(self) -> None:
        self._steps = (_Steps(), _Steps())
        self._blocks: deque[tuple[float, float, list[tuple[int, float]]]] = deque()
        self._quickest: deque[tuple[float, float]] = deque()
        self._link: float | None = None

    def take(self, batch: NewSamples, arrived: float, round_trip: float | None = None) -> None:
        """Add a batch of samples.

        Args:
            batch: the samples.
            arrived: s, on a clock that never goes back.
            round_trip: s, of the link, if the source measures it.
        """
        self._link = None if round_trip is None else round_trip / 2
        self._forget(arrived)
        if not batch:
            return
        counted = [steps.take(samples.time) for steps, samples in zip(self._steps, batch, strict=True)]
        behind = arrived - max(float(samples.time[-1]) for samples in batch if len(samples.time))
        late = 0.0
        if not self._quickest or behind - self._quickest[0][1] < _LEAP:
            while self._quickest and self._quickest[-1][1] >= behind:
                self._quickest.pop()
            self._quickest.append((arrived, behind))
            late = behind - self._quickest[0][1]
        self._blocks.append((arrived, late, counted))

    def _forget(self, now: float) -> None:
        """Drop batches that are too old to count."""
        while self._blocks and self._blocks[0][0] < now - _MEMORY:
            self._blocks.popleft()
        while self._quickest and self._quickest[0][0] < now - _CLOCK_MEMORY:
            self._quickest.popleft()

    @property
    def health(self) -> StreamHealth:
        """The present state."""
        late = max((late for _, late, _ in self._blocks), default=0.0)
        rates = []
        for sensor in range(2):
            count, elapsed = np.sum([counted[sensor] for _, _, counted in self._blocks] or [(0, 0.0)], axis=0)
            rates.append(float(count / elapsed) if elapsed > 0 else 0.0)
        return StreamHealth(
            (rates[0], rates[1]),
            sum(steps.count for steps in self._steps),
            sum(steps.missing for steps in self._steps),
            late,
            self._link,
        )


class _Steps:
    """The steps between the stamps of one sensor, and the samples that they miss."""

    def __init__(self) -> None:
        self.count = self.missing = 0
        self.last = -np.inf
        self._recent: Array = np.empty(0)

    def take(self, time: Array) -> tuple[int, float]:
        """Return the number of new steps, and their sum in s, without those that a wrong stamp makes."""
        if not len(time):
            return 0, 0.0
        self.count += len(time)
        steps = np.diff(time, prepend=self.last if np.isfinite(self.last) else time[0])
        steps = steps[(steps > 0) & (steps < _LEAP)]
        self.last = float(time[-1])
        self._recent = np.concatenate([self._recent, steps])[-_STEPS:]
        if len(self._recent) >= _FEWEST_STEPS and (period := float(np.median(self._recent))) > 0:
            wide = steps[steps > _MISSING * period]
            self.missing += int((np.round(wide / period) - 1).sum())
        return len(steps), float(steps.sum())
