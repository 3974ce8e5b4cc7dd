"""What detectors of single faulty samples share, and the detectors of rows that are zero on all axes.

Such rows are placeholders that a driver or a bus writes in place of a measurement. No measured field is exactly zero on
three axes. A rate can be, if the gyroscope is at rest, but not if the readings before and after are on the same side of
zero, many steps of the sensor away from it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.recording import Array, Samples


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


# Consecutive zeros of a gyroscope. In a simulation without noise a vehicle may stop for longer; much longer runs are
# left to `stuck`.
_LONGEST_RUN = 5
# Steps of the gyroscope between zero and the readings around a placeholder. A gyroscope at rest has such zeros in at
# most 1 of 10⁵ samples, with noise of ten steps (normal noise, independent axes).
_BESIDE = 10.0
# Share of the largest reading below which a change is not a step of the sensor but rounding by a unit conversion.
_ROUNDING = 1e-6


class Zeros(SingleSamples):
    """Find the placeholders of the magnetometer: all samples that are zero on all axes."""

    def __init__(self) -> None:
        super().__init__("magnetic_field", "are zero on all axes of the magnetometer and stand for no value")

    def observe(self, block: Samples) -> None:
        """Take the next samples."""
        self.found(block.time[~block.value.any(axis=1)], len(block.time))


class ZeroRates(SingleSamples):
    """Find the placeholders of the gyroscope: short runs of zeros between readings that are far from zero."""

    def __init__(self) -> None:
        super().__init__("angular_rate", "are zero on all axes of the gyroscope and stand for no value")
        self._open = np.full((1, 4), np.nan)  # time and value of the last reading, and of the zeros since
        self._step = np.inf  # rad/s, smallest change of any axis
        self._largest = 0.0  # rad/s, largest reading of any axis

    def observe(self, block: Samples) -> None:
        """Take the next samples."""
        carried = len(self._open)
        rows = np.vstack([self._open, np.column_stack(block)])
        change = np.abs(np.diff(rows[carried - 1 :, 1:], axis=0))
        largest = np.maximum.accumulate(np.append(self._largest, np.abs(block.value).max(axis=1)))
        steps = np.where(change > _ROUNDING * largest[1:, None], change, np.inf)
        zero = np.asarray(~rows[:, 1:].any(axis=1))
        zero[0] = False  # the last reading, or none yet
        if zero.any():
            before = np.full(carried, self._step)
            step = np.append(before, np.minimum(np.minimum.accumulate(steps.min(axis=1)), self._step))
            self.found(_placeholders(rows, zero, step), len(block.time))
        else:
            self.found(block.time[:0], len(block.time))
        self._step, self._largest = float(steps.min(initial=self._step)), float(largest[-1])
        last = int(np.flatnonzero(~zero)[-1])
        self._open = rows[last : last + _LONGEST_RUN + 2].copy()
        self.pending = float(self._open[1, 0]) if 0 < len(self._open) - 1 <= _LONGEST_RUN else np.inf

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        return {**super().state(), "open": self._open, "numbers": np.array([self._step, self._largest])}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        super().restore(state)
        self._open = state["open"]
        self._step, self._largest = (float(v) for v in state["numbers"])


def has_placeholders(gyroscope: Samples) -> bool:
    """Return whether zeros of a gyroscope stand for no value; one at rest that counts in steps has others."""
    rows = np.column_stack(gyroscope)
    zero = np.asarray(~gyroscope.value.any(axis=1))
    zero[0] = False
    if not zero.any():
        return False
    change = np.abs(np.diff(gyroscope.value, axis=0))
    step = change.min(where=change > _ROUNDING * np.abs(gyroscope.value).max(), initial=np.inf)
    return len(_placeholders(rows, zero, np.full(len(rows), step))) > 0


def _placeholders(rows: Array, zero: np.ndarray, step: Array) -> Array:
    """Return the stamps of the placeholders among rows (n, 4) that are `zero` (n,), with the steps (n,) so far."""
    first, after = np.flatnonzero(np.diff(zero, append=False)).reshape(-1, 2).T + 1
    over = (after < len(rows)) & (after - first <= _LONGEST_RUN)
    first, after = first[over], after[over]
    before, behind = rows[first - 1, 1:], rows[after, 1:]
    apart = np.where(before * behind > 0, np.minimum(np.abs(before), np.abs(behind)), 0.0).max(axis=1)
    far = apart > _BESIDE * step[after]
    inside = np.zeros(len(rows), dtype=int)
    inside[first[far]], inside[after[far]] = 1, -1
    stamps: Array = rows[np.cumsum(inside) > 0, 0]
    return stamps
