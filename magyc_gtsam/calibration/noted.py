"""A calibration with more diagnostics, or with what an export must know of its log; values are not checked again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from magyc_gtsam.calibration.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.applied import is_calibrated
from magyc_gtsam.recording.autopilot import Autopilot
from magyc_gtsam.recording.axes import OWN_AXES

# Entries of a configuration.
_OF_THE_RECORDING = ("gyroscope_axes", "magnetic_field_unit", "autopilot", "compass", "calibrated_before")


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


def as_mounted(calibration: Calibration, log: Mounted, compass: int | None = None) -> Calibration:
    """Return the calibration with what `export` must know of its log in its configuration.

    The covariance of one that is of a recording contains what its reader does not know of the offset that it undid.

    Args:
        calibration: of the log.
        log: with its axes and autopilot; whether its field was calibrated before is noted as well.
        compass: number of the magnetometer among those of its log, if it was given.
    """
    known: dict[str, Any] = {} if compass is None else {"compass": compass}
    known |= {} if log.gyroscope_axes == OWN_AXES else {"gyroscope_axes": log.gyroscope_axes}
    if isinstance(log, Recording) and is_calibrated(log):
        known["calibrated_before"] = True
    if log.autopilot is not None:
        known["autopilot"] = log.autopilot.to_dict()
        if isinstance(log, Recording):  # the calibrations of a history contain it
            calibration = _less_certain(calibration, log.autopilot.offset_sigma)
    return _with(calibration, "configuration", known) if known else calibration


def options_among(configuration: Mapping[str, Any], recording: Recording | None = None) -> dict[str, Any]:
    """Return the options of `calibrate` among the entries of a configuration; the others describe its recording.

    Args:
        configuration: of a calibration, or options of `calibrate`.
        recording: that is calibrated with them; None if it is not known.

    Raises:
        MagycError: the recording has other axes or another unit, or the compass is not numbered from 1.
    """
    compass = configuration.get("compass", 1)
    if isinstance(compass, bool) or not isinstance(compass, int) or compass < 1:
        raise MagycError(f"compass: must be a number from 1 on, got {compass!r:.40}")
    for name, option in (("gyroscope_axes", "gyroscope_axes"), ("magnetic_field_unit", "magnetic_unit")):
        here = given = configuration.get(name)
        if recording is not None and given is not None:
            here = getattr(recording, name)
        if here != given:
            raise MagycError(
                f"{name}: the recording has {here!r:.60}, and the options are of one with {given!r:.60}; it is chosen "
                f"where the log is read (mg.read, {option}=)"
            )
    return {name: value for name, value in configuration.items() if name not in _OF_THE_RECORDING}


def _with(calibration: Calibration, name: str, more: Mapping[str, Any]) -> Calibration:
    result = object.__new__(type(calibration))
    every = MappingProxyType({**getattr(calibration, name), **more})
    result.__dict__.update({**calibration.__dict__, name: every})
    return result


def _less_certain(calibration: Calibration, sigma: Sequence[float]) -> Calibration:
    """Return the calibration with a further error of the hard iron, of sigmas (3,) T."""
    if calibration.covariance is None or not any(sigma):
        return calibration
    covariance = calibration.covariance.copy()
    covariance[6:9, 6:9] += np.diag(np.square(sigma))
    covariance.flags.writeable = False
    result = object.__new__(type(calibration))
    result.__dict__.update({**calibration.__dict__, "covariance": covariance})
    return result
