"""`Calibration`: the immutable result of every method, which can be applied to data, saved, loaded and exported."""

from __future__ import annotations

from magyc_gtsam.calibration.calibration import Calibration

__all__ = ["Calibration"]
