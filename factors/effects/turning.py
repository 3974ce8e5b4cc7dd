"""The turn of a sensor within the last moments, by which an axis that is read late shows an earlier attitude."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array

_KEPT = 4  # delays: one of each axis, and one that grows

Grows = tuple[float, float] | None


def line(time: Array, start: float, end: float) -> Array:
    """Return a line (n,) over times (n,) that grows by 1 from `start` to `end`, and is 0 halfway."""
    return (time - start) / (end - start) - 0.5


@dataclass(frozen=True, eq=False)
class Turning:
    """The rate of turn of a sensor, and the rows at which its turn is asked for.

    Attributes:
        time, rate: (G,) s, (3, G) rad/s, in the sensor's axes.
        rows: (M,) s, the times of the samples.
        mean: function that returns the means (..., n) of values (..., M) where rows are means over several samples.
    """

    time: Array
    rate: Array
    rows: Array
    mean: Callable[[Array], Array] = lambda values: values
    _known: dict[tuple[float, Grows], tuple[Array, Array]] = field(default_factory=dict, init=False, repr=False)

    def within(self, delay: float, grows: Grows = None) -> tuple[Array, Array]:
        """Return the integral (3, n) of the rate over the last `delay` s, rad, and the rate (3, n), rad/s, before it.

        Before the first sample the rate is that of the first. A model asks for the same delays several times.

        Args:
            delay: s.
            grows: (start, end) s, between which the delay grows by `delay`, and is 0 halfway; None if it is constant.
        """
        if (delay, grows) not in self._known:
            share = 1.0 if grows is None else line(self.rows, *grows)
            then, rate = self._until(self.rows - delay * share)
            self._known[delay, grows] = self.mean(self._now - then), self.mean(rate)
            for oldest in list(self._known)[:-_KEPT]:
                del self._known[oldest]
        return self._known[delay, grows]

    @cached_property
    def _now(self) -> Array:
        return self._until(self.rows)[0]

    @cached_property
    def _angle(self) -> Array:
        steps = 0.5 * (self.rate[:, 1:] + self.rate[:, :-1]) * np.diff(self.time)
        return np.concatenate([np.zeros((3, 1)), np.cumsum(steps, axis=1)], axis=1)

    def _until(self, when: Array) -> tuple[Array, Array]:
        """Return the integral (3, M) of the rate until some times (M,), and the rate (3, M) then."""
        rate = np.stack([np.interp(when, self.time, axis) for axis in self.rate])
        last = np.clip(np.searchsorted(self.time, when, side="right") - 1, 0, len(self.time) - 1)
        return self._angle[:, last] + 0.5 * (self.rate[:, last] + rate) * (when - self.time[last]), rate
