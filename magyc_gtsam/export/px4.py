"""PX4: field = R S (raw + power · COMP − TC(temperature) − OFF), R from ROT, ROLL, PITCH, YAW.

The power is the throttle, 0 to 1, while armed (CAL_MAG_COMP_TYP 1), or the current of battery 1 (2) or 2 (3) in kA, by
VehicleMagnetometer::UpdatePowerCompensation.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.export.correction import (
    EXTERNAL_ONLY,
    GAUSS,
    Array,
    Correction,
    angles,
    axes,
    degrees,
    number,
    symmetric,
)
from magyc_gtsam.export.power import THROTTLE

_SCALE = (0.1, 3.0)  # range of CAL_MAG0_*SCALE


def px4(c: Correction) -> list[str]:
    """Return the lines of a parameter file for QGroundControl."""
    scale, notes = symmetric(c.matrix, "PX4")
    rotation = c.rotation
    values = axes("CAL_MAG0_{}OFF", c.offset * GAUSS)
    values |= axes("CAL_MAG0_{}SCALE", np.diag(scale))
    values |= axes("CAL_MAG0_{}ODIAG", scale[(0, 0, 1), (1, 2, 2)])
    whole: dict[str, int] = {}
    low, high = _SCALE
    if not ((np.diag(scale) >= low) & (np.diag(scale) <= high)).all():
        notes.append(f"LIMIT: a CAL_MAG0_*SCALE is outside {low:g} to {high:g}, the range PX4 accepts.")
    if rotation is not None:
        whole["CAL_MAG0_ROT"] = 100
        values |= dict(zip(("CAL_MAG0_ROLL", "CAL_MAG0_PITCH", "CAL_MAG0_YAW"), angles(rotation), strict=True))
        notes.append(f"CAL_MAG0_ROT 100, with ROLL, PITCH, YAW in degrees, turns by {degrees(rotation):.2f} deg.")
        notes.append("It replaces CAL_MAG0_ROT of the log (0 if the log is not of PX4), for an external compass.")
        notes.append(EXTERNAL_ONLY)
    if c.motor is not None:
        whole["CAL_MAG_COMP_TYP"] = c.power.type
        values |= axes("CAL_MAG0_{}COMP", -c.motor * GAUSS * (1.0 if c.power.type == THROTTLE else 1e3))
        battery = f"per kA of battery {c.power.type - 1}'s current"
        of = "at full throttle" if c.power.type == THROTTLE else battery
        notes.append(f"CAL_MAG0_*COMP: gauss {of}, ADDED to the raw field, while armed.")
        notes.append(
            f"It was found with the channel {c.power.channel}."
            if c.power.channel
            else "If the channel was a throttle of 0 to 1: CAL_MAG_COMP_TYP 1, and COMP divided by 1000."
        )
    if c.thermal is not None:
        whole["TC_M_ENABLE"] = 1
        values |= _polynomial("TC_M0", c.thermal * GAUSS, c.reference)
        notes.append("TC_M0_*: gauss per degree of the magnetometer's own thermometer, subtracted; set TC_M0_ID")
        notes.append("to CAL_MAG0_ID, and TC_M0_TMIN, TC_M0_TMAX to the range that the log covers.")
    if c.gyro_bias is not None:
        values |= axes("CAL_GYRO0_{}OFF", c.gyro_bias)
    if c.warming_gyro is not None:
        whole["TC_G_ENABLE"] = 1
        values |= _polynomial("TC_G0", c.warming_gyro, c.gyro_reference)
        notes.append("TC_G0_*: rad/s per degree of the gyroscope's own thermometer, subtracted; set TC_G0_ID to")
        notes.append("CAL_GYRO0_ID, and TC_G0_TMIN, TC_G0_TMAX to the range that the log covers.")
    return [
        "# PX4 parameters (QGroundControl: Vehicle Setup > Parameters > Tools > Load from file).",
        "# Offsets in gauss, SUBTRACTED: field = scale * (raw - offset), in the sensor's own axes, before",
        "# CAL_MAG0_ROT. XODIAG, YODIAG, ZODIAG are the elements xy, xz, yz of the scale matrix.",
        "# Gyroscope offsets in rad/s, subtracted.",
        *(f"# {note}" for note in notes),
        "# Vehicle-Id Component-Id Name Value Type",
        *(f"1\t1\t{name}\t{value}\t6" for name, value in whole.items()),
        *(f"1\t1\t{name}\t{number(value)}\t9" for name, value in values.items()),
    ]


def _polynomial(name: str, slope: Array, reference: float) -> dict[str, float]:
    """Return the parameters of a thermal correction of degree 1, with slope (3,) per °C above `reference`."""
    values = {f"{name}_X1_{k}": float(value) for k, value in enumerate(slope)}
    values[f"{name}_TREF"] = reference
    return values | {f"{name}_X{n}_{k}": 0.0 for n in (0, 2, 3) for k in range(3)}
