"""Calibration of magnetometers and gyroscopes on GTSAM factor graphs, from the data that a vehicle records anyway."""

from __future__ import annotations

from typing import Any

from magyc_gtsam.factors.lazy import attribute

# Name → module, imported at first use, so that `import magyc_gtsam` and `magyc-gtsam --help` start without gtsam.
_PUBLIC = {
    "AccelerometerCalibration": "estimators.autocal.accelerometer",
    "Calibration": "calibration",
    "History": "history",
    "MagycError": "factors.errors",
    "Method": "estimators.method",
    "OnlineCalibrator": "online",
    "Recording": "recording",
    "Simulation": "simulation",
    "calibrate": "estimators",
    "compare": "study.comparison",
    "calibrate_accelerometer": "estimators.autocal.accelerometer",
    "calibrate_many": "history",
    "find_gap": "gap",
    "methods": "estimators",
    "read": "io",
    "read_many": "io.many",
    "simulate": "simulation",
}

__all__ = [*_PUBLIC, "__version__"]

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    return attribute(__name__, _PUBLIC, name)


def __dir__() -> list[str]:
    return sorted(__all__)
