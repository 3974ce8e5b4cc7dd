"""ArduPilot: field = M (R raw + OFS) + power · MOT, R from COMPASS_ORIENT and CUST_ROT1.

The power is the throttle, 0 to 1, of Copter and Sub (COMPASS_MOTCT 1), or the current of battery 1 in A (2), by
AP_Compass_Backend::correct_field.

With compensation per motor the last term is Σ (output · voltage)^EXP · PMOT over four motors of Copter, by
Compass_PerMotor::scaled_output: the outputs are 0 to 1, the voltage is the battery's.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.export.correction import (
    EXTERNAL_ONLY,
    Array,
    Correction,
    angles,
    axes,
    degrees,
    number,
    symmetric,
)
from magyc_gtsam.export.power import CURRENT, THROTTLE, unit_of
from magyc_gtsam.factors.effects.signals import is_one
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed

MOTORS = 4  # number of motors with separate compensation
_MILLIGAUSS = 1e7  # per tesla
_LARGEST_OFFSET = 1800.0  # milligauss, default of COMPASS_OFFS_MAX
_DIAGONAL = (0.2, 5.0)  # range that ArduPilot's calibration accepts
_OFF_DIAGONAL = 1.0  # largest magnitude that it accepts


def ardupilot(c: Correction) -> list[str]:
    """Return the lines of a parameter file for Mission Planner."""
    scale, notes = symmetric(c.matrix, "ArduPilot")
    unturned_scale, rotation = scale, c.rotation
    added = -c.offset * _MILLIGAUSS
    values: dict[str, float] = {}
    if rotation is not None:
        # R P (raw + o) = (R P Rᵀ) (R raw + R o): the compass is turned first, and its matrix stays symmetric.
        scale, added = rotation @ scale @ rotation.T, rotation @ added
        attitude = dict(zip(("ROLL", "PITCH", "YAW"), angles(rotation @ c.mounting), strict=True))
        values |= {"COMPASS_ORIENT": 101, "CUST_ROT_ENABLE": 1}
        values |= {f"CUST_ROT1_{name}": angle for name, angle in attitude.items()}
        notes += [
            f"COMPASS_ORIENT 101 turns by CUST_ROT1_*, degrees: by {degrees(rotation):.2f} deg, after the log's",
            "COMPASS_ORIENT (0 if the log is not of ArduPilot), which it replaces, for an external compass.",
            EXTERNAL_ONLY,
        ]
    diagonal, off_diagonal = np.diag(scale), scale[(0, 0, 1), (1, 2, 2)]
    values |= axes("COMPASS_OFS_{}", added) | axes("COMPASS_DIA_{}", diagonal)
    values |= axes("COMPASS_ODI_{}", off_diagonal) | {"COMPASS_SCALE": 1.0}
    length = float(np.linalg.norm(added))
    if length > _LARGEST_OFFSET:
        notes.append(
            f"LIMIT: offset of {length:.0f} milligauss, beyond {_LARGEST_OFFSET:g}: "
            "the vehicle will not arm. Move the compass away from iron, or raise COMPASS_OFFS_MAX."
        )
    low, high = _DIAGONAL
    if not ((diagonal > low) & (diagonal < high)).all():
        notes.append(f"LIMIT: a COMPASS_DIA is outside {low:g} to {high:g}, the range of ArduPilot's own fit.")
    if (np.abs(off_diagonal) >= _OFF_DIAGONAL).any():
        notes.append("LIMIT: a COMPASS_ODI is beyond 1, the limit of ArduPilot's own fit.")
    to_field = unturned_scale if rotation is None else rotation @ unturned_scale
    if c.motor is not None:
        values |= {"COMPASS_MOTCT": c.power.type} | axes("COMPASS_MOT_{}", -to_field @ c.motor * _MILLIGAUSS)
        of = "per ampere of battery 1's current" if c.power.type == CURRENT else "at full throttle"
        notes.append(f"COMPASS_MOT: milligauss {of}, ADDED after the matrix.")
        notes.append(
            f"It was found with the channel {c.power.channel}."
            if c.power.channel
            else "If the channel was a throttle of 0 to 1: COMPASS_MOTCT 1, with the same COMPASS_MOT."
        )
    if c.motors is not None:
        values |= {"COMPASS_PMOT_EN": 1, "COMPASS_PMOT_EXP": 1.0}
        for k, motor in enumerate(c.motors, start=1):
            values |= axes(f"COMPASS_PMOT{k}_{{}}", -to_field @ motor * _MILLIGAUSS)
        notes += [
            "COMPASS_PMOT: milligauss per volt of the battery at full output of motors 1 to 4, ADDED after the",
            "matrix, for the first compass of a Copter. ArduPilot multiplies it by output and voltage.",
        ]
    if c.gyro_bias is not None:
        values |= axes("INS_GYROFFS_{}", c.gyro_bias)
        notes.append("INS_GYROFFS is measured anew at every start unless INS_GYR_CAL is 0.")
    return [
        "# ArduPilot parameters (Mission Planner: Full Parameter List > Load from file).",
        "# Offsets in milligauss, ADDED: field = matrix * COMPASS_SCALE * (raw + offset), in the vehicle's",
        "# axes, after COMPASS_ORIENT. ODI_X, ODI_Y, ODI_Z are the elements xy, xz, yz of the matrix.",
        "# COMPASS_SCALE 1 says that the field strength is absolute; if it was not given to the",
        "# calibration, set 0: the correction stays the same. Gyroscope offsets in rad/s, subtracted.",
        *(f"# {note}" for note in notes),
        *(f"{name},{value if isinstance(value, int) else number(value)}" for name, value in values.items()),
    ]


def motors_of(term: Term, voltage: float | None) -> tuple[Array, Array]:
    """Return the effect (4, 3) T/V of motors 1 to 4 at full output, and that (3,) T of all at their reference outputs.

    Args:
        term: a motor-current with the motors' outputs as its channels.
        voltage: V, of the battery while the effect was found.

    Raises:
        MagycError: the voltage is not known, a channel is a current, or there is one beyond the fourth.
    """
    if voltage is None or not 0 < voltage < np.inf:
        raise MagycError(
            "per motor: ArduPilot multiplies a motor's output by the voltage of the battery, which is needed "
            f"in V (battery_voltage=); got {voltage}"
        )
    if currents := [name for name in term.channels if is_one(name, "current")]:
        raise MagycError(
            f"per motor: ArduPilot corrects a compass by the outputs of the motors, 0 to 1, not by their currents "
            f"({listed(currents)}); find the effect with the outputs as channels, or with the battery's current alone"
        )
    value = term.value
    references = {int(name.rpartition("_")[2]): output for name, output in term.setting.items() if name != "lag"}
    rows = sorted(references) or list(range(len(value) // 3))
    if rows[-1] >= MOTORS:
        raise MagycError(
            f"per motor: ArduPilot compensates for {MOTORS} motors, the calibration has a channel of current number "
            f"{rows[-1] + 1}"
        )
    motors = np.zeros((MOTORS, 3))
    motors[rows] = value.reshape(-1, 3)
    at_rest = np.array([references.get(row, 0.0) for row in range(MOTORS)]) @ motors
    for row, name in enumerate(term.channels[:MOTORS]):
        motors[row] *= unit_of(name, THROTTLE)
    return motors / voltage, at_rest
