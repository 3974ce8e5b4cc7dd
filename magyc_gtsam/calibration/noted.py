"""A calibration with more diagnostics, or with what an export must know of its log; values are not checked again."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Protocol

from magyc_gtsam.calibration.calibration import Calibration
from magyc_gtsam.recording.autopilot import Autopilot
from magyc_gtsam.recording.axes import OWN_AXES


def noted(calibration: Calibration, **diagnostics: Any) -> Calibration:
    """Return the calibration with further diagnostics, of JSON types, by name."""
    return _with(calibration, "diagnostics", diagnostics)


class Mounted(Protocol):
    """What is known of the sensors' place on a vehicle: a `Recording`, or a log of a history."""

    @property
    def gyroscope_axes(self) -> str:
        """See `Recording`."""

    @property
    def autopilot(self) -> Autopilot | None:
        """See `Recording`."""


def with_clock_drift(calibration: Calibration, drift: float) -> Calibration:
    """Return the calibration with a drift of the clocks (s/s), taken out of the stamps, in its configuration."""
    return _with(calibration, "configuration", {"clock_drift": drift}) if drift else calibration


def as_mounted(calibration: Calibration, log: Mounted) -> Calibration:
    """Return the calibration with the axes and the autopilot of its log in its configuration, for `export`."""
    known: dict[str, Any] = {} if log.gyroscope_axes == OWN_AXES else {"gyroscope_axes": log.gyroscope_axes}
    if log.autopilot is not None:
        known["autopilot"] = log.autopilot.to_dict()
    return _with(calibration, "configuration", known) if known else calibration


def _with(calibration: Calibration, name: str, more: Mapping[str, Any]) -> Calibration:
    result = object.__new__(type(calibration))
    every = MappingProxyType({**getattr(calibration, name), **more})
    result.__dict__.update({**calibration.__dict__, name: every})
    return result
