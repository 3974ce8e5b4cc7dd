"""The thermal correction that PX4 subtracts from raw values before its calibration, by the parameters in the log.

It is a polynomial of third degree of the sensor's own temperature, relative to TREF and within [TMIN, TMAX]. The
calibration's offsets (CAL_MAGn_*OFF, CAL_GYROn_*OFF) are subtracted after it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError

Array = NDArray[np.float64]

_SETS = range(4)
_DEGREE = 3


def corrected(
    kind: Literal["TC_M", "TC_G"],
    raw: Array,
    temperature: Array | None,
    parameters: Mapping[str, float],
    device: int | None,
) -> tuple[Array, str]:
    """Return raw values (n, 3) as PX4 corrects them for temperature, and a note; "" if it does not.

    Args:
        kind: of the parameters, of a magnetometer or a gyroscope.
        raw: (n, 3) in the sensor's axes, gauss or rad/s.
        temperature: (n,) °C of the sensor; None if the message has none.
        parameters: of the log.
        device: identifier of the sensor; None if the log does not name it.

    Raises:
        MagycError: PX4 corrects the values, and the log has no temperature of the sensor.
    """
    prefix, slopes = _in_force(kind, parameters, device)
    if not slopes.any():
        return raw, ""
    if temperature is None:
        raise MagycError(
            f"{prefix}* corrects the sensor for its temperature, which the message does not have; read the corrected "
            "one (magnetic_field='vehicle_magnetometer', angular_rate='sensor_combined')"
        )
    reference = parameters.get(f"{prefix}TREF", 25.0)
    least, most = parameters.get(f"{prefix}TMIN", 0.0), parameters.get(f"{prefix}TMAX", 100.0)
    warm = np.clip(np.asarray(temperature, dtype=np.float64), least, most) - reference
    offset = np.vander(warm, _DEGREE + 1, increasing=True) @ slopes
    return raw - offset, f"{prefix}*: the thermal correction of PX4 is subtracted, and stays"


def in_the_way(
    kind: Literal["TC_M", "TC_G"], parameters: Mapping[str, float], device: int | None, slot: int
) -> str:
    """Return why a thermal correction cannot be written to the parameters of a slot; "" if it can.

    Args:
        kind, parameters, device: as of `corrected`.
        slot: number of the parameters.
    """
    prefix, slopes = _in_force(kind, parameters, device)
    if slopes.any():
        return f"{prefix}* corrects the sensor already, and would be replaced"
    other = int(parameters.get(f"{kind}{slot}_ID", 0))
    return f"{kind}{slot}_* are those of another sensor ({other})" if other not in (0, device) else ""


def _in_force(kind: str, parameters: Mapping[str, float], device: int | None) -> tuple[str, Array]:
    """Return the beginning of the names of a sensor's correction, and its coefficients (4, 3); 0 without one."""
    found = next((n for n in _SETS if device and int(parameters.get(f"{kind}{n}_ID", 0)) == device), None)
    if found is None or not parameters.get(f"{kind}_ENABLE", 0):
        return "", np.zeros((_DEGREE + 1, 3))
    prefix = f"{kind}{found}_"
    return prefix, np.array(
        [[parameters.get(f"{prefix}X{degree}_{axis}", 0.0) for axis in range(3)] for degree in range(_DEGREE + 1)]
    )
