"""The median of a few numbers, without the overhead of `np.median`, which exceeds the cost of its partition."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


def median(values: Array) -> float:
    """Return the median of finite numbers (n,), n > 0."""
    upper = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, upper)[upper])
    ordered = np.partition(values, (upper - 1, upper))
    return 0.5 * float(ordered[upper - 1] + ordered[upper])
