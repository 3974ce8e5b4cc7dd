"""Common parts of the detectors of single faulty samples: the stamps found, their number and their share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.recording import Array


@dataclass(frozen=True)
class FaultySamples:
    """The single faulty samples of a sensor.

    Attributes:
        sensor: "magnetic_field" or "angular_rate".
        what: what the samples do, a predicate.
        count: their number.
        share: their share of all samples.
    """

    sensor: str
    what: str
    count: int
    share: float

    @property
    def where(self) -> str:
        """The number of samples, as text."""
        return f"{self.sensor}: {self.count} samples {self.what} ({self.share:.1%} of its samples)"


class SingleSamples:
    """A `gate.Detector` of single samples, except for `observe`.

    Args:
        sensor: "magnetic_field" or "angular_rate".
        what: what the faulty samples do, a predicate.
    """

    def __init__(self, sensor: str, what: str) -> None:
        self.pending = np.inf
        self._sensor, self._what = sensor, what
        self._latest = np.empty(0)  # s, stamps of those found in the last block
        self._taken = self._count = 0

    def found(self, stamps: Array, taken: int) -> None:
        """Record the stamps (n,) s of the faulty samples found with a block of `taken` samples."""
        self._latest = stamps
        self._taken += taken
        self._count += len(stamps)

    def rejects(self, time: Array) -> np.ndarray:
        """Return (n,) bool: the samples at `time` (n,) that were found in the last block."""
        return np.isin(time, self._latest) if len(self._latest) else np.zeros(len(time), dtype=bool)

    def finding(self) -> FaultySamples | None:
        """Return the samples found so far, or None."""
        if not self._count:
            return None
        return FaultySamples(self._sensor, self._what, self._count, self._count / self._taken)

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        return {"counts": np.array([self._taken, self._count]), "pending": np.array(self.pending)}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._taken, self._count = (int(v) for v in state["counts"])
        self.pending = float(state["pending"])


def found_in_turn(detectors: Sequence[SingleSamples]) -> FaultySamples | None:
    """Combine the findings of detectors of one fault that run in series; None if the first found nothing."""
    first, *others = (detector.finding() for detector in detectors)
    for other in others:
        if first is not None and other is not None:
            share = first.share + (1 - first.share) * other.share
            first = replace(first, count=first.count + other.count, share=share)
    return first
