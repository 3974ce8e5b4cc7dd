"""Which parameters of ArduPilot are those of a compass, and how it turns compasses and board into the vehicle's axes.

AP_Compass_Backend::rotate_field turns an external compass by COMPASS_ORIENT, and one inside the autopilot by
AHRS_ORIENTATION, as the inertial sensors. Orientations 101 and 102 are the angles of CUST_ROT1 and CUST_ROT2.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.px4_calibration import LARGEST_MOUNTING, euler, mounting

Parameters = Mapping[str, float]

BOARD = "AHRS_ORIENTATION"
_CUSTOM = {101: 1, 102: 2}  # numbers of the custom rotations
_COMPASSES = 3


def suffix_of(slot: int) -> str:
    """Return the suffix of the parameters of a driver: "" for the first, "2", "3"."""
    return str(slot + 1) if slot else ""


def slot_of(parameters: Parameters, instance: int) -> int:
    """Return the number, from 0, of a compass's parameters; the log counts by priority, the parameters by driver.

    Raises:
        MagycError: the compass of that priority has none of the parameters.
    """
    name = f"COMPASS_PRIO{instance + 1}_ID"
    device = parameters.get(name, 0)
    drivers = [int(parameters.get(f"COMPASS_DEV_ID{suffix_of(slot)}", 0)) for slot in range(_COMPASSES)]
    if not device or not any(drivers):
        return instance
    if device not in drivers:
        raise MagycError(
            f"MAG[{instance}]: {name} {device:.0f} is no COMPASS_DEV_ID of the log, so that its parameters, and the "
            "correction to undo, are not known; set the compass priorities, and log again"
        )
    return drivers.index(int(device))


def external_of(parameters: Parameters, slot: int) -> bool | None:
    """Return whether a compass is outside the autopilot; None if the log does not tell."""
    name = f"COMPASS_EXTERN{suffix_of(slot)}" if slot else "COMPASS_EXTERNAL"
    return None if name not in parameters else parameters[name] != 0


def number_of(parameters: Parameters, slot: int | None) -> tuple[str, int]:
    """Return the parameter that turns a compass (None: the board), and its value."""
    inside = slot is None or external_of(parameters, slot) is False
    name = BOARD if slot is None or inside else f"COMPASS_ORIENT{suffix_of(slot)}"
    return name, int(parameters.get(name, 0))


def turn_of(parameters: Parameters, slot: int | None) -> NDArray[np.float64] | None:
    """Return the rotation (3, 3) of a compass (None: of the board) to the vehicle's axes; None if it is not known."""
    _, number = number_of(parameters, slot)
    if number in _CUSTOM:
        prefix = f"CUST_ROT{_CUSTOM[number]}"
        return euler(*(parameters.get(f"{prefix}_{angle}", 0.0) for angle in ("ROLL", "PITCH", "YAW")))
    return mounting(number) if 0 <= number <= LARGEST_MOUNTING else None


def custom_of(parameters: Parameters, slot: int) -> int:
    """Return the number of a custom rotation that neither the board nor another compass has; 0 without one."""
    names = [f"COMPASS_ORIENT{suffix_of(other)}" for other in range(_COMPASSES)]
    own = _CUSTOM.get(int(parameters.get(names.pop(slot) if slot < _COMPASSES else "", 0)), slot + 1)
    in_use = {_CUSTOM.get(int(parameters.get(name, 0))) for name in (BOARD, *names)}
    return next((one for one in (own, 1, 2) if one <= len(_CUSTOM) and one not in in_use), 0)
