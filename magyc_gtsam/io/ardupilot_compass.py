"""Undo the compass correction that ArduPilot applies before it logs the field.

ArduPilot logs M · scale · (raw + offset) + motor, milligauss in the vehicle's frame: M from COMPASS_DIA and
COMPASS_ODI, scale from COMPASS_SCALE, motor from the current or throttle. Before compensation per motor (2018) it
logged M · (raw + offset + motor). Field, offset and motor are logged as integers, truncated towards zero; each counts
as the middle of what its number stands for. Truncated fields make the soft iron wrong by 0.0016, at a sigma of 0.0005.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.ardupilot_orientation import custom_of, external_of, number_of, slot_of, suffix_of, turn_of
from magyc_gtsam.recording.autopilot import Place

Array = NDArray[np.float64]

_SCALES = (1 / 1.5, 1.5)  # ArduPilot ignores a scale outside this range


def undo(
    logged: Array,
    offset: Array,
    motor: Array,
    which: NDArray[np.int64],
    parameters: Sequence[dict[str, float]],
    instance: int,
    last: NDArray[np.int64] | None = None,
) -> tuple[Array, Array, tuple[str, ...]]:
    """Return the raw field (n, 3) in milligauss, the sigmas (3,) of the offset that was undone, and notes.

    Args:
        logged: (n, 3) milligauss, corrected.
        offset: (n, 3) milligauss, as logged with each sample.
        motor: (n, 3) milligauss, as logged with each sample.
        which: (n,) index of the set of parameters in force.
        parameters: the sets of parameters.
        instance: number of the compass in the log.
        last: (k,) for each set, the index of the one into whose orientation readings are turned; None for the last.

    Raises:
        MagycError: the log has no compass parameters, or the order of its corrections is unknown.
    """
    raw = np.empty_like(logged)
    known = np.ones(logged.shape, dtype=bool)
    logged, motor = _not_truncated(logged), _not_truncated(motor)
    notes: list[str] = []
    for index in np.unique(which):
        rows = which == index
        current = parameters[index]
        suffix = suffix_of(slot_of(current, instance))
        _check_complete(current, suffix)
        matrix, scale = _matrix(current, suffix), _scale(current, suffix)
        exact = np.array([current[f"COMPASS_OFS{suffix}_{axis}"] for axis in "XYZ"])
        # The parameter has the digits that were truncated, unless ArduPilot learned the offset in flight.
        # Offsets that are learned may come back to the same whole number, with another fraction.
        fits = np.logical_and.accumulate((np.trunc(exact) == np.trunc(offset[rows])).all(axis=1))
        known[rows] = fits[:, None]
        added = np.where(fits[:, None], exact, _not_truncated(offset[rows]))
        if "COMPASS_PMOT_EN" in current or f"COMPASS_SCALE{suffix}" in current:
            field = np.linalg.solve(matrix, (logged[rows] - motor[rows]).T).T / scale
        elif motor[rows].any() and not np.array_equal(matrix, np.eye(3)):
            raise MagycError(
                f"COMPASS_DIA{suffix}, COMPASS_ODI{suffix} and a motor correction were applied in an order "
                "that depends on the firmware's version, and cannot be undone; use a log without motor correction"
            )
        else:
            field = np.linalg.solve(matrix, logged[rows].T).T - motor[rows]
        end = parameters[-1 if last is None else last[index]]
        before, after = (turn_of(one, slot_of(one, instance)) for one in (current, end))
        raw[rows] = _turned(field - added, before, after)
        if before is not None and after is not None and not np.allclose(before, after):
            name, number = number_of(current, slot_of(current, instance))
            notes.append(f"{name} was {number} for {rows.sum()} samples, which are turned by the one at the end")
        parts = [f"offset ({', '.join(f'{x:.1f}' for x in added[0])}) milligauss"]
        if not np.array_equal(matrix, np.eye(3)):
            parts.append(f"COMPASS_DIA{suffix} and COMPASS_ODI{suffix} {np.array2string(matrix, precision=4)}")
        if scale != 1.0:
            parts.append(f"COMPASS_SCALE{suffix} {scale:.4f}")
        if motor[rows].any():
            parts.append(f"motor correction of up to {np.abs(motor[rows]).max():.0f} milligauss")
        notes.append(f"applied in flight and undone: {', '.join(parts)}")
    coarse = int((~known[:, 0]).sum())
    if coarse:
        notes.append(
            f"{coarse} offsets differ from the parameters (learned in flight) and are known to ±0.5 milligauss "
            "(0.05 µT), which the sigmas of the hard iron contain"
        )
    notes.append("ArduPilot logs the field in steps of 1 milligauss (0.1 µT), truncated: half a step is added")
    return raw, _sigma(offset, known), tuple(notes)


def _turned(value: Array, before: Array | None, after: Array | None) -> Array:
    """Return values (n, 3) of a compass that had one orientation as they were with another."""
    if before is None and after is None:
        return value
    if before is None or after is None:
        raise MagycError(
            "COMPASS_ORIENT changes within the log, to or from a rotation that is not known; cut the log"
        )
    turned: Array = value @ before @ after.T
    return turned


def _sigma(offset: Array, known: NDArray[np.bool_]) -> Array:
    """Return the sigmas (3,) of the mean of offsets (n, 3) that are logged as integers, unless they are `known`.

    All samples with the same number have the same error, which is uniform over half a step to either side.
    """
    result = np.zeros(3)
    for axis in range(3):
        _, counts = np.unique(offset[~known[:, axis], axis], return_counts=True)
        result[axis] = 0.5 / np.sqrt(3) * np.sqrt(np.square(counts / len(offset)).sum())
    return result


def _check_complete(parameters: dict[str, float], suffix: str) -> None:
    """Raise a MagycError if parameters of a compass's correction are missing: OFS, or a part of DIA and ODI.

    DIA and ODI are in every log of a firmware with a scale (2019) or a compensation per motor (2018).
    """
    if not any(name.startswith("COMPASS_") for name in parameters):
        raise MagycError(
            "the log holds no COMPASS_* parameters, so the correction in its MAG messages cannot be undone; "
            "use a log that begins with its parameters"
        )
    offset, *matrix = ([f"COMPASS_{part}{suffix}_{axis}" for axis in "XYZ"] for part in ("OFS", "DIA", "ODI"))
    of_matrix = [name for names in matrix for name in names]
    recent = any(name in parameters for name in ("COMPASS_PMOT_EN", f"COMPASS_SCALE{suffix}", *of_matrix))
    missing = [name for name in (*offset, *(of_matrix if recent else ())) if name not in parameters]
    if missing:
        raise MagycError(
            f"the log lacks {', '.join(missing)}, so the correction in its MAG messages cannot be undone; use a log "
            "that holds all its parameters, undamaged"
        )


def _not_truncated(whole: Array) -> Array:
    """Return the mean of the numbers that are truncated towards zero to a whole one; others stay."""
    result: Array = np.where(whole == np.trunc(whole), whole + 0.5 * np.sign(whole), whole)
    return result


def place_of(parameters: dict[str, float], instance: int) -> Place:
    """Return the place of a compass's parameters, with the rotation that was applied before them."""
    slot = slot_of(parameters, instance)
    turned = turn_of(parameters, slot)
    if turned is None:
        name, number = number_of(parameters, slot)
        return Place(slot, problem=f"{name} {number} of the log is not a rotation that is known; set another")
    custom, fixed = custom_of(parameters, slot), ""
    if external_of(parameters, slot) is False:
        fixed = "the compass is inside the autopilot, which turns it only with its board"
    elif not custom:
        fixed = "both custom rotations of ArduPilot are in use by the board or other compasses"
    return Place(
        slot,
        mounting=tuple(map(tuple, turned.tolist())),
        custom=custom,
        fixed=fixed,
        to_clear=_of_motors(parameters, slot),
    )


