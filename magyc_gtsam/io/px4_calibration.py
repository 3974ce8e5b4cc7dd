"""Undo the calibration that PX4 applies to its sensors before it logs them, by the parameters in the log.

PX4 logs R (S (raw − offset)): S from CAL_MAGn_{X,Y,Z}SCALE and, since 1.11, {X,Y,Z}ODIAG, the offset from
CAL_MAGn_{X,Y,Z}OFF, R from CAL_MAGn_ROT (an external sensor) or SENS_BOARD_ROT and SENS_BOARD_{X,Y,Z}_OFF, and
in the same way for gyroscopes. The result here is R raw: raw values in the frame that all sensors share, and n and R.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.px4_thermal import in_the_way
from magyc_gtsam.recording.autopilot import Place

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_INSTANCES = range(4)
_CUSTOM_ROTATION = 100


@dataclass(frozen=True)
class Parameters:
    """The parameters at the start of the log, and their changes in it.

    Attributes:
        initial: {name: value}.
        changes: (stamp in µs, name, value), ascending.
    """

    initial: Mapping[str, float]
    changes: tuple[tuple[int, str, float], ...] = ()

    def epochs(self, *prefixes: str) -> tuple[Stamps, list[Mapping[str, float]]]:
        """Return the stamps (k,) in µs from which sets of the parameters with some prefixes are in force, and the sets.

        The first set is in force from the beginning.
        """
        starts, sets = [np.iinfo(np.int64).min], [dict(self.initial)]
        for stamp, name, value in self.changes:
            if name.startswith(prefixes):
                starts.append(stamp)
                sets.append(sets[-1] | {name: value})
        return np.array(starts, dtype=np.int64), list(sets)


def undo(
    kind: Literal["MAG", "GYRO"],
    logged: Array,
    stamp: Stamps,
    parameters: Parameters,
    device: int | None,
    *,
    corrected: bool,
    rotated: bool,
) -> tuple[Array, list[str], Place]:
    """Return raw values (n, 3) in the vehicle's frame, notes on what was undone, and the place of the parameters.

    Which parameters are those of the sensor, its rotation and its calibration may change within the log. The place is
    that at its end.

    Args:
        kind: kind of sensor.
        logged: (n, 3) in PX4's units (gauss, rad/s).
        stamp: (n,) µs.
        parameters: the parameters of the log.
        device: identifier of the sensor; None if the log does not name it.
        corrected: whether offset and scale were applied before logging.
        rotated: whether the rotation was applied before logging.

    Raises:
        MagycError: the log does not say which calibration was applied, or it cannot be undone.
    """
    starts, sets = parameters.epochs(f"CAL_{kind}", "SENS_BOARD_")
    epoch = np.searchsorted(starts, stamp, side="right") - 1
    value, notes, applied = np.empty_like(logged), list[str](), list[tuple[str, bytes]]()
    for number in np.unique(epoch):
        rows, current = epoch == number, sets[number]
        index, remarks = _index(kind, current, device, corrected)
        turn = _rotation(f"CAL_{kind}{index}_", current) if rotated else np.eye(3)
        value[rows], undone = logged[rows] @ turn, ""  # rows: x @ R is Rᵀx
        if corrected and index is not None:
            value[rows], undone = _uncorrected(kind, index, value[rows], current)
        applied.append((undone, turn.tobytes()))
        notes += [remark for remark in remarks if remark not in notes]
    notes += [undone for undone, _ in applied if undone][:1]
    if len(set(applied)) > 1:
        notes.append(f"CAL_{kind}n_* changed within the log; each sample was corrected by the values at its time")
    last = sets[-1]
    index, _ = _index(kind, last, device, corrected)
    rotation = _rotation(f"CAL_{kind}{index}_", last)
    place = replace(_place(kind, last, device, index), axes=tuple(map(tuple, rotation.tolist())))
    place = replace(
        place, thermal=in_the_way("TC_M" if kind == "MAG" else "TC_G", parameters.initial, device, place.slot)
    )
    if kind == "MAG" and index is not None and last.get(f"CAL_MAG{index}_ROT") == -1:
        place = replace(place, fixed="the compass is inside the autopilot, which turns it only with its board")
    if kind == "MAG" and not corrected and last.get("CAL_MAG_COMP_TYP", 0):
        names = (f"CAL_MAG{place.slot}_{axis}COMP" for axis in "XYZ")
        place = replace(place, to_clear=tuple(name for name in names if last.get(name, 0.0)))
    if not np.allclose(rotation, np.eye(3)):
        if rotated and index is None and not place.problem:
            why = f"the log does not say whether the sensor ({device}) turns with the board (SENS_BOARD_ROT)"
            place = replace(place, problem=f"{why}; calibrate it in PX4 once, and log again")
        angle = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
        notes.append(f"{kind}: values are in the vehicle's frame, {angle:.2f}° from the sensor's")
    return value @ rotation.T, notes, place


def motors_of(parameters: Parameters, place: Place) -> tuple[int, tuple[str, ...]]:
    """Return `Autopilot.compensation`, and `Autopilot.others` beside the magnetometer of a place."""
    last = parameters.epochs("CAL_MAG")[1][-1]
    others = (f"CAL_MAG{n}_{axis}COMP" for n in _INSTANCES if n != place.slot for axis in "XYZ")
    return int(last.get("CAL_MAG_COMP_TYP", 0)), tuple(name for name in others if last.get(name, 0.0))


def _uncorrected(kind: str, index: int, value: Array, parameters: Mapping[str, float]) -> tuple[Array, str]:
    """Return values (n, 3) in the sensor's axes without the parameters number `index`, and a note.

    Raises:
        MagycError: the motors' power was compensated for, or the scale is singular.
    """
    prefix = f"CAL_{kind}{index}_"
    if (
        kind == "MAG"
        and parameters.get("CAL_MAG_COMP_TYP", 0)
        and _vector(parameters, f"{prefix}{{}}COMP", 0.0).any()
    ):
        raise MagycError(
            f"{prefix}XCOMP.. corrected the magnetometer by the motors' power, which cannot be undone; "
            "read the uncorrected message if the log has it (magnetic_field='sensor_mag')"
        )
    offset, scale = _vector(parameters, f"{prefix}{{}}OFF", 0.0), _scale(prefix, parameters)
    unit = "gauss" if kind == "MAG" else "rad/s"
    text = ", ".join(f"{x:.5g}" for x in offset)
    extra = "" if np.allclose(scale, np.eye(3)) else f" and scale {np.array2string(scale, precision=4)}"
    note = f"{prefix}* was applied in flight and is undone: offset ({text}) {unit}{extra}"
    return np.linalg.solve(scale, value.T).T + offset, note


def _place(kind: str, parameters: Mapping[str, float], device: int | None, index: int | None) -> Place:
    """Return the place of a sensor's parameters; a sensor without any is given the first that are free."""
    if index is not None:
        return Place(index)
    if device is None:
        return Place(problem=f"the log does not say which CAL_{kind}n_* are those of the sensor")
    free = [n for n in _INSTANCES if not parameters.get(f"CAL_{kind}{n}_ID", 0)]
    if not free:
        return Place(problem=f"no CAL_{kind}n_ID is the sensor's ({device}), and all are in use by others")
    return Place(free[0], device)


