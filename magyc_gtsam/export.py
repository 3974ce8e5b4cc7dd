"""Calibrations in the words of PX4, ArduPilot, VectorNav and ROS, ready to paste.

All four correct with a matrix and an offset, as we do (`soft_iron⁻¹ (m − hard_iron)`), but differ in
units, in the sign of the offset and in the matrices they can hold. Nothing is rescaled: the field
strength that `soft_iron` implies is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magyc_gtsam.factors.errors import MagycError

Array = NDArray[np.float64]

_GAUSS = 1e4  # per tesla
_MILLIGAUSS = 1e7
_PX4_SCALE = (0.1, 3.0)  # range of CAL_MAG0_*SCALE
_ARDUPILOT_OFFSET = 1800.0  # milligauss, default of COMPASS_OFFS_MAX
_ARDUPILOT_DIAGONAL = (0.2, 5.0)  # what ArduPilot's own calibration accepts
_ARDUPILOT_OFF_DIAGONAL = 1.0


def export(
    target: str,
    soft_iron: ArrayLike,
    hard_iron: ArrayLike,
    gyro_bias: ArrayLike | None = None,
    terms: Sequence[str] = (),
) -> str:
    """Text to paste into `target`.

    Args:
        target: "px4", "ardupilot", "vectornav" or "ros".
        soft_iron: (3, 3).
        hard_iron: (3,) T.
        gyro_bias: (3,) rad/s, in the gyroscope's own axes; None leaves the gyroscope out.
        terms: effects of the calibration beyond these; no target holds them, and the text says so.

    Raises:
        MagycError: unknown target, or a calibration that the target cannot hold.
    """
    if target not in TARGETS:
        raise MagycError(f"no export called {target!r}; there are {', '.join(TARGETS)}")
    matrix = np.linalg.inv(np.asarray(soft_iron, dtype=np.float64))
    offset = np.asarray(hard_iron, dtype=np.float64)
    bias = None if gyro_bias is None else np.asarray(gyro_bias, dtype=np.float64)
    limit = [f"# LIMIT: not in here: {', '.join(terms)}. Only `magyc-gtsam apply` takes it out."] if terms else []
    return "\n".join([*limit, *TARGETS[target](matrix, offset, bias)]) + "\n"


def _px4(matrix: Array, offset: Array, gyro_bias: Array | None) -> list[str]:
    scale, notes = _symmetric(matrix, "PX4")
    values = _axes("CAL_MAG0_{}OFF", offset * _GAUSS)
    values |= _axes("CAL_MAG0_{}SCALE", np.diag(scale))
    values |= _axes("CAL_MAG0_{}ODIAG", scale[(0, 0, 1), (1, 2, 2)])
    low, high = _PX4_SCALE
    if not ((np.diag(scale) >= low) & (np.diag(scale) <= high)).all():
        notes.append(f"LIMIT: a CAL_MAG0_*SCALE is outside {low:g} to {high:g}, the range PX4 accepts.")
    if gyro_bias is not None:
        values |= _axes("CAL_GYRO0_{}OFF", gyro_bias)
    return [
        "# PX4 parameters (QGroundControl: Vehicle Setup > Parameters > Tools > Load from file).",
        "# Offsets in gauss, SUBTRACTED: field = scale * (raw - offset), in the sensor's own axes, before",
        "# CAL_MAG0_ROT. XODIAG, YODIAG, ZODIAG are the elements xy, xz, yz of the scale matrix.",
        "# Gyroscope offsets in rad/s, subtracted. Another sensor than the first: replace MAG0, GYRO0.",
        *(f"# {note}" for note in notes),
        "# Vehicle-Id Component-Id Name Value Type",
        *(f"1\t1\t{name}\t{_number(value)}\t9" for name, value in values.items()),
    ]


def _ardupilot(matrix: Array, offset: Array, gyro_bias: Array | None) -> list[str]:
    scale, notes = _symmetric(matrix, "ArduPilot")
    added = -offset * _MILLIGAUSS
    diagonal, off_diagonal = np.diag(scale), scale[(0, 0, 1), (1, 2, 2)]
    values = _axes("COMPASS_OFS_{}", added) | _axes("COMPASS_DIA_{}", diagonal)
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
    if gyro_bias is not None:
        values |= _axes("INS_GYROFFS_{}", gyro_bias)
        notes.append("INS_GYROFFS is measured anew at every start unless INS_GYR_CAL is 0.")
    return [
        "# ArduPilot parameters (Mission Planner: Full Parameter List > Load from file).",
        "# Offsets in milligauss, ADDED: field = matrix * COMPASS_SCALE * (raw + offset), in the vehicle's",
        "# axes, after COMPASS_ORIENT. ODI_X, ODI_Y, ODI_Z are the elements xy, xz, yz of the matrix.",
        "# COMPASS_SCALE 1 says that the field strength is absolute; where it was not given to the",
        "# calibration, set 0: the correction stays the same. Gyroscope offsets in rad/s, subtracted.",
        *(f"# {note}" for note in notes),
        *(f"{name},{_number(value)}" for name, value in values.items()),
    ]


def _vectornav(matrix: Array, offset: Array, gyro_bias: Array | None) -> list[str]:
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


def _ros(matrix: Array, offset: Array, gyro_bias: Array | None) -> list[str]:
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


TARGETS: dict[str, Callable[[Array, Array, Array | None], list[str]]] = {
    "px4": _px4,
    "ardupilot": _ardupilot,
    "vectornav": _vectornav,
    "ros": _ros,
}


def _symmetric(matrix: Array, target: str) -> tuple[Array, list[str]]:
    """The symmetric matrix that gives the same field strengths, and a note where that left a rotation out."""
    if np.allclose(matrix, matrix.T, rtol=0, atol=1e-9 * np.abs(matrix).max()):
        return (matrix + matrix.T) / 2, []
    left, stretch, right = np.linalg.svd(matrix)
    rotation = left @ right
    if np.linalg.det(rotation) < 0:
        raise MagycError(f"this calibration mirrors an axis, which {target}'s symmetric matrix cannot hold")
    angle = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    note = (
        f"LIMIT: {target} holds symmetric matrices only: the field strength is the same, but a fixed "
        f"rotation of {angle:.2f} deg is left out."
    )
    return right.T @ np.diag(stretch) @ right, [note]


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
