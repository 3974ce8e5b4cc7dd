"""Undo the offset that ArduPilot subtracts from a gyroscope before it logs the angular rate.

ArduPilot logs B (raw − offset), rad/s: the offset from INS_GYROFFS, B from AHRS_ORIENTATION. The result here is B raw.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.io.ardupilot_orientation import BOARD, number_of, turn_of
from magyc_gtsam.recording.autopilot import Place, ardupilot_offset

Array = NDArray[np.float64]


def undo(
    logged: Array,
    which: NDArray[np.int64],
    parameters: Sequence[dict[str, float]],
    instance: int,
    last: NDArray[np.int64],
) -> tuple[Array, str, Place]:
    """Return the raw angular rate (n, 3) rad/s in the vehicle's axes, a note, and the place of the offset.

    An offset that the log does not tell remains subtracted, and the place says so: only the rest is estimated.

    Args:
        logged: (n, 3) rad/s.
        which: (n,) index of the set of parameters in force.
        parameters: the sets of parameters.
        instance: number of the gyroscope in the log.
        last: (k,) for each set, the index of the one into whose orientation readings are turned.
    """
    name = ardupilot_offset(instance)
    used = [parameters[index] for index in np.unique(which)]
    boards, problem = _boards(parameters), ""
    if any(f"{name}_{axis}" not in one for one in (*used, parameters[-1]) for axis in "XYZ"):
        problem = f"the log does not hold {name}_*"
    if boards is None:
        number = next(number_of(one, None)[1] for one in parameters if turn_of(one, None) is None)
        problem = f"the log's {BOARD} {number} is not a rotation that is known"
    if problem or boards is None:
        note = f"{name}_* was subtracted in flight and is not undone: {problem}"
        return logged, note, Place(instance, problem=f"{note}; what was estimated is the rest")
    offsets = np.array([[one.get(f"{name}_{axis}", 0.0) for axis in "XYZ"] for one in parameters])
    text = ", ".join(f"{x:.5g}" for x in offsets[-1])
    place = Place(instance, axes=tuple(map(tuple, boards[-1].tolist())))
    return (
        turned(logged, which, parameters, last) + np.einsum("ni,nji->nj", offsets[which], boards[last[which]]),
        f"{name}_* was subtracted in flight and is undone: ({text}) rad/s",
        place,
    )


def turned(
    logged: Array, which: NDArray[np.int64], parameters: Sequence[dict[str, float]], last: NDArray[np.int64]
) -> Array:
    """Return readings (n, 3) of an inertial sensor as if the board's orientation had been the last one throughout."""
    boards = _boards(parameters)
    if boards is None:
        return logged
    turns = np.einsum("kij,klj->kil", boards, boards[last])  # of rows: first back into the board's axes
    result: Array = np.einsum("ni,nij->nj", logged, turns[which])
    return logged if np.allclose(turns, np.eye(3)) else result


def _boards(parameters: Sequence[dict[str, float]]) -> Array | None:
    """Return the rotations (k, 3, 3) of the board by sets of parameters; None if one is not known."""
    boards = [turn for one in parameters if (turn := turn_of(one, None)) is not None]
    return np.array(boards) if len(boards) == len(parameters) else None
