"""A calibration with more diagnostics, whose values are not checked again."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

from magyc_gtsam.calibration.calibration import Calibration


def noted(calibration: Calibration, **diagnostics: Any) -> Calibration:
    """Return the calibration with further diagnostics, of JSON types, by name."""
    result = object.__new__(type(calibration))
    every = MappingProxyType({**calibration.diagnostics, **diagnostics})
    result.__dict__.update({**calibration.__dict__, "diagnostics": every})
    return result
