"""`Calibration`: the result of every method; immutable, applied to data, saved and loaded without loss."""

from __future__ import annotations

from magyc_gtsam.calibration.calibration import Calibration

__all__ = ["Calibration"]
