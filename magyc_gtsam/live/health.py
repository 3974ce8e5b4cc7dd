"""How a source does: its rate, what is lost on the way, and how late it comes."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from magyc_gtsam.live.source import NewSamples
from magyc_gtsam.recording import Array

_MEMORY = 5.0  # s over which rate and lateness are taken
_CLOCK = 60.0  # s over which the quickest sample says how the two clocks stand: 50 ppm of drift are 3 ms
_STEPS = 200  # last steps of the stamps, whose median is the period
_KNOWN = 20  # steps from which the period is known
_MISSING = 1.6  # periods from which a step misses samples


@dataclass(frozen=True)
class StreamHealth:
    """What is known of a source.

    Attributes:
        rate: Hz of magnetometer and gyroscope by their stamps over the last five seconds of arrival.
        taken: samples so far.
        missing: samples that the steps of the stamps miss so far.
        late: s by which the last samples came later after their stamps than the quickest of the minute before.
        link: s from there to here, where the source measures it.
    """

    rate: tuple[float, float] = (0.0, 0.0)
    taken: int = 0
    missing: int = 0
    late: float = 0.0
    link: float | None = None

    @property
    def sentence(self) -> str:
        """One line."""
        share = self.missing / max(self.taken + self.missing, 1)
        delay = f"{self.late * 1e3:.0f} ms late" + (
            f", link {self.link * 1e3:.1f} ms" if self.link is not None else ""
        )
        return f"{self.rate[0]:.1f} and {self.rate[1]:.1f} Hz, {share:.1%} lost, {delay}"

    def to_dict(self) -> dict[str, Any]:
        """JSON types, units in the names."""
        values = asdict(self)
        return {
            "rate_hz": list(self.rate),
            "taken": self.taken,
            "missing": self.missing,
            "late_s": values["late"],
            "link_s": self.link,
            "sentence": self.sentence,
        }


class StreamMonitor:
    """Keeps `StreamHealth` up to date, in constant memory."""

    def __init__(self) -> None:
        self._steps = (_Steps(), _Steps())
        self._blocks: deque[tuple[float, float, tuple[int, int], tuple[float, float]]] = deque()
        self._quickest: deque[tuple[float, float]] = deque()
        self._link: float | None = None

    def take(self, batch: NewSamples, arrived: float, round_trip: float | None = None) -> None:
        """A batch that came at `arrived`, s on a clock that does not go back."""
        self._link = None if round_trip is None else round_trip / 2
        self._forget(arrived)
        if not batch:
            return
        for steps, samples in zip(self._steps, batch, strict=True):
            steps.take(samples.time)
        behind = arrived - max(float(samples.time[-1]) for samples in batch if len(samples.time))
        counts = (len(batch.magnetometer.time), len(batch.gyroscope.time))
        while self._quickest and self._quickest[-1][1] >= behind:
            self._quickest.pop()
        self._quickest.append((arrived, behind))
        late = behind - self._quickest[0][1]
        self._blocks.append((arrived, late, counts, (self._steps[0].last, self._steps[1].last)))

    def _forget(self, now: float) -> None:
        while self._blocks and self._blocks[0][0] < now - _MEMORY:
            self._blocks.popleft()
        while self._quickest and self._quickest[0][0] < now - _CLOCK:
            self._quickest.popleft()

    @property
    def health(self) -> StreamHealth:
        """As it is now."""
        late = max((late for _, late, _, _ in self._blocks), default=0.0)
        rates = []
        for sensor in range(2):
            ends = [lasts[sensor] for _, _, _, lasts in self._blocks]
            came = sum(counts[sensor] for _, _, counts, _ in list(self._blocks)[1:])
            rates.append(came / (ends[-1] - ends[0]) if len(ends) > 1 and ends[-1] > ends[0] else 0.0)
        return StreamHealth(
            (rates[0], rates[1]),
            sum(steps.count for steps in self._steps),
            sum(steps.missing for steps in self._steps),
            late,
            self._link,
        )


class _Steps:
    """The steps between the stamps of one sensor."""

    def __init__(self) -> None:
        self.count = self.missing = 0
        self.last = -np.inf
        self._recent: Array = np.empty(0)

    def take(self, time: Array) -> None:
        if not len(time):
            return
        self.count += len(time)
        steps = np.diff(time, prepend=self.last if np.isfinite(self.last) else time[0])
        steps = steps[steps > 0]
        self.last = max(self.last, float(time[-1]))
        self._recent = np.concatenate([self._recent, steps])[-_STEPS:]
        if len(self._recent) >= _KNOWN and (period := float(np.median(self._recent))) > 0:
            wide = steps[steps > _MISSING * period]
            self.missing += int((np.round(wide / period) - 1).sum())