def _of_motors(parameters: dict[str, float], slot: int) -> tuple[str, ...]:
    """Return the names of the parameters by which a compass is corrected for the motors, which `undo` takes back."""
    names = (
        [f"COMPASS_MOT{suffix_of(slot)}_{axis}" for axis in "XYZ"] if parameters.get("COMPASS_MOTCT", 0) else []
    )
    if slot == 0:  # per motor only for the first compass
        names.append("COMPASS_PMOT_EN")
    return tuple(name for name in names if parameters.get(name, 0.0))


def motors_of(parameters: dict[str, float], place: Place) -> tuple[int, tuple[str, ...]]:
    """Return `Autopilot.compensation`, and `Autopilot.others` beside the compass of a place."""
    others = (f"COMPASS_MOT{suffix_of(slot)}_{axis}" for slot in range(3) if slot != place.slot for axis in "XYZ")
    return int(parameters.get("COMPASS_MOTCT", 0)), tuple(n for n in others if parameters.get(n, 0.0))


def _matrix(parameters: dict[str, float], suffix: str) -> Array:
    """Return the matrix (3, 3) of COMPASS_DIA and COMPASS_ODI."""
    dx, dy, dz = (parameters.get(f"COMPASS_DIA{suffix}_{axis}", 0.0) for axis in "XYZ")
    ox, oy, oz = (parameters.get(f"COMPASS_ODI{suffix}_{axis}", 0.0) for axis in "XYZ")
    if dx == dy == dz == 0:
        return np.eye(3)  # ArduPilot treats it as never calibrated
    matrix = np.array([[dx, ox, oy], [ox, dy, oz], [oy, oz, dz]])
    if abs(np.linalg.det(matrix)) < 1e-6:
        raise MagycError(
            f"COMPASS_DIA{suffix}, COMPASS_ODI{suffix}: the matrix is singular, so the correction cannot be undone"
        )
    return matrix


def _scale(parameters: dict[str, float], suffix: str) -> float:
    scale = parameters.get(f"COMPASS_SCALE{suffix}", 0.0)
    return scale if _SCALES[0] <= scale <= _SCALES[1] else 1.0
