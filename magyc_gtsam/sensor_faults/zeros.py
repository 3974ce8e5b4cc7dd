"""Detect zeros on all axes of a magnetometer: placeholders, since no measured field is exactly zero on three axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.recording import Array, Samples


@dataclass(frozen=True)
class NoValues:
    """Samples that are zero on all axes: their number, and their share of all samples."""

    count: int
    share: float

    @property
    def where(self) -> str:
        """Return how many there are."""
        return (
            f"magnetic_field: {self.count} samples are zero on all axes of the magnetometer and stand for no value "
            f"({self.share:.1%} of its samples)"
        )


class Zeros:
    """Find the samples that are zero on all axes; a `gate.Detector`."""

    pending = np.inf

    def __init__(self) -> None:
        self._latest = np.empty(0)  # s, stamps of the zeros of the last block
        self._taken = self._count = 0

    def observe(self, block: Samples) -> None:
        """Take the next samples."""
        self._latest = block.time[~block.value.any(axis=1)]
        self._taken += len(block.time)
        self._count += len(self._latest)

    def rejects(self, time: Array) -> np.ndarray:
        """Return (n,) bool: the samples at `time` (n,) that were zero."""
        return np.isin(time, self._latest) if len(self._latest) else np.zeros(len(time), dtype=bool)

    def finding(self) -> NoValues | None:
        """Return what was found so far, or None."""
        return NoValues(self._count, self._count / self._taken) if self._count else None

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        return {"counts": np.array([self._taken, self._count])}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._taken, self._count = (int(v) for v in state["counts"])