def _index(
    kind: str, parameters: Mapping[str, float], device: int | None, corrected: bool
) -> tuple[int | None, list[str]]:
    """Return the number n of the CAL_MAGn or CAL_GYROn parameters of the sensor, None if it has none, and notes."""
    identifiers = {n: int(parameters.get(f"CAL_{kind}{n}_ID", 0)) for n in _INSTANCES}
    known = [n for n, identifier in identifiers.items() if identifier != 0]
    if device is not None:
        matching = [n for n in known if identifiers[n] == device]
        if not matching and corrected:
            return None, [f"no CAL_{kind}n_ID is the sensor's ({device}): no calibration had been applied"]
        return (matching[0] if matching else None), []
    if len(known) == 1:
        return known[0], []
    prime = int(parameters.get(f"CAL_{kind}_PRIME", 0))
    matching = [n for n in known if identifiers[n] == prime]
    if matching:
        return matching[0], [f"the log does not name the sensor; CAL_{kind}_PRIME ({prime}) is assumed"]
    if not corrected:
        return None, []
    if kind == "GYRO":  # the calibration estimates the remaining gyroscope bias anyway
        return None, ["the log does not say which CAL_GYROn_* was subtracted in flight, so it is kept"]
    if not known:
        raise MagycError(
            f"the log's parameters do not say which CAL_{kind}n_* calibration was applied (no CAL_{kind}n_ID "
            "is set), so it cannot be undone; use a log with its parameters, or one with the raw message"
        )
    raise MagycError(
        f"the log does not say which of CAL_{kind}n_* (n = {', '.join(map(str, known))}) was applied, so it "
        "cannot be undone; choose a message that names it (magnetic_field='vehicle_magnetometer', 'sensor_mag')"
    )


