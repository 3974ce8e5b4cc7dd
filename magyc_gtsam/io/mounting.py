"""The numbered sensor orientations of PX4 and ArduPilot (MAV_SENSOR_ORIENTATION of MAVLink)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors.errors import MagycError

# Roll, pitch, yaw in degrees by number; applied in the order yaw, pitch, roll about the moving axes.
_EULER = (
    *((0, 0, yaw) for yaw in range(0, 360, 45)),
    *(
        (180, 0, 0),
        (180, 0, 45),
        (180, 0, 90),
        (180, 0, 135),
        (0, 180, 0),
        (180, 0, 225),
        (180, 0, 270),
        (180, 0, 315),
    ),
    *(
        (90, 0, 0),
        (90, 0, 45),
        (90, 0, 90),
        (90, 0, 135),
        (270, 0, 0),
        (270, 0, 45),
        (270, 0, 90),
        (270, 0, 135),
    ),
    *(
        (0, 90, 0),
        (0, 270, 0),
        (0, 180, 90),
        (0, 180, 270),
        (90, 90, 0),
        (180, 90, 0),
        (270, 90, 0),
        (90, 180, 0),
    ),
    *(
        (270, 180, 0),
        (90, 270, 0),
        (180, 270, 0),
        (270, 270, 0),
        (90, 180, 90),
        (90, 0, 270),
        (90, 68.8, 293.3),
    ),
    *((0, 315, 0), (90, 315, 0)),
)


def euler(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of three angles in degrees."""
    matrix: NDArray[np.float64] = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
    return matrix


def mounting(number: int) -> NDArray[np.float64]:
    """Return the rotation (3, 3) sensor→board of a numbered orientation.

    Raises:
        MagycError: the number is unknown.
    """
    if not 0 <= number < len(_EULER):
        raise MagycError(f"sensor orientation: must be 0 to {len(_EULER) - 1}, got {number}")
    return euler(*_EULER[number])
