"""What no method may learn from: axes that stood still, turns that the gyroscope cut off; and what none can mend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.estimators.clipped import find_clipped, without_clipped
from magyc_gtsam.estimators.clipped_field import ClippedField, find_clipped_field
from magyc_gtsam.estimators.stuck import find_stuck, without_stuck
from magyc_gtsam.recording import Recording


@dataclass(frozen=True, eq=False)
class Usable:
    """What is left of a recording.

    Attributes:
        recording: the rows in which nothing was wrong that could be left out.
        left_out: what was, in words.
        clipped: what the magnetometer's full scale cut off, which is still in the rows; None where nothing was.
    """

    recording: Recording
    left_out: list[str]
    clipped: ClippedField | None


def without_faults(recording: Recording, sensors: Sequence[str]) -> Usable:
    """The rows in which nothing was wrong with the named sensors.

    Raises:
        MagycError: too little is left.
    """
    clipped = find_clipped(recording) if "angular_rate" in sensors else None
    usable = without_clipped(
        recording, clipped
    )  # first: a long turn at full scale looks like an axis that is stuck
    field = find_clipped_field(usable) if "magnetic_field" in sensors else None
    stuck = find_stuck(usable, sensors, None if field is None else np.array(field.levels))
    usable = without_stuck(usable, stuck)
    return Usable(usable, [fault.where for fault in (*stuck, clipped) if fault is not None], field)
