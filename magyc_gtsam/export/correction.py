"""The correction that an export writes, independent of the target, and its conversion to common forms."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.export.power import Power
from magyc_gtsam.factors.errors import MagycError

Array = NDArray[np.float64]

GAUSS = 1e4  # per tesla
EXTERNAL_ONLY = (
    "LIMIT: a compass inside the autopilot is turned only with its board: this rotation is not applied to it and "
    "remains as a heading error; `magyc-gtsam apply` corrects it."
)


@dataclass(frozen=True, eq=False)
class Correction:
    """The correction field = rotation matrix (raw − offset − motor · current − thermal · (temperature − reference)).

    Attributes:
        matrix: (3, 3).
        offset: (3,) T.
        gyro_bias: (3,) rad/s, or None.
        gyro_axes: (3, 3) from the gyroscope's own axes to the magnetometer's.
        rotation: (3, 3), or None.
        mounting: (3, 3), by which ArduPilot turned the sensor's readings into the axes of the matrix.
        motor: (3,) T at 1 A or full throttle, or None.
        power: what the current or throttle of `motor` is.
        thermal: (3,) T/°C, or None.
        reference: °C.
        motors: (4, 3) T/V, subtracted in proportion to the output of each motor and the battery's voltage; or None.
        warming_gyro: (3,) rad/s/°C, change of the angular rate with the temperature above `gyro_reference`; or None.
        gyro_reference: °C.
    """

    matrix: Array
    offset: Array
    gyro_bias: Array | None = None
    gyro_axes: Array = field(default_factory=lambda: np.eye(3))
    rotation: Array | None = None
    mounting: Array = field(default_factory=lambda: np.eye(3))
    motor: Array | None = None
    power: Power = field(default_factory=Power)
    thermal: Array | None = None
    reference: float = 0.0
    motors: Array | None = None
    warming_gyro: Array | None = None
    gyro_reference: float = 0.0


def symmetric(matrix: Array, target: str) -> tuple[Array, list[str]]:
    """Return the symmetric matrix (3, 3) that gives the same field strengths, and a note if it omits a rotation.

    Raises:
        MagycError: the matrix contains a reflection.
    """
    if np.allclose(matrix, matrix.T, rtol=0, atol=1e-9 * np.abs(matrix).max()):
        return (matrix + matrix.T) / 2, []
    left, stretch, right = np.linalg.svd(matrix)
    rotation = left @ right
    if np.linalg.det(rotation) < 0:
        raise MagycError(
            f"the calibration mirrors an axis, which the symmetric matrix of {target} cannot represent; "
            "check the signs and the order of the axes"
        )
    note = (
        f"LIMIT: {target} takes only symmetric matrices: the field strength is the same, but a fixed "
        f"rotation of {degrees(rotation):.2f} deg is left out."
    )
    return right.T @ np.diag(stretch) @ right, [note]


def degrees(rotation: Array) -> float:
    """Return the angle of a rotation (3, 3) in degrees."""
    from scipy.spatial.transform import Rotation

    return float(np.degrees(Rotation.from_matrix(rotation).magnitude()))


def angles(rotation: Array) -> list[float]:
    """Return roll, pitch and yaw of a rotation (3, 3) in degrees, in the convention of both autopilots."""
    from scipy.spatial.transform import Rotation

    yaw, pitch, roll = Rotation.from_matrix(rotation).as_euler("ZYX", degrees=True).tolist()
    return [roll, pitch, yaw]


def axes(name: str, values: Array) -> dict[str, float]:
    """Return {parameter: value} of three values, with X, Y, Z in place of the braces in `name`."""
    return {name.format(axis): float(value) for axis, value in zip("XYZ", values, strict=True)}


def number(value: float) -> str:
    """Return a number in the precision of the targets, which is single."""
    return f"{value:.8f}"
