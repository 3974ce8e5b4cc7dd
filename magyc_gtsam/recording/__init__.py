"""`Recording`: what a vehicle recorded, validated once and never changed afterwards."""

from __future__ import annotations

from magyc_gtsam.recording.checks import Array, Mask
from magyc_gtsam.recording.recording import Gap, Recording, Samples

__all__ = ["Array", "Gap", "Mask", "Recording", "Samples"]
