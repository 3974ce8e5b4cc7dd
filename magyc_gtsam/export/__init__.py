"""Calibrations as parameters of PX4, ArduPilot, VectorNav and ROS, ready to paste; a target is a file.

All four correct with a matrix and an offset, as we do (`soft_iron⁻¹ (m − hard_iron)`), but differ in
units, in the sign of the offset and in the matrices they can hold. Nothing is rescaled: the field
strength that `soft_iron` implies is kept. A rotation to the gyroscope's axes goes into the mounting, the
motors' current and the temperature into the target's own terms where it has them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.export.ardupilot import ardupilot
from magyc_gtsam.export.compass_number import numbered
from magyc_gtsam.export.correction import Array, Correction, degrees
from magyc_gtsam.export.parts import parts_of
from magyc_gtsam.export.px4 import px4
from magyc_gtsam.export.ros import ros
from magyc_gtsam.export.vectornav import vectornav
from magyc_gtsam.factors.errors import MagycError

__all__ = ["TARGETS", "do_not_use", "export", "parts_of"]

TARGETS: dict[str, Callable[[Correction], list[str]]] = {
    "px4": px4,
    "ardupilot": ardupilot,
    "vectornav": vectornav,
    "ros": ros,
}
_WITH_MOTOR = ("px4", "ardupilot")
_WITH_TEMPERATURE = ("px4",)
_TURNED = 1e-6  # rad, below which a rotation is rounding


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
    warming_gyro: ArrayLike | None = None,
    gyro_reference: float = 0.0,
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
        warming_gyro: (3,) rad/s/°C that warming above `gyro_reference` (°C) adds to the angular rate.
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
        None if warming_gyro is None else np.asarray(warming_gyro, dtype=np.float64),
        gyro_reference,
    )
    lines = numbered(TARGETS[target](correction), target, compass)
    missing = [*terms]
    missing += ["motor-current"] if motor is not None and target not in _WITH_MOTOR else []
    missing += ["temperature-hard-iron"] if thermal is not None and target not in _WITH_TEMPERATURE else []
    missing += ["temperature-gyro"] if warming_gyro is not None and target not in _WITH_TEMPERATURE else []
    limit = (
        [f"# LIMIT: not in here: {', '.join(missing)}. Only `magyc-gtsam apply` takes it out."] if missing else []
    )
    return "\n".join([*limit, *lines]) + "\n"


def do_not_use(reason: str, text: str) -> str:
    """The values as comments, under DO NOT USE and the reason: no target reads any of them."""
    lines = [f"DO NOT USE: {' '.join(reason.split())}", *text.splitlines()]
    return "".join(f"# {line}\n" for line in lines)


def _beyond_rounding(rotation: ArrayLike | None) -> Array | None:
    if rotation is None:
        return None
    matrix = np.asarray(rotation, dtype=np.float64)
    return matrix if np.radians(degrees(matrix)) > _TURNED else None