def _vector(parameters: Mapping[str, float], pattern: str, default: float) -> Array:
    """Return the values (3,) of three parameters, named by `pattern` with X, Y, Z in place of {}."""
    return np.array([float(parameters.get(pattern.format(axis), default)) for axis in "XYZ"])


def _scale(prefix: str, parameters: Mapping[str, float]) -> Array:
    """Return the scale matrix (3, 3)."""
    scale = np.diag(_vector(parameters, f"{prefix}{{}}SCALE", 1.0))
    off = _vector(parameters, f"{prefix}{{}}ODIAG", 0.0)
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        scale[i, j] = scale[j, i] = off[k]
    if abs(np.linalg.det(scale)) < 1e-6:
        raise MagycError(
            f"{prefix}*SCALE, {prefix}*ODIAG: the matrix is singular, so the calibration cannot be undone"
        )
    return scale


def _rotation(prefix: str, parameters: Mapping[str, float]) -> Array:
    """Return the rotation (3, 3) sensor→vehicle."""
    get = parameters.get
    number = int(get(f"{prefix}ROT", -1))
    if number == _CUSTOM_ROTATION:
        return euler(*(get(f"{prefix}{angle}", 0.0) for angle in ("ROLL", "PITCH", "YAW")))
    if number >= 0:
        return mounting(number)
    fine = euler(*(get(f"SENS_BOARD_{axis}_OFF", 0.0) for axis in "XYZ"))
    return fine @ mounting(int(get("SENS_BOARD_ROT", 0)))


# Roll, pitch, yaw in degrees by number; applied in the order yaw, pitch, roll about the moving axes.
_EULER = (
    (0, 0, 0), (0, 0, 45), (0, 0, 90), (0, 0, 135), (0, 0, 180), (0, 0, 225), (0, 0, 270), (0, 0, 315),
    (180, 0, 0), (180, 0, 45), (180, 0, 90), (180, 0, 135), (0, 180, 0), (180, 0, 225), (180, 0, 270), (180, 0, 315),
    (90, 0, 0), (90, 0, 45), (90, 0, 90), (90, 0, 135), (270, 0, 0), (270, 0, 45), (270, 0, 90), (270, 0, 135),
    (0, 90, 0), (0, 270, 0), (0, 180, 90), (0, 180, 270), (90, 90, 0), (180, 90, 0), (270, 90, 0), (90, 180, 0),
    (270, 180, 0), (90, 270, 0), (180, 270, 0), (270, 270, 0), (90, 180, 90), (90, 0, 270), (90, 68.8, 293.3),
    (0, 315, 0), (90, 315, 0),
)  # fmt: skip
LARGEST_MOUNTING = len(_EULER) - 1  # number of the last orientation that is known; ArduPilot has the same


def euler(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of three angles in degrees."""
    matrix: NDArray[np.float64] = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
    return matrix


def mounting(number: int) -> NDArray[np.float64]:
    """Return the rotation (3, 3) sensor→board of a numbered orientation.

    Raises:
        MagycError: the number is unknown.
    """
    if not 0 <= number <= LARGEST_MOUNTING:
        raise MagycError(f"sensor orientation: must be 0 to {LARGEST_MOUNTING}, got {number}")
    return euler(*_EULER[number])
