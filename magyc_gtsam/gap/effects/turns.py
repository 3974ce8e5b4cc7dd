"""How far a vehicle turns between two times: without turns the hard iron and the field of the place look alike."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.model.twin import Twin

_ALIKE = 1.0  # rad, from which all rotations are alike


def turned(twin: Twin, start: Array, end: Array) -> Array:
    """Return the root mean square rotation (...), rad, of the vehicle from each start to each end (...), s; at most 1.

    The rate is that beyond the one at rest. Beside a jump of the iron that is not yet in it a model has a wrong bias,
    with which a rest turns: that of BROAD 32 by 0.1 rad within two seconds.
    """
    (time, angle), at_rest = twin.problem.angle, twin.problem.rate_at_rest
    bias = twin.model.parameters[9:12] if at_rest is None else at_rest
    angle = angle - bias * (time - time[0])[:, None]
    angle -= angle.mean(axis=0)
    total, square = (np.pad(np.cumsum(part, axis=0), ((1, 0), (0, 0))) for part in (angle, angle**2))
    first, last = (np.searchsorted(time, each, side="right") for each in (start, end))
    count = np.maximum(last - first, 1)[..., None]
    variance = (square[last] - square[first]) / count - ((total[last] - total[first]) / count) ** 2
    result: Array = np.minimum(np.sqrt(np.maximum(variance.sum(axis=-1), 0.0)), _ALIKE)
    return result
