"""`Recording`: the sensor data of one instrument, validated once and immutable."""

from __future__ import annotations

from magyc_gtsam.recording.checks import Array, Mask
from magyc_gtsam.recording.recording import Recording, Samples
from magyc_gtsam.recording.stamps import Hole

__all__ = ["Array", "Hole", "Mask", "Recording", "Samples"]
