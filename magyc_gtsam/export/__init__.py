"""Export of calibrations as parameters of PX4, ArduPilot, VectorNav and ROS, ready to paste; one file per target.

All four correct with a matrix and an offset, like this package (`soft_iron⁻¹ (m − hard_iron)`), but differ in units, in
the sign of the offset and in the matrices they can represent. Nothing is rescaled: the field strength that `soft_iron`
implies is kept. A rotation to the gyroscope's axes goes into the mounting; motor current and temperature go into the
parameters that the target has for them.
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
_SMALLEST_ROTATION = 1e-6  # rad; less is rounding


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
    """Return the text to paste into `target`.

    Args:
        target: "px4", "ardupilot", "vectornav" or "ros".
        soft_iron: (3, 3).
        hard_iron: (3,) T, at zero current and at the `reference` temperature.
        gyro_bias: (3,) rad/s, in the gyroscope's axes; None leaves the gyroscope out.
        terms: names of other effects of the calibration, which no target can represent; a comment lists them.
        rotation: (3, 3) from the axes of the calibrated field to the gyroscope's; it goes into the mounting.
        motor: (3,) T/A, change of the reading with the motors' current.
        motors: (4, 3) T, change of the reading at full output of motors 1 to 4; for ArduPilot only.
        thermal: (3,) T/°C, change of the reading with the temperature above `reference` (°C).
        warming_gyro: (3,) rad/s/°C, change of the angular rate with the temperature above `gyro_reference` (°C).
        compass: number of the compass on the vehicle, from 1, for targets with several.

    Raises:
        MagycError: the target is unknown or cannot represent the calibration.
    """
    if target not in TARGETS:
        raise MagycError(f"unknown export target {target!r}; there are {', '.join(TARGETS)}")
    correction = Correction(
        matrix=np.linalg.inv(np.asarray(soft_iron, dtype=np.float64)),
        offset=np.asarray(hard_iron, dtype=np.float64),
        gyro_bias=_array(gyro_bias),
        rotation=_beyond_rounding(_array(rotation)),
        motor=_array(motor),
        thermal=_array(thermal),
        reference=reference,
        motors=_array(motors),
        warming_gyro=_array(warming_gyro),
        gyro_reference=gyro_reference,
    )
    lines = numbered(TARGETS[target](correction), target, compass)
    missing = [*terms]
    missing += ["motor-current"] if motor is not None and target not in _WITH_MOTOR else []
    missing += ["temperature-hard-iron"] if thermal is not None and target not in _WITH_TEMPERATURE else []
    missing += ["temperature-gyro"] if warming_gyro is not None and target not in _WITH_TEMPERATURE else []
    limit = (
        [f"# LIMIT: not included: {', '.join(missing)}. Only `magyc-gtsam apply` corrects it."] if missing else []
    )
    return "\n".join([*limit, *lines]) + "\n"


def do_not_use(reason: str, text: str) -> str:
    """Return an exported text as comments, which no target reads, under DO NOT USE and the reason."""
    lines = [f"DO NOT USE: {' '.join(reason.split())}", *text.splitlines()]
    return "".join(f"# {line}\n" for line in lines)


def _array(value: ArrayLike | None) -> Array | None:
    return None if value is None else np.asarray(value, dtype=np.float64)


def _beyond_rounding(rotation: Array | None) -> Array | None:
    """Return the rotation (3, 3), or None if its angle is only rounding."""
    return None if rotation is None or np.radians(degrees(rotation)) <= _SMALLEST_ROTATION else rotation
