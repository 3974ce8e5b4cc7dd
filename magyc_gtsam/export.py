"""Calibrations in the words of PX4, ArduPilot, VectorNav and ROS."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError

Array = NDArray[np.float64]


def export(target: str, soft_iron: Array, hard_iron: Array, gyro_bias: Array | None = None) -> str:
    """Text to paste into `target`."""
    raise MagycError(f"no export called {target!r}")
