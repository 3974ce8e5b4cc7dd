"""Calibrate magnetometers and gyroscopes on GTSAM factor graphs, from the data a vehicle records anyway."""

from __future__ import annotations

import importlib
from typing import Any

# Name → module. Imported at first use, so that `magyc-gtsam --help` does not wait for gtsam.
_PUBLIC = {
    "AccelerometerCalibration": "magyc_gtsam.estimators.accelerometer",
    "Calibration": "magyc_gtsam.calibration",
    "MagycError": "magyc_gtsam.factors.errors",
    "OnlineCalibrator": "magyc_gtsam.online",
    "Recording": "magyc_gtsam.recording",
    "Simulation": "magyc_gtsam.simulation",
    "calibrate": "magyc_gtsam.estimators",
    "calibrate_accelerometer": "magyc_gtsam.estimators.accelerometer",
    "find_gap": "magyc_gtsam.gap",
    "methods": "magyc_gtsam.estimators",
    "read": "magyc_gtsam.io",
    "simulate": "magyc_gtsam.simulation",
}

__all__ = [*_PUBLIC, "__version__"]

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'magyc_gtsam' has no attribute {name!r}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
