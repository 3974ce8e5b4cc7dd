"""The parameters of the first compass renamed to those of another of the same vehicle."""

from __future__ import annotations

import re

from magyc_gtsam.factors.errors import MagycError

_COMPASSES = {"px4": 4, "ardupilot": 3}  # that a target has parameters for; the others correct one sensor
_ROTATIONS = 2  # custom ones of ArduPilot


def numbered(lines: list[str], target: str, compass: int) -> list[str]:
    """The lines of an export for the compass of that number, from 1.

    Raises:
        MagycError: the target has no such compass, or what is exported exists for the first ones only.
    """
    most = _COMPASSES.get(target)
    if most is None or compass == 1:
        return lines
    if not isinstance(compass, int) or not 1 <= compass <= most:
        raise MagycError(f"compass: {compass!r}; {target} has parameters for 1 to {most}")
    if target == "px4":
        slot = f"CAL_MAG{compass - 1}"
        renamed = [re.sub(r"\b(CAL_MAG|TC_M)0_", rf"\g<1>{compass - 1}_", line) for line in lines]
        return [f"# Of compass {compass} in the log: {slot}_ID must be its device id.", *renamed]
    if compass > _ROTATIONS and any(line.startswith("CUST_ROT1_") for line in lines):
        raise MagycError(f"compass {compass}: ArduPilot has {_ROTATIONS} custom rotations only; mount it straight")
    if any(line.startswith("COMPASS_PMOT_EN") for line in lines):
        raise MagycError(f"compass {compass}: ArduPilot compensates motor by motor for the first compass only")
    renames = (
        (r"\bCOMPASS_(OFS|DIA|ODI|MOT)_", rf"COMPASS_\g<1>{compass}_"),
        (r"\bCOMPASS_ORIENT([ ,])101\b", rf"COMPASS_ORIENT{compass}\g<1>{100 + compass}"),
        (r"\bCOMPASS_(SCALE|ORIENT)\b", rf"COMPASS_\g<1>{compass}"),
        (r"\bCUST_ROT1_", f"CUST_ROT{compass}_"),
    )
    for old, new in renames:
        lines = [re.sub(old, new, line) for line in lines]
    return lines
