"""Calibrations in the words of PX4, ArduPilot, VectorNav and ROS, ready to paste.

All four correct with a matrix and an offset, as we do (`soft_iron⁻¹ (m − hard_iron)`), but differ in
units, in the sign of the offset and in the matrices they can hold. Nothing is rescaled: the field
strength that `soft_iron` implies is kept. A rotation to the gyroscope's axes goes into the mounting, the
motors' current and the temperature into the target's own terms where it has them:

    PX4        R S (raw + power · COMP − TC(temperature) − OFF), R from ROT, ROLL, PITCH, YAW, power in kA
    ArduPilot  M (R raw + OFS) + current · MOT, R from COMPASS_ORIENT and CUST_ROT1, current in A,
               or + Σ output · PMOT over four motors
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magyc_gtsam.compass_number import numbered
from magyc_gtsam.factors.errors import MagycError

Array = NDArray[np.float64]

_GAUSS = 1e4  # per tesla
_MILLIGAUSS = 1e7
_PX4_SCALE = (0.1, 3.0)  # range of CAL_MAG0_*SCALE
_ARDUPILOT_OFFSET = 1800.0  # milligauss, default of COMPASS_OFFS_MAX
_ARDUPILOT_DIAGONAL = (0.2, 5.0)  # what ArduPilot's own calibration accepts
_ARDUPILOT_OFF_DIAGONAL = 1.0
MOTORS = 4  # that ArduPilot compensates for, each by itself


def export(
    target: str,
    soft_iron: ArrayLike,
    hard_iron: ArrayLike,
    gyro_bias: ArrayLike | None = None,
    terms: Sequence[str] = (),
    *,
    rotation: ArrayLike | None = None,
    motor: ArrayLike | None = None,
    motors: ArrayLike | None = None,
    thermal: ArrayLike | None = None,
    reference: float = 0.0,
    compass: int = 1,
) -> str:
    """Text to paste into `target`.

    Args:
        target: "px4", "ardupilot", "vectornav" or "ros".
        soft_iron: (3, 3).
        hard_iron: (3,) T, at no current and at the `reference` temperature.
        gyro_bias: (3,) rad/s, in the gyroscope's own axes; None leaves the gyroscope out.
        terms: effects of the calibration beyond these; no target holds them, and the text says so.
        rotation: (3, 3) that brings the calibrated field to the gyroscope's axes; it goes into the mounting.
        motor: (3,) T/A that the motors' current adds to the reading.
        motors: (4, 3) T that motors 1 to 4 add at full output, each by itself; ArduPilot's only.
        thermal: (3,) T/°C that warming above `reference` (°C) adds to it.
        compass: which of the vehicle's, from 1; the targets that have several number their parameters by it.

    Raises:
        MagycError: unknown target, or a calibration that the target cannot hold.
    """
    if target not in TARGETS:
        raise MagycError(f"no export called {target!r}; there are {', '.join(TARGETS)}")
    matrix = np.linalg.inv(np.asarray(soft_iron, dtype=np.float64))
    offset = np.asarray(hard_iron, dtype=np.float64)
    correction = Correction(
        matrix,
        offset,
        None if gyro_bias is None else np.asarray(gyro_bias, dtype=np.float64),
        _beyond_rounding(rotation),
        None if motor is None else np.asarray(motor, dtype=np.float64),
        None if thermal is None else np.asarray(thermal, dtype=np.float64),
        reference,
        None if motors is None else np.asarray(motors, dtype=np.float64),
    )
    lines = numbered(TARGETS[target](correction), target, compass)
    missing = [*terms]
    missing += ["motor-current"] if motor is not None and target not in _WITH_MOTOR else []
    missing += ["temperature-hard-iron"] if thermal is not None and target not in _WITH_TEMPERATURE else []
    limit = (
        [f"# LIMIT: not in here: {', '.join(missing)}. Only `magyc-gtsam apply` takes it out."] if missing else []
    )
    return "\n".join([*limit, *lines]) + "\n"


@dataclass(frozen=True, eq=False)
class Correction:
    """What is written: field = rotation matrix (raw − offset − motor · current − thermal · (temperature − reference)).

    Args:
        matrix, offset: (3, 3), (3,) T.
        gyro_bias: (3,) rad/s, or None.
        rotation: (3, 3), or None.
        motor, thermal: (3,) T/A, (3,) T/°C, or None.
        reference: °C.
        motors: (4, 3) T, subtracted in proportion to each motor's output; or None.
    """

    matrix: Array
    offset: Array
    gyro_bias: Array | None = None
    rotation: Array | None = None
    motor: Array | None = None
    thermal: Array | None = None
    reference: float = 0.0
    motors: Array | None = None


def motors_of(value: Array, setting: Mapping[str, float]) -> tuple[Array, Array]:
    """Of a term of several circuits: (4, 3) T of motors 1 to 4 at full output, and (3,) T of all at their references.

    Raises:
        MagycError: there are more than four.
    """
    references = {int(name.rpartition("_")[2]): each for name, each in setting.items()}
    rows = sorted(references) or list(range(len(value) // 3))
    if rows[-1] >= MOTORS:
        raise MagycError(
            f"per motor: channel {rows[-1] + 1} of a current, and ArduPilot compensates for {MOTORS} motors"
        )
    motors = np.zeros((MOTORS, 3))
    motors[rows] = value.reshape(-1, 3)
    return motors, np.array([references.get(row, 0.0) for row in range(MOTORS)]) @ motors


def do_not_use(reason: str, text: str) -> str:
    """The values as comments, under DO NOT USE and the reason: no target reads any of them."""
    lines = [f"DO NOT USE: {' '.join(reason.split())}", *text.splitlines()]
    return "".join(f"# {line}\n" for line in lines)


def _px4(c: Correction) -> list[str]:
    scale, notes = _symmetric(c.matrix, "PX4")
    rotation = c.rotation
    values = _axes("CAL_MAG0_{}OFF", c.offset * _GAUSS)
    values |= _axes("CAL_MAG0_{}SCALE", np.diag(scale))
    values |= _axes("CAL_MAG0_{}ODIAG", scale[(0, 0, 1), (1, 2, 2)])
    whole: dict[str, int] = {}
    low, high = _PX4_SCALE
    if not ((np.diag(scale) >= low) & (np.diag(scale) <= high)).all():
        notes.append(f"LIMIT: a CAL_MAG0_*SCALE is outside {low:g} to {high:g}, the range PX4 accepts.")
    if rotation is not None:
        whole["CAL_MAG0_ROT"] = 100
        values |= dict(zip(("CAL_MAG0_ROLL", "CAL_MAG0_PITCH", "CAL_MAG0_YAW"), _angles(rotation), strict=True))
        notes.append(f"CAL_MAG0_ROT 100, with ROLL, PITCH, YAW in degrees, turns by {_degrees(rotation):.2f} deg.")
        notes.append("It is for an external compass that had CAL_MAG0_ROT 0 as the log was recorded.")
        notes.append(_INTERNAL)
    if c.motor is not None:
        whole["CAL_MAG_COMP_TYP"] = 2
        values |= _axes("CAL_MAG0_{}COMP", -c.motor * _GAUSS * 1e3)
        notes.append("CAL_MAG0_*COMP: gauss per kA of battery 1's current, ADDED to the raw field, while armed.")
        notes.append("Where the channel was a throttle of 0 to 1: CAL_MAG_COMP_TYP 1, and COMP divided by 1000.")
    if c.thermal is not None:
        whole["TC_M_ENABLE"] = 1
        values |= {f"TC_M0_X1_{k}": float(value) for k, value in enumerate(c.thermal * _GAUSS)}
        values |= {"TC_M0_TREF": c.reference} | {f"TC_M0_X{n}_{k}": 0.0 for n in (0, 2, 3) for k in range(3)}
        notes.append("TC_M0_*: gauss per degree of the magnetometer's own thermometer, subtracted; set TC_M0_ID")
        notes.append("to CAL_MAG0_ID, and TC_M0_TMIN, TC_M0_TMAX to the range that the log covers.")
    if c.gyro_bias is not None:
        values |= _axes("CAL_GYRO0_{}OFF", c.gyro_bias)
    return [
        "# PX4 parameters (QGroundControl: Vehicle Setup > Parameters > Tools > Load from file).",
        "# Offsets in gauss, SUBTRACTED: field = scale * (raw - offset), in the sensor's own axes, before",
        "# CAL_MAG0_ROT. XODIAG, YODIAG, ZODIAG are the elements xy, xz, yz of the scale matrix.",
        "# Gyroscope offsets in rad/s, subtracted. Another sensor than the first: replace MAG0, GYRO0.",
        *(f"# {note}" for note in notes),
        "# Vehicle-Id Component-Id Name Value Type",
        *(f"1\t1\t{name}\t{value}\t6" for name, value in whole.items()),
        *(f"1\t1\t{name}\t{_number(value)}\t9" for name, value in values.items()),
    ]


def _ardupilot(c: Correction) -> list[str]:
    scale, notes = _symmetric(c.matrix, "ArduPilot")
    plain, rotation = scale, c.rotation
    added = -c.offset * _MILLIGAUSS
    values: dict[str, float] = {}
    if rotation is not None:
        # R P (raw + o) = (R P Rᵀ) (R raw + R o): the compass is turned first, and its matrix stays symmetric.
        scale, added = rotation @ scale @ rotation.T, rotation @ added
        angles = dict(zip(("ROLL", "PITCH", "YAW"), _angles(rotation), strict=True))
        values |= {"COMPASS_ORIENT": 101, "CUST_ROT_ENABLE": 1}
        values |= {f"CUST_ROT1_{name}": angle for name, angle in angles.items()}
        notes.append(
            f"COMPASS_ORIENT 101 turns by CUST_ROT1_*, degrees, {_degrees(rotation):.2f} deg in all. It is"
        )
        notes.append("for an external compass that had COMPASS_ORIENT 0 as the log was recorded.")
        notes.append(_INTERNAL)
    diagonal, off_diagonal = np.diag(scale), scale[(0, 0, 1), (1, 2, 2)]
    values |= _axes("COMPASS_OFS_{}", added) | _axes("COMPASS_DIA_{}", diagonal)
    values |= _axes("COMPASS_ODI_{}", off_diagonal) | {"COMPASS_SCALE": 1.0}
    length = float(np.linalg.norm(added))
    if length > _ARDUPILOT_OFFSET:
        notes.append(
            f"LIMIT: offset of {length:.0f} milligauss, beyond {_ARDUPILOT_OFFSET:g}: "
            "the vehicle will not arm. Move the compass away from iron, or raise COMPASS_OFFS_MAX."
        )
    low, high = _ARDUPILOT_DIAGONAL
    if not ((diagonal > low) & (diagonal < high)).all():
        notes.append(f"LIMIT: a COMPASS_DIA is outside {low:g} to {high:g}, the range of ArduPilot's own fit.")
    if (np.abs(off_diagonal) >= _ARDUPILOT_OFF_DIAGONAL).any():
        notes.append("LIMIT: a COMPASS_ODI is beyond 1, the limit of ArduPilot's own fit.")
    if c.motor is not None:
        turn = np.eye(3) if rotation is None else rotation
        values |= {"COMPASS_MOTCT": 2} | _axes("COMPASS_MOT_{}", -turn @ plain @ c.motor * _MILLIGAUSS)
        notes.append("COMPASS_MOT: milligauss per ampere of battery 1's current, ADDED after the matrix.")
        notes.append("Where the channel was a throttle of 0 to 1: COMPASS_MOTCT 1, with the same COMPASS_MOT.")
    if c.motors is not None:
        turn = np.eye(3) if rotation is None else rotation
        values |= {"COMPASS_PMOT_EN": 1, "COMPASS_PMOT_EXP": 1.0}
        for k, each in enumerate(c.motors, start=1):
            values |= _axes(f"COMPASS_PMOT{k}_{{}}", -turn @ plain @ each * _MILLIGAUSS)
        notes.append(
            "COMPASS_PMOT: milligauss at full output of motors 1 to 4, ADDED after the matrix, for the first"
        )
        notes.append(
            "compass. It is for channels that were the motors' outputs, 0 to 1, by the order of their names."
        )
    if c.gyro_bias is not None:
        values |= _axes("INS_GYROFFS_{}", c.gyro_bias)
        notes.append("INS_GYROFFS is measured anew at every start unless INS_GYR_CAL is 0.")
    return [
        "# ArduPilot parameters (Mission Planner: Full Parameter List > Load from file).",
        "# Offsets in milligauss, ADDED: field = matrix * COMPASS_SCALE * (raw + offset), in the vehicle's",
        "# axes, after COMPASS_ORIENT. ODI_X, ODI_Y, ODI_Z are the elements xy, xz, yz of the matrix.",
        "# COMPASS_SCALE 1 says that the field strength is absolute; where it was not given to the",
        "# calibration, set 0: the correction stays the same. Gyroscope offsets in rad/s, subtracted.",
        *(f"# {note}" for note in notes),
        *(f"{name},{value if isinstance(value, int) else _number(value)}" for name, value in values.items()),
    ]


def _vectornav(c: Correction) -> list[str]:
    matrix = c.matrix if c.rotation is None else c.rotation @ c.matrix
    offset, gyro_bias = c.offset, c.gyro_bias
    lines = [
        "# VectorNav registers: send the lines that begin with a dollar sign; command WNV keeps them.",
        "# For data recorded while these registers held their defaults; otherwise the two would add up.",
        "# Register 23, magnetometer: field = C * (M - B), C row by row, B in gauss.",
        _register(23, matrix, offset * _GAUSS),
    ]
    if gyro_bias is not None:
        lines += [
            "# Register 84, gyroscope: rate = C * (G - B), C row by row, B in rad/s.",
            _register(84, np.eye(3), gyro_bias),
        ]
    return lines


def _ros(c: Correction) -> list[str]:
    matrix = c.matrix if c.rotation is None else c.rotation @ c.matrix
    offset, gyro_bias = c.offset, c.gyro_bias
    lines = [
        "# ROS 2 parameters, SI units: magnetic field in tesla, angular rate in rad/s.",
        "# Magnetometer: calibrated = matrix @ (m - bias), the matrix row by row. These are the names",
        "# that magnetometer_pipeline's bias remover reads.",
        "/**:",
        "  ros__parameters:",
        *(f"    initial_mag_bias_{axis}: {_yaml([value])}" for axis, value in zip("xyz", offset, strict=True)),
        f"    initial_mag_scaling_matrix: [{_yaml(matrix.ravel())}]",
    ]
    if gyro_bias is not None:
        lines += ["    # Gyroscope: calibrated = w - bias.", f"    gyroscope_bias: [{_yaml(gyro_bias)}]"]
    return lines


TARGETS: dict[str, Callable[[Correction], list[str]]] = {
    "px4": _px4,
    "ardupilot": _ardupilot,
    "vectornav": _vectornav,
    "ros": _ros,
}


_WITH_MOTOR = ("px4", "ardupilot")
_WITH_TEMPERATURE = ("px4",)
_INTERNAL = (
    "LIMIT: a compass inside the autopilot is turned with its board only: there this rotation is not applied, and the "
    "heading stays off by it; `magyc-gtsam apply` takes it out."
)
_TURNED = 1e-6  # rad, below which a rotation is rounding


def _symmetric(matrix: Array, target: str) -> tuple[Array, list[str]]:
    """The symmetric matrix that gives the same field strengths, and a note where that left a rotation out."""
    if np.allclose(matrix, matrix.T, rtol=0, atol=1e-9 * np.abs(matrix).max()):
        return (matrix + matrix.T) / 2, []
    left, stretch, right = np.linalg.svd(matrix)
    rotation = left @ right
    if np.linalg.det(rotation) < 0:
        raise MagycError(f"this calibration mirrors an axis, which {target}'s symmetric matrix cannot hold")
    # The form of a matrix that the field strength alone determined; nothing measured this rotation.
    note = (
        f"LIMIT: {target} holds symmetric matrices only: the field strength is the same, but a fixed "
        f"rotation of {_degrees(rotation):.2f} deg is left out."
    )
    return right.T @ np.diag(stretch) @ right, [note]


def _beyond_rounding(rotation: ArrayLike | None) -> Array | None:
    if rotation is None:
        return None
    matrix = np.asarray(rotation, dtype=np.float64)
    return matrix if np.radians(_degrees(matrix)) > _TURNED else None


def _degrees(rotation: Array) -> float:
    from scipy.spatial.transform import Rotation

    return float(np.degrees(Rotation.from_matrix(rotation).magnitude()))


def _angles(rotation: Array) -> list[float]:
    """Roll, pitch, yaw in degrees, as both autopilots take them."""
    from scipy.spatial.transform import Rotation

    yaw, pitch, roll = Rotation.from_matrix(rotation).as_euler("ZYX", degrees=True).tolist()
    return [roll, pitch, yaw]


def _axes(name: str, values: Array) -> dict[str, float]:
    return {name.format(axis): float(value) for axis, value in zip("XYZ", values, strict=True)}


def _number(value: float) -> str:
    return f"{value:.8f}"  # the targets hold single precision


def _yaml(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.12e}" for value in values)  # YAML 1.1 reads 2e-06, without a point, as text


def _register(number: int, matrix: Array, offset: Array) -> str:
    values: Iterable[float] = (*matrix.ravel(), *offset)
    body = f"VNWRG,{number}," + ",".join(_number(value) for value in values)
    return f"${body}*{_checksum(body):02X}"


def _checksum(body: str) -> int:
    result = 0
    for byte in body.encode("ascii"):
        result ^= byte
    return result
