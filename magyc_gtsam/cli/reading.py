"""From the options of a command to a `Recording`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from magyc_gtsam.cli import options as given

if TYPE_CHECKING:
    from magyc_gtsam.recording import Array, Recording

_AXIS = re.compile(r"^(?:[xyz]\s*(?:←|<-|=)\s*)?([+−-]?)\s*([xyz])$")
_EXPONENT = re.compile(r"^[+-]?(?:\d+\.?\d*|\.\d+)[eE][+-]?\d+$")
# Numbers as YAML 1.2 has them: 1e-9 is one, without a point too.
_YAML_1_2 = {"tag:yaml.org,2002:float": (_EXPONENT, list("+-.0123456789"))}
_EPOCH = re.compile(r"time 0 is .*?(\d+)\.(\d{9}) s")


@dataclass(frozen=True)
class Reading:
    """How a log is to be read: the options of every command that has a LOG."""

    log: given.Log
    magnetic_field: given.MagneticField = None
    angular_rate: given.AngularRate = None
    acceleration: given.Acceleration = None
    attitude: given.Attitude = None
    magnetic_unit: given.MagneticUnit = None
    angular_unit: given.AngularUnit = None
    acceleration_unit: given.AccelerationUnit = None
    start: given.Start = None
    end: given.End = None
    stamps: given.Stamps = "header"
    angular_rate_is: given.AngularRateIs = None
    gyroscope_axes: given.GyroscopeAxes = None
    read: given.Read = None

    def recording(self, progress: Callable[[float], None] | None = None, *, counts: bool = False) -> Recording:
        """Read the log.

        Args:
            progress: called with the fraction done.
            counts: whether a field in raw counts is of use.

        Raises:
            MagycError: as `magyc_gtsam.read`, and for axes or options that mean nothing.
        """
        from magyc_gtsam import MagycError, read

        arguments = self.arguments()
        axes = None if self.gyroscope_axes is None else parse_axes(self.gyroscope_axes)
        recording: Recording = read(self.log, **arguments, progress=progress)
        if recording.magnetic_field_unit == "counts" and not counts:
            raise MagycError(
                "--magnetic-unit counts: a calibration needs the field in tesla; give tesla per count, or see "
                "what the methods make of the counts (magyc-gtsam compare)"
            )
        if axes is not None:
            recording = _turned(recording, axes)
        return recording if self.angular_rate_is is None else _restated(recording, self.angular_rate_is)

    def arguments(self) -> dict[str, Any]:
        """For `magyc_gtsam.read`.

        Raises:
            MagycError: an interval or options that mean nothing.
        """
        from magyc_gtsam.factors.errors import MagycError

        arguments = asdict(self)
        for own in ("log", "angular_rate_is", "gyroscope_axes", "read"):
            del arguments[own]
        for unit in ("magnetic_unit", "angular_unit", "acceleration_unit"):
            arguments[unit] = parse_unit(arguments[unit])
        if self.start is not None and self.end is not None and not self.start < self.end:
            raise MagycError(f"--start {self.start:g} s is not before --end {self.end:g} s")
        return arguments | parse_pairs("--read", self.read)

    def to_dict(self) -> dict[str, Any]:
        """What was asked beyond the defaults, JSON types."""
        given = {k: v for k, v in asdict(self).items() if v != getattr(Reading, k, None)}
        return given | {"log": str(self.log)}


def parse_axes(text: str) -> Array:
    """(3, 3) with which the gyroscope's vector comes into the magnetometer's axes.

    Args:
        text: the gyroscope's signed axes along x, y, z: "y,-x,z" or "x ← y, y ← −x, z ← z".
    """
    import numpy as np

    from magyc_gtsam.factors.errors import MagycError

    found = [_AXIS.match(part.strip().lower()) for part in text.split(",")]
    names = [match[2] for match in found if match]
    if len(found) != 3 or sorted(names) != ["x", "y", "z"]:
        raise MagycError(f"--gyroscope-axes: {text!r} does not name x, y and z once each; write it as 'y,-x,z'")
    matrix = np.zeros((3, 3))
    for row, match in enumerate(match for match in found if match):
        matrix[row, "xyz".index(match[2])] = -1.0 if match[1] in ("-", "−") else 1.0
    return matrix


def parse_pairs(option: str, pairs: Sequence[str] | None) -> dict[str, Any]:
    """{key: value} of "key=value" texts; values are YAML, so that 3, true and [1, 2] mean what they say."""
    if not pairs:
        return {}
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.storage.mapping import parse_yaml

    result = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.strip():
            raise MagycError(f"{option}: {pair!r} is not of the form key=value")
        try:
            result[key.strip().replace("-", "_")] = parse_yaml(value, _YAML_1_2)
        except MagycError:
            raise MagycError(f"{option}: the value of {pair!r} cannot be read") from None
    return result


def epoch(recording: Recording) -> int:
    """ns since the origin of the log's clock at the recording's time 0, as the reader noted it; else 0."""
    found = next((m for m in map(_EPOCH.search, recording.notes) if m), None)
    return int(found[1]) * 1_000_000_000 + int(found[2]) if found else 0


def parse_unit(text: str | None) -> str | float | None:
    """A unit's name, or the number that stands for one."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return text


def _turned(recording: Recording, axes: Array) -> Recording:
    """Gyroscope and accelerometer, which share a chip, in the magnetometer's axes."""
    import numpy as np

    rate, acceleration, notes = recording.angular_rate, recording.acceleration, recording.notes
    if acceleration is not None and np.linalg.det(axes) < 0:
        # A mirrored gyroscope has signs of its own: nothing tells the accelerometer's.
        acceleration = None
        notes = (*notes, "acceleration left out: --gyroscope-axes mirrors, which says nothing about it")
    return replace(
        recording,
        angular_rate=None if rate is None else rate @ axes.T,
        acceleration=None if acceleration is None else acceleration @ axes.T,
        notes=notes,
    )


def _restated(recording: Recording, angular_rate_is: Literal["instant", "interval-mean"]) -> Recording:
    """The same samples of the gyroscope with another meaning; rows in between are filled accordingly."""
    import numpy as np

    if recording.angular_rate is None:
        return recording
    time, rate = recording.gyroscope
    if angular_rate_is == "interval-mean":
        filled = rate[np.minimum(np.searchsorted(time, recording.time), len(time) - 1)]
    else:
        filled = np.stack([np.interp(recording.time, time, column) for column in rate.T], axis=1)
    return replace(recording, angular_rate=filled, angular_rate_is=angular_rate_is)
