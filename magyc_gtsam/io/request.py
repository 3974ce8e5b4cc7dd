"""The arguments of `read`, checked once and passed to the reader of the format."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.units import factor
from magyc_gtsam.recording.checks import check_interval
from magyc_gtsam.recording.expected import expect_progress

Selection = str | Sequence[str] | None
SENSORS = ("magnetic_field", "angular_rate", "acceleration")


@dataclass(frozen=True)
class Request:
    """The arguments of `magyc_gtsam.io.read`, which documents those that are not listed here.

    Attributes:
        sensors: {"magnetic_field" | "angular_rate" | "acceleration" | "attitude": topic, columns or message}.
        units: {"magnetic_field" | "angular_rate" | "acceleration": unit}; None if not given.
        channels: extra channels to read; None for all.
        options: options of single formats.
    """

    sensors: Mapping[str, Selection] = field(default_factory=dict)
    units: Mapping[str, str | float | None] = field(default_factory=dict)
    start: float | None = None
    end: float | None = None
    stamps: Literal["header", "log"] = "header"
    channels: Sequence[str] | None = None
    progress: Callable[[float], None] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.stamps not in ("header", "log"):
            raise MagycError(f"stamps: must be 'header' or 'log', got {self.stamps!r}")
        for quantity, unit in self.units.items():
            factor(quantity, unit)
        check_interval(self.start, self.end)
        expect_progress(self.progress)
        if self.channels is not None and not (
            isinstance(self.channels, Collection) and all(isinstance(name, str) for name in self.channels)
        ):
            raise MagycError(f"channels: a list of names is needed, got {self.channels!r:.60}")

    def named(self, sensor: str) -> str | None:
        """Return the topic or message that is named for a sensor; None if none is.

        Raises:
            MagycError: several names are given, but the format takes one.
        """
        name = self.sensors.get(sensor)
        if name is not None and not isinstance(name, str):
            raise MagycError(f"{sensor}: expected one topic or message, got {name!r}; columns are for text files")
        return name

    def scale(self, sensor: str, native: float = 1.0, notes: list[str] | None = None) -> float:
        """Return the factor to SI units for a sensor.

        Args:
            sensor: the quantity.
            native: the factor if the caller named no unit.
            notes: receives a note if the caller named the unit.
        """
        unit = self.units.get(sensor)
        if unit is None:
            return native
        text = f"{sensor} was read in {unit}" if isinstance(unit, str) else f"{sensor} was multiplied by {unit:g}"
        if notes is not None:
            notes.append(f"{text}, as requested")
        return factor(sensor, unit)

    def only(self, file_format: str, *known: str, clock: str = "") -> None:
        """Check that the format knows all `options`, and the stamps asked for.

        Args:
            file_format: its name.
            known: its options.
            clock: the only clock of its logs, for the message; "" if the stamps can be chosen.

        Raises:
            MagycError: it does not.
        """
        if clock and self.stamps == "log":
            raise MagycError(f"stamps='log': a {file_format} log has only {clock}; leave the option out")
        wrong = sorted(set(self.options) - set(known))
        if wrong:
            offered = f"it has {', '.join(known)}" if known else "it has no options"
            raise MagycError(f"option {wrong[0]!r} does not apply to a {file_format} file; {offered}")

    def report(self, fraction: float) -> None:
        """Call the progress callback, if any, with the fraction clipped to 0 to 1."""
        if self.progress is not None:
            self.progress(min(max(fraction, 0.0), 1.0))
