"""How far a vehicle turns between two times: without turns the hard iron and the field of the place look alike."""

from __future__ import annotations

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.model.twin import Twin


def turned(twin: Twin, start: Array, end: Array) -> Array:
    """Return the root mean square rotation (...), rad, of the vehicle from each start to each end (...), s; at most 1.

    The rate is that beyond the one at rest. Beside a jump of the iron that is not yet in it a model has a wrong bias,
    with which a rest turns: that of BROAD 32 by 0.1 rad within two seconds.
    """
    return twin.problem.track(twin.model.parameters[9:12]).turned(start, end)
