"""A calibration with more diagnostics, or the gyroscope's axes, whose values are not checked again."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from magyc_gtsam.calibration.calibration import Calibration
from magyc_gtsam.recording.axes import OWN_AXES


def noted(calibration: Calibration, **diagnostics: Any) -> Calibration:
    """Return the calibration with further diagnostics, of JSON types, by name."""
    return _with(calibration, "diagnostics", diagnostics)


def with_gyroscope_axes(calibration: Calibration, axes: str) -> Calibration:
    """Return the calibration with `Recording.gyroscope_axes` in its configuration, which `export` turns back."""
    return calibration if axes == OWN_AXES else _with(calibration, "configuration", {"gyroscope_axes": axes})


def _with(calibration: Calibration, name: str, more: Mapping[str, Any]) -> Calibration:
    result = object.__new__(type(calibration))
    every = MappingProxyType({**getattr(calibration, name), **more})
    result.__dict__.update({**calibration.__dict__, name: every})
    return result
