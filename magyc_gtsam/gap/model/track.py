"""The turns of a vehicle along a recording, summed so that their spread between any two times takes no time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.gyroscope_track import summed_rate
from magyc_gtsam.factors.chain.rotations import Array

_SOME = 100_000  # times, of longer logs at most twice as many
_ALIKE = 1.0  # rad, from which all rotations are alike


class Track(NamedTuple):
    """The integral of a rate of turn at m times.

    Attributes:
        time: (m,) s.
        total, square: (m + 1, 3) sums of the angles before each time, rad, and of their squares, rad².
    """

    time: Array
    total: Array
    square: Array

    @classmethod
    def of(cls, time: Array, rate: Array) -> Track:
        """Sum up rates (n, 3), rad/s, at times (n,), s."""
        some = slice(None, None, max(len(time) // _SOME, 1))
        angle = summed_rate(time, rate)[some]
        angle = angle - angle.mean(axis=0)
        total, square = (np.pad(np.cumsum(part, axis=0), ((1, 0), (0, 0))) for part in (angle, angle**2))
        return cls(time[some], total, square)

    def turned(self, start: Array, end: Array) -> Array:
        """Return the root mean square rotation (...), rad, from each start to each end (...), s; at most 1."""
        first, last = (np.searchsorted(self.time, each, side="right") for each in (start, end))
        count = np.maximum(last - first, 1)[..., None]
        mean, square = ((each[last] - each[first]) / count for each in (self.total, self.square))
        result: Array = np.minimum(np.sqrt(np.maximum((square - mean**2).sum(axis=-1), 0.0)), _ALIKE)
        return result
