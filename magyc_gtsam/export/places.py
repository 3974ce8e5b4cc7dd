"""The parameter names and the axes of a vehicle's sensors, by what the log says of its autopilot."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from magyc_gtsam.export.correction import Correction, degrees, number
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording.autopilot import Autopilot, Place, ardupilot_offset

_COMPASSES = {"px4": 4, "ardupilot": 3}  # number of compasses with parameters; other targets correct one sensor
_CUSTOM_ROTATIONS = 2  # of ArduPilot
_NAMES = {"px4": "PX4", "ardupilot": "ArduPilot"}
OF_THE_FIRST = {  # of a log that does not say which sensors of the vehicle it has
    "px4": "# For a sensor other than the first replace MAG0, GYRO0.",
    "ardupilot": "# For a compass other than the first replace COMPASS_OFS_, COMPASS_DIA_ by COMPASS_OFS2_ and so on.",
}


def places_of(autopilot: Autopilot | None, target: str, compass: int) -> tuple[Place, Place]:
    """Return the places of magnetometer and gyroscope in a target.

    Args:
        autopilot: of the log; None if it says nothing, so that the parameters are those of the given compass, and of
            sensors in the vehicle's axes.
        target: "px4", "ardupilot", "vectornav" or "ros".
        compass: number of the compass on the vehicle, from 1, of a log without an autopilot.

    Raises:
        MagycError: the target has no such compass, or the log does not say where or in which axes the target has it.
    """
    count = _COMPASSES.get(target)
    if count is None:
        return Place(), Place()
    if autopilot is None:
        if not isinstance(compass, int) or not 1 <= compass <= count:
            raise MagycError(f"compass: must be 1 to {count} for {target}, got {compass!r}")
        return Place(compass - 1), Place()
    if autopilot.magnetometer.problem:
        raise MagycError(f"nothing for {target}: {autopilot.magnetometer.problem}")
    if autopilot.firmware != target:
        raise MagycError(
            f"nothing for {target}: the log is of {_NAMES.get(autopilot.firmware, autopilot.firmware)}, and does not "
            f"say which of {_NAMES[target]}'s parameters its sensors have, in which axes; export for that autopilot"
        )
    return autopilot.magnetometer, autopilot.gyroscope


def in_places(correction: Correction, magnetometer: Place, gyroscope: Place) -> tuple[Correction, list[str]]:
    """Return a correction in the axes in which the firmware applies it, and a comment on what it leaves out.

    With the sensor's axes R, rotation A (R m − h) = (rotation R) (Rᵀ A R) (m − Rᵀ h).
    """
    own, gyroscope_own, c = np.array(magnetometer.axes), np.array(gyroscope.axes), correction
    bias, warming, remarks = c.gyro_bias, c.warming_gyro, []
    if gyroscope.problem and not (bias is None and warming is None):
        remarks = [f"# LIMIT: the gyroscope's values are not included: {gyroscope.problem}."]
        bias = warming = None
    if c.rotation is not None and magnetometer.fixed:
        angle = degrees(c.rotation)
        remarks.append(f"# LIMIT: a fixed rotation of {angle:.2f} deg is left out, since {magnetometer.fixed}.")
        c = replace(c, rotation=None)
    for sensor, place, slope in (("magnetometer", magnetometer, c.thermal), ("gyroscope", gyroscope, warming)):
        if slope is not None and place.thermal:
            remarks.append(f"# LIMIT: the {sensor}'s dependence on temperature is not included: {place.thermal}.")
    warming = None if gyroscope.thermal else warming
    c = replace(c, thermal=None) if magnetometer.thermal else c
    placed = replace(
        c,
        matrix=own.T @ c.matrix @ own,
        offset=c.offset @ own,
        gyro_axes=own.T @ c.gyro_axes @ gyroscope_own,
        mounting=np.array(magnetometer.mounting),
        rotation=None if c.rotation is None else c.rotation @ own,
        motor=None if c.motor is None else c.motor @ own,
        motors=None if c.motors is None else c.motors @ own,
        thermal=None if c.thermal is None else c.thermal @ own,
        gyro_bias=None if bias is None else bias @ gyroscope_own,
        warming_gyro=None if warming is None else warming @ gyroscope_own,
    )
    return placed, remarks


def cleared(lines: list[str], target: str, magnetometer: Place, autopilot: Autopilot | None) -> list[str]:
    """Return the lines that set to 0 what corrects a compass on the vehicle, and must not any more.

    That is what did not correct it in the recording, and what corrects other compasses by a power that is another one
    from now on, since all compasses have the same.
    """
    if target not in _COMPASSES:
        return []
    separator = "\t" if target == "px4" else ","
    written = dict(
        line.split(separator)[2:4] if target == "px4" else line.split(separator)
        for line in lines
        if not line.startswith("#") and separator in line
    )
    names = [name for name in magnetometer.to_clear if name not in written]
    because = {"the log's correction for the motors is not in this calibration": names}
    power = "CAL_MAG_COMP_TYP" if target == "px4" else "COMPASS_MOTCT"
    if autopilot is not None and written.get(power, str(autopilot.compensation)) != str(autopilot.compensation):
        why = f"{power} was {autopilot.compensation} in the log, and those are of other compasses, not calibrated here"
        because[why] = list(autopilot.others)
    result: list[str] = []
    for why, those in because.items():
        if those:
            result.append(f"# {', '.join(those)}: 0, because {why}.")
            result += [f"1\t1\t{name}\t{number(0.0)}\t9" if target == "px4" else f"{name},0" for name in those]
    return result


def numbered(lines: list[str], target: str, magnetometer: Place, gyroscope: Place) -> list[str]:
    """Return the lines of an export for the first sensors with the parameter names of others.

    Raises:
        MagycError: the target has a parameter of the export only for the first sensors.
    """
    if target == "px4":
        return _of_px4(lines, magnetometer, gyroscope)
    return _of_ardupilot(lines, magnetometer, gyroscope.slot) if target == "ardupilot" else lines


def _of_px4(lines: list[str], magnetometer: Place, gyroscope: Place) -> list[str]:
    remarks, identifiers = [], []
    for kind, thermal, place in (("MAG", "TC_M", magnetometer), ("GYRO", "TC_G", gyroscope)):
        lines = [re.sub(rf"\b(CAL_{kind}|{thermal})0_", rf"\g<1>{place.slot}_", line) for line in lines]
        name = f"CAL_{kind}{place.slot}_"
        if not any(line.startswith(f"1\t1\t{name}") for line in lines):
            continue
        if place.device is not None:
            identifiers.append(f"1\t1\t{name}ID\t{place.device}\t6")
        elif place.slot:
            remarks.append(f"# {name}ID must be the identifier of the log's {kind.lower()} device.")
    return [*remarks, *lines, *identifiers]


def _of_ardupilot(lines: list[str], magnetometer: Place, gyroscope: int) -> list[str]:
    lines = [re.sub(r"\bINS_GYROFFS", ardupilot_offset(gyroscope), line) for line in lines]
    compass = magnetometer.slot + 1
    custom = magnetometer.custom or compass
    suffix = "" if compass == 1 else str(compass)
    if custom > _CUSTOM_ROTATIONS and any(line.startswith("CUST_ROT1_") for line in lines):
        raise MagycError(
            f"compass {compass}: ArduPilot has only {_CUSTOM_ROTATIONS} custom rotations; mount it straight"
        )
    if compass > 1 and any(line.startswith("COMPASS_PMOT_EN") for line in lines):
        raise MagycError(f"compass {compass}: ArduPilot compensates per motor only for the first compass")
    renames = (
        (r"\bCOMPASS_(OFS|DIA|ODI|MOT)_", rf"COMPASS_\g<1>{suffix}_"),
        (r"\bCOMPASS_ORIENT([ ,])101\b", rf"COMPASS_ORIENT{suffix}\g<1>{100 + custom}"),
        (r"\bCOMPASS_(SCALE|ORIENT)\b", rf"COMPASS_\g<1>{suffix}"),
        (r"\bCUST_ROT1_", f"CUST_ROT{custom}_"),
    )
    for old, new in renames:
        lines = [re.sub(old, new, line) for line in lines]
    return lines
