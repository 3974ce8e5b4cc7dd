"""The mean over the last fifth of a growing series, which the MAGYC paper reports, in constant memory."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magyc_gtsam.recording import Array

LAST_SHARE = 0.2
_MOST = 1024  # running sums kept; exact up to that many estimates, then to a 500th of the series


class EstimateHistory:
    """Running sums of estimates (width,), thinned as their number grows.

    Args:
        width: number of elements of an estimate.
    """

    def __init__(self, width: int) -> None:
        self._counts = np.zeros(1)
        self._sums = np.zeros((1, width))
        self._count, self._sum, self._every = 0, np.zeros(width), 1

    def __len__(self) -> int:
        return self._count

    def add(self, estimate: Array) -> None:
        """Add the next estimate."""
        self._count += 1
        self._sum = self._sum + estimate
        if self._count % self._every == 0:
            self._counts = np.append(self._counts, self._count)
            self._sums = np.vstack([self._sums, self._sum])
        if len(self._counts) > _MOST:
            self._every *= 2
            kept = self._counts % self._every == 0
            self._counts, self._sums = self._counts[kept], self._sums[kept]

    def mean(self) -> Array:
        """Return the mean (width,) over the last fifth, which includes at least the last estimate."""
        since = self._count - max(int(LAST_SHARE * self._count), 1)
        place = int(np.searchsorted(self._counts, since, side="right")) - 1
        result: Array = (self._sum - self._sums[place]) / (self._count - self._counts[place])
        return result

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        return {
            "counts": self._counts,
            "sums": self._sums,
            "last": np.array([self._count, self._every, *self._sum]),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._counts, self._sums = state["counts"], state["sums"]
        self._count, self._every, self._sum = int(state["last"][0]), int(state["last"][1]), state["last"][2:]
