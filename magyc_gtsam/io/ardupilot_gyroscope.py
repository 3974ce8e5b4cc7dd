"""Undo the offset that ArduPilot subtracts from a gyroscope before it logs the angular rate.

ArduPilot logs B (raw − offset), rad/s: the offset from INS_GYROFFS, B from AHRS_ORIENTATION. The result here is B raw.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.px4_calibration import mounting
from magyc_gtsam.recording.autopilot import Place, ardupilot_offset

Array = NDArray[np.float64]


def undo(
    logged: Array, which: NDArray[np.int64], parameters: Sequence[dict[str, float]], instance: int
) -> tuple[Array, str, Place]:
    """Return the raw angular rate (n, 3) rad/s in the vehicle's axes, a note, and the place of the offset.

    An offset that the log does not tell remains subtracted, and the place says so: only the rest is estimated.

    Args:
        logged: (n, 3) rad/s.
        which: (n,) index of the set of parameters in force.
        parameters: the sets of parameters.
        instance: number of the gyroscope in the log.
    """
    name = ardupilot_offset(instance)
    orientation = int(parameters[-1].get("AHRS_ORIENTATION", 0))
    problem = "" if f"{name}_X" in parameters[-1] else f"the log does not hold {name}_*"
    try:
        board = mounting(orientation)
    except MagycError:
        board, problem = np.eye(3), f"the log's AHRS_ORIENTATION {orientation} is not a fixed rotation"
    if problem:
        note = f"{name}_* was subtracted in flight and is not undone: {problem}"
        return logged, note, Place(instance, problem=f"{note}; what was estimated is the rest")
    offsets = np.array([[one.get(f"{name}_{axis}", 0.0) for axis in "XYZ"] for one in parameters])
    text = ", ".join(f"{x:.5g}" for x in offsets[-1])
    place = Place(instance, axes=tuple(map(tuple, board.tolist())))
    return (
        logged + offsets[which] @ board.T,
        f"{name}_* was subtracted in flight and is undone: ({text}) rad/s",
        place,
    )
