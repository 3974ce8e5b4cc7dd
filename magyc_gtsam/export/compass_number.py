"""Renaming of the first compass's parameters to those of another compass of the vehicle."""

from __future__ import annotations

import re

from magyc_gtsam.factors.errors import MagycError

_COMPASSES = {"px4": 4, "ardupilot": 3}  # number of compasses with parameters; other targets correct one sensor
_CUSTOM_ROTATIONS = 2  # of ArduPilot


def numbered(lines: list[str], target: str, compass: int) -> list[str]:
    """Return the lines of an export with the parameter names of the given compass, counted from 1.

    Raises:
        MagycError: the target has no such compass, or has a parameter of the export only for the first ones.
    """
    count = _COMPASSES.get(target)
    if count is None or compass == 1:
        return lines
    if not isinstance(compass, int) or not 1 <= compass <= count:
        raise MagycError(f"compass: must be 1 to {count} for {target}, got {compass!r}")
    if target == "px4":
        slot = f"CAL_MAG{compass - 1}"
        renamed = [re.sub(r"\b(CAL_MAG|TC_M)0_", rf"\g<1>{compass - 1}_", line) for line in lines]
        return [f"# Of compass {compass} in the log: {slot}_ID must be its device id.", *renamed]
    if compass > _CUSTOM_ROTATIONS and any(line.startswith("CUST_ROT1_") for line in lines):
        raise MagycError(
            f"compass {compass}: ArduPilot has only {_CUSTOM_ROTATIONS} custom rotations; mount it straight"
        )
    if any(line.startswith("COMPASS_PMOT_EN") for line in lines):
        raise MagycError(f"compass {compass}: ArduPilot compensates per motor only for the first compass")
    renames = (
        (r"\bCOMPASS_(OFS|DIA|ODI|MOT)_", rf"COMPASS_\g<1>{compass}_"),
        (r"\bCOMPASS_ORIENT([ ,])101\b", rf"COMPASS_ORIENT{compass}\g<1>{100 + compass}"),
        (r"\bCOMPASS_(SCALE|ORIENT)\b", rf"COMPASS_\g<1>{compass}"),
        (r"\bCUST_ROT1_", f"CUST_ROT{compass}_"),
    )
    for old, new in renames:
        lines = [re.sub(old, new, line) for line in lines]
    return lines
