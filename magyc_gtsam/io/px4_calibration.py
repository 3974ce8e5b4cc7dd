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

    def at(self, name: str, stamp: Stamps, default: float) -> Array:
        """Return the values (n,) of a parameter at stamps (n,) in µs."""
        value = np.full(len(stamp), float(self.initial.get(name, default)))
        for when, changed, new in self.changes:
            if changed == name:
                value[stamp >= when] = new
        return value

    def vector(self, pattern: str, stamp: Stamps, default: float) -> Array:
        """Return the values (n, 3) of three parameters, named by `pattern` with X, Y, Z in place of {}."""
        return np.column_stack([self.at(pattern.format(axis), stamp, default) for axis in "XYZ"])


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
    index, notes = _index(kind, parameters, device, corrected)
    place = _place(kind, parameters, device, index)
    prefix = f"CAL_{kind}{index}_"
    rotation = _rotation(prefix, parameters)
    value = logged @ rotation if rotated else logged  # rows: x @ R is Rᵀx
    if corrected and index is not None:
        compensation = parameters.vector(f"{prefix}{{}}COMP", stamp, 0.0)
        if kind == "MAG" and parameters.initial.get("CAL_MAG_COMP_TYP", 0) and compensation.any():
            raise MagycError(
                f"{prefix}XCOMP.. corrected the magnetometer by the motors' power, which cannot be undone; "
                "read the uncorrected message if the log has it (magnetic_field='sensor_mag')"
            )
        offset = parameters.vector(f"{prefix}{{}}OFF", stamp, 0.0)
        scale = _scale(prefix, parameters, stamp)
        value = np.linalg.solve(scale, value[:, :, None])[:, :, 0] + offset
        unit = "gauss" if kind == "MAG" else "rad/s"
        text = ", ".join(f"{x:.5g}" for x in offset[0])
        extra = "" if np.allclose(scale, np.eye(3)) else f" and scale {np.array2string(scale[0], precision=4)}"
        notes.append(f"{prefix}* was applied in flight and is undone: offset ({text}) {unit}{extra}")
        if (offset != offset[0]).any() or (scale != scale[0]).any():
            notes.append(f"{prefix}* changed within the log; each sample was corrected by the values at its time")
    place = replace(place, axes=tuple(map(tuple, rotation.tolist())))
    if not np.allclose(rotation, np.eye(3)):
        if rotated and index is None and not place.problem:
            why = f"the log does not say whether the sensor ({device}) turns with the board (SENS_BOARD_ROT)"
            place = replace(place, problem=f"{why}; calibrate it in PX4 once, and log again")
        angle = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
        notes.append(f"{kind}: values are in the vehicle's frame, {angle:.2f}° from the sensor's")
    return value @ rotation.T, notes, place


def _place(kind: str, parameters: Parameters, device: int | None, index: int | None) -> Place:
    """Return the place of a sensor's parameters; a sensor without any is given the first that are free."""
    if index is not None:
        return Place(index)
    if device is None:
        return Place(problem=f"the log does not say which CAL_{kind}n_* are those of the sensor")
    free = [n for n in _INSTANCES if not parameters.initial.get(f"CAL_{kind}{n}_ID", 0)]
    if not free:
        return Place(problem=f"no CAL_{kind}n_ID is the sensor's ({device}), and all are in use by others")
    return Place(free[0], device)


def _index(kind: str, parameters: Parameters, device: int | None, corrected: bool) -> tuple[int | None, list[str]]:
    """Return the number n of the CAL_MAGn or CAL_GYROn parameters of the sensor, None if it has none, and notes."""
    identifiers = {n: int(parameters.initial.get(f"CAL_{kind}{n}_ID", 0)) for n in _INSTANCES}
    known = [n for n, identifier in identifiers.items() if identifier != 0]
    if device is not None:
        matching = [n for n in known if identifiers[n] == device]
        if not matching and corrected:
            return None, [f"no CAL_{kind}n_ID is the sensor's ({device}): no calibration had been applied"]
        return (matching[0] if matching else None), []
    if len(known) == 1:
        return known[0], []
    prime = int(parameters.initial.get(f"CAL_{kind}_PRIME", 0))
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


def _scale(prefix: str, parameters: Parameters, stamp: Stamps) -> Array:
    """Return the scale matrix (n, 3, 3) in force at each stamp."""
    diagonal = parameters.vector(f"{prefix}{{}}SCALE", stamp, 1.0)
    off = parameters.vector(f"{prefix}{{}}ODIAG", stamp, 0.0)
    scale = np.empty((len(stamp), 3, 3))
    for k in range(3):
        scale[:, k, k] = diagonal[:, k]
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        scale[:, i, j] = scale[:, j, i] = off[:, k]
    if (np.abs(np.linalg.det(scale)) < 1e-6).any():
        raise MagycError(
            f"{prefix}*SCALE, {prefix}*ODIAG: the matrix is singular, so the calibration cannot be undone"
        )
    return scale


def _rotation(prefix: str, parameters: Parameters) -> Array:
    """Return the rotation (3, 3) sensor→vehicle."""
    get = parameters.initial.get
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
