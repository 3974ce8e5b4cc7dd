"""What an export writes, whatever its target, and its parts in the forms that targets take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError

Array = NDArray[np.float64]

GAUSS = 1e4  # per tesla
EXTERNAL_ONLY = (
    "LIMIT: a compass inside the autopilot is turned with its board only: there this rotation is not applied, and the "
    "heading stays off by it; `magyc-gtsam apply` takes it out."
)


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
        warming_gyro: (3,) rad/s/°C that warming above `gyro_reference` (°C) adds to the angular rate; or None.
    """

    matrix: Array
    offset: Array
    gyro_bias: Array | None = None
    rotation: Array | None = None
    motor: Array | None = None
    thermal: Array | None = None
    reference: float = 0.0
    motors: Array | None = None
    warming_gyro: Array | None = None
    gyro_reference: float = 0.0


def symmetric(matrix: Array, target: str) -> tuple[Array, list[str]]:
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
        f"rotation of {degrees(rotation):.2f} deg is left out."
    )
    return right.T @ np.diag(stretch) @ right, [note]


def degrees(rotation: Array) -> float:
    from scipy.spatial.transform import Rotation

    return float(np.degrees(Rotation.from_matrix(rotation).magnitude()))


def angles(rotation: Array) -> list[float]:
    """Roll, pitch, yaw in degrees, as both autopilots take them."""
    from scipy.spatial.transform import Rotation

    yaw, pitch, roll = Rotation.from_matrix(rotation).as_euler("ZYX", degrees=True).tolist()
    return [roll, pitch, yaw]


def axes(name: str, values: Array) -> dict[str, float]:
    return {name.format(axis): float(value) for axis, value in zip("XYZ", values, strict=True)}


def number(value: float) -> str:
    return f"{value:.8f}"  # the targets hold single precision
