"""The median of a few numbers, without the ceremony of `np.median`, which takes longer than its partition."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


def median(values: Array) -> float:
    """Of finite numbers (n,), n > 0: the middle one, or the mean of the two in the middle."""
    upper = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, upper)[upper])
    ordered = np.partition(values, (upper - 1, upper))
    return 0.5 * float(ordered[upper - 1] + ordered[upper])
