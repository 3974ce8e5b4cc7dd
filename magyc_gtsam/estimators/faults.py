"""What no method may learn from: axes that stood still, and turns that the gyroscope cut off."""

from __future__ import annotations

from collections.abc import Sequence

from magyc_gtsam.estimators.clipped import find_clipped, without_clipped
from magyc_gtsam.estimators.stuck import find_stuck, without_stuck
from magyc_gtsam.recording import Recording


def without_faults(recording: Recording, sensors: Sequence[str]) -> tuple[Recording, list[str]]:
    """The rows in which nothing was wrong with the named sensors, and what was left out, in words.

    Raises:
        MagycError: too little is left.
    """
    clipped = find_clipped(recording) if "angular_rate" in sensors else None
    usable = without_clipped(
        recording, clipped
    )  # first: a long turn at full scale looks like an axis that is stuck
    stuck = find_stuck(usable, sensors)
    usable = without_stuck(usable, stuck)
    return usable, [fault.where for fault in (*stuck, clipped) if fault is not None]
