"""`Recording`: what a vehicle recorded, validated once and never changed afterwards."""

from __future__ import annotations

from magyc_gtsam.recording.checks import Array, Mask
from magyc_gtsam.recording.recording import Hole, Recording, Samples

__all__ = ["Array", "Hole", "Mask", "Recording", "Samples"]
