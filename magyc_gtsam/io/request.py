"""What the caller of `read` asked for, checked once and passed to the reader of the format."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.units import factor

Selection = str | Sequence[str] | None
SENSORS = ("magnetic_field", "angular_rate", "acceleration")


@dataclass(frozen=True)
class Request:
    """Arguments of `magyc_gtsam.io.read`; see there.

    Args:
        sensors: {"magnetic_field" | "angular_rate" | "acceleration" | "attitude": topic, columns or message}.
        units: {"magnetic_field" | "angular_rate" | "acceleration": unit}, None where not named.
        channels: the extra channels to read; None for all that are found.
        options: what only some formats know.
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
            raise MagycError(f"stamps: {self.stamps!r} is neither 'header' nor 'log'")
        for quantity, unit in self.units.items():
            factor(quantity, unit)
        for name, value in (("start", self.start), ("end", self.end)):
            if value is not None and not (isinstance(value, int | float) and value == value):
                raise MagycError(f"{name}: {value!r} is no number of seconds")

    def named(self, sensor: str) -> str | None:
        """The one topic or message named for a sensor.

        Raises:
            MagycError: several names were given where the format takes one.
        """
        name = self.sensors.get(sensor)
        if name is not None and not isinstance(name, str):
            raise MagycError(f"{sensor}: {name!r}, one topic or message is expected; columns are for text files")
        return name

    def scale(self, sensor: str, native: float = 1.0) -> tuple[float, tuple[str, ...]]:
        """The factor to SI for a sensor, and the note that says so where the caller named the unit."""
        unit = self.units.get(sensor)
        if unit is None:
            return native, ()
        text = f"{sensor} was read in {unit}" if isinstance(unit, str) else f"{sensor} was multiplied by {unit:g}"
        return factor(sensor, unit), (f"{text}, as asked",)

    def only(self, file_format: str, *known: str) -> None:
        """Refuse options that the format has no use for.

        Raises:
            MagycError: an option that is not `known`.
        """
        wrong = sorted(set(self.options) - set(known))
        if wrong:
            offered = f"it takes {', '.join(known)}" if known else "it takes none of its own"
            raise MagycError(f"option {wrong[0]!r} means nothing to a {file_format} file; {offered}")

    def report(self, fraction: float) -> None:
        """Tell the caller's progress callback, if any."""
        if self.progress is not None:
            self.progress(min(max(fraction, 0.0), 1.0))
