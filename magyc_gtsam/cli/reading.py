"""The options that read a log into a `Recording`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from magyc_gtsam.cli import options as given

if TYPE_CHECKING:
    from magyc_gtsam.recording import Recording

_EXPONENT = re.compile(r"^[+-]?(?:\d+\.?\d*|\.\d+)[eE][+-]?\d+$")
# Numbers of YAML 1.2, in which 1e-9, without a decimal point, is a number.
_YAML_1_2 = {"tag:yaml.org,2002:float": (_EXPONENT, list("+-.0123456789"))}


@dataclass(frozen=True)
class Reading:
    """The log and the options for reading it, of every command that has a LOG."""

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
            counts: whether a field in raw counts is accepted.

        Raises:
            MagycError: see `magyc_gtsam.read`; also for invalid axes or options.
        """
        from magyc_gtsam import read

        self.check(counts=counts)
        recording: Recording = read(self.log, **self.arguments(), progress=progress)
        return recording if self.angular_rate_is is None else _restated(recording, self.angular_rate_is)

    def check(self, *, counts: bool = False) -> None:
        """Check the options without the log.

        Args:
            counts: whether a field in raw counts is accepted.

        Raises:
            MagycError: one of them would be refused with any log.
        """
        from magyc_gtsam.factors.errors import MagycError
        from magyc_gtsam.io import check_arguments
        from magyc_gtsam.io.units import is_counts

        check_arguments(**self.arguments())
        if is_counts("magnetic_field", parse_unit(self.magnetic_unit)) and not counts:
            raise MagycError(
                "--magnetic-unit counts: a calibration needs the field in tesla; give the tesla per count, or run "
                "magyc-gtsam compare, which accepts counts"
            )

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `magyc_gtsam.read`.

        Raises:
            MagycError: the interval or an option is invalid.
        """
        from magyc_gtsam.factors.errors import MagycError

        arguments = asdict(self)
        for name in ("log", "angular_rate_is", "read"):  # not arguments of `read`
            del arguments[name]
        for unit in ("magnetic_unit", "angular_unit", "acceleration_unit"):
            arguments[unit] = parse_unit(arguments[unit])
        if self.start is not None and self.end is not None and not self.start < self.end:
            raise MagycError(f"--start must be before --end, got {self.start:g} s and {self.end:g} s")
        return arguments | parse_pairs("--read", self.read)

    def to_dict(self) -> dict[str, Any]:
        """Return the log and the options that differ from the defaults, as JSON types."""
        changed = {k: v for k, v in asdict(self).items() if v != getattr(Reading, k, None)}
        return changed | {"log": str(self.log)}


def parse_pairs(option: str, pairs: Sequence[str] | None) -> dict[str, Any]:
    """Return {key: value} of texts "key=value", with values in YAML, such as 3, true and [1, 2].

    Raises:
        MagycError: a text has another form, or its value is not YAML.
    """
    if not pairs:
        return {}
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.storage.mapping import parse_yaml

    result = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.strip():
            raise MagycError(f"{option}: expected key=value, got {pair!r}")
        try:
            result[key.strip().replace("-", "_")] = parse_yaml(value, _YAML_1_2)
        except MagycError:
            raise MagycError(f"{option}: the value of {pair!r} cannot be read") from None
    return result


def parse_unit(text: str | None) -> str | float | None:
    """Return a unit as its name, or as a number if it is one."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return text


def _restated(recording: Recording, angular_rate_is: Literal["instant", "interval-mean"]) -> Recording:
    """Return the recording with another interpretation of the angular rate, and its filled rows to match."""
    import numpy as np

    from magyc_gtsam.recording.time_base import interpolated

    if recording.angular_rate is None:
        return recording
    time, rate = recording.gyroscope
    if angular_rate_is == "interval-mean":
        filled = rate[np.minimum(np.searchsorted(time, recording.time), len(time) - 1)]
    else:
        filled = interpolated(recording.time, time, rate)
    return replace(recording, angular_rate=filled, angular_rate_is=angular_rate_is)
