"""Options for the field strength, which sets the scale of the soft iron."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from magyc_gtsam.world_field import WorldField


@dataclass(frozen=True)
class Scale:
    """The true field strength, or location and date for the World Magnetic Model."""

    field_strength: Annotated[
        float | None,
        typer.Option(
            metavar="µT", help="True field strength; sets the scale of the soft iron. Default: det(soft iron) = 1."
        ),
    ] = None
    location: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="LAT LON",
            help="Position in degrees; with --date the World Magnetic Model gives the field strength.",
        ),
    ] = None
    altitude: Annotated[
        float | None,
        typer.Option(metavar="METRES", help="Altitude above sea level, with --location. Default: 0."),
    ] = None
    date: Annotated[
        str | None, typer.Option(metavar="YYYY-MM-DD", help="Date of the recording, with --location.")
    ] = None

    def tesla(self) -> float | None:
        """Return the field strength, T; None if no option gives it.

        Raises:
            MagycError: options contradict each other or are incomplete, or the strength is not that of a field.
        """
        from magyc_gtsam.factors.errors import MagycError

        if self.location is None:
            for name, value in (("--date", self.date), ("--altitude", self.altitude)):
                if value is not None:
                    raise MagycError(f"{name}: has no effect without a location; give --location LAT LON too")
            if self.field_strength is None:
                return None
            from magyc_gtsam.estimators.gauge import check_field_strength

            strength = self.field_strength * 1e-6
            check_field_strength(strength)
            return strength
        if self.field_strength is not None:
            raise MagycError(
                "--field-strength and --location: both set the strength of the field; give one of them"
            )
        if self.date is None:
            raise MagycError("--location: the field changes with time; give --date YYYY-MM-DD too")
        return self._world().strength

    def place(self) -> tuple[float, float] | None:
        """Return strength (T) and dip (rad) of the field at the location; None without a location.

        Raises:
            MagycError: see `tesla`.
        """
        if self.location is None or self.tesla() is None:
            return None
        field = self._world()
        return field.strength, field.inclination

    def declination(self) -> float:
        """Return the declination (rad) of the field at the location.

        Raises:
            MagycError: see `tesla`, or there is no location.
        """
        from magyc_gtsam.factors.errors import MagycError

        if self.place() is None:
            raise MagycError(
                "--heading: the compass points to magnetic north; give --location LAT LON and --date for the "
                "declination"
            )
        return self._world().declination

    def _world(self) -> WorldField:
        from magyc_gtsam.world_field import world_magnetic_field

        assert self.location is not None
        assert self.date is not None
        return world_magnetic_field(*self.location, self.date, self.altitude or 0.0)
