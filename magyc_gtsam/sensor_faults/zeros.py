"""Detect rows that are zero on all axes in place of a measurement: placeholders of a driver or a bus.

No measured field is exactly zero on three axes. A rate can be, if the gyroscope is at rest, but not if the readings
before and after are on the same side of zero, many steps of the sensor away from it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.sensor_faults.single_samples import SingleSamples

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
            self.found(self._placeholders(rows, zero, step), len(block.time))
        else:
            self.found(block.time[:0], len(block.time))
        self._step, self._largest = float(steps.min(initial=self._step)), float(largest[-1])
        last = int(np.flatnonzero(~zero)[-1])
        self._open = rows[last : last + _LONGEST_RUN + 2].copy()
        self.pending = float(self._open[1, 0]) if 0 < len(self._open) - 1 <= _LONGEST_RUN else np.inf

    def _placeholders(self, rows: Array, zero: np.ndarray, step: Array) -> Array:
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

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        return {**super().state(), "open": self._open, "numbers": np.array([self._step, self._largest])}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        super().restore(state)
        self._open = state["open"]
        self._step, self._largest = (float(v) for v in state["numbers"])
