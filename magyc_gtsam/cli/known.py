"""Options for prior knowledge: field strength or location, the chips, an earlier calibration, and heading."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.ranges import MICRO, PERCENT, in_si

if TYPE_CHECKING:
    from magyc_gtsam.world_field import WorldField


def tesla_of(field_strength: float) -> float:
    """Return the field strength of an option, µT, in T.

    Raises:
        MagycError: it is not that of the Earth's field.
    """
    from magyc_gtsam.calibration.limits import PLAUSIBLE_FIELD
    from magyc_gtsam.factors.errors import MagycError

    low, high = (limit * 1e6 for limit in PLAUSIBLE_FIELD)
    if low <= field_strength <= high:
        return field_strength * 1e-6
    likely = field_strength * 1e6
    remedy = f"; is that tesla? give {likely:g}" if low <= likely <= high else ""
    raise MagycError(
        f"--field-strength: must be that of the Earth, 20 to 70 µT ({low:g} to {high:g} µT is accepted), got "
        f"{field_strength:g} µT{remedy}"
    )


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
            help="Position in degrees; with --date the World Magnetic Model gives the field: its strength, and where "
            "the command uses them its dip and declination.",
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
            return tesla_of(self.field_strength)
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


@dataclass(frozen=True)
class GivenFacts:
    """Prior knowledge for the smoother."""

    misalignment: given.Misalignment = None
    gyroscope_scale: given.GyroscopeScale = None
    prior: given.Prior = None
    hard_iron_walk: given.HardIronWalk = None
    soft_iron_walk: Annotated[
        float | None,
        typer.Option(metavar="PERCENT", help="Possible change (1σ) of the soft iron since --prior. Default: 0."),
    ] = None

    heading: Annotated[
        str | None,
        typer.Option(
            metavar="CHANNEL",
            help="Channel of the log with the true heading of the sensor's x axis in degrees, as from two GNSS "
            "antennas. It helps to find a rotation between the chips about the vertical. Needs an accelerometer, "
            "--location and --date.",
        ),
    ] = None
    heading_sigma: Annotated[
        float | None,
        typer.Option(metavar="DEGREES", help="What --heading may be off by all the time (1σ). Default: 1."),
    ] = None

    def options(self, scale: Scale, method: str) -> dict[str, Any]:
        """Return the arguments of `magyc_gtsam.calibrate` for the options that were given.

        Raises:
            MagycError: a value is not a number, a file is not a calibration, or options contradict each other.
        """
        from magyc_gtsam.estimators.smoother.options import HEADING_SIGMA, MOST_SOFT_IRON_WALK
        from magyc_gtsam.factors.errors import MagycError

        result: dict[str, Any] = {}
        place = scale.place() if method == "smoother" else None
        if place is not None:
            result["field"] = place
        else:
            result["field_strength"] = scale.tesla()
        result |= beforehand(self.misalignment, self.prior, self.hard_iron_walk)
        if self.gyroscope_scale is not None:
            result["gyroscope_scale"] = scale_sigma(self.gyroscope_scale)
        if self.heading is not None:
            sigma = HEADING_SIGMA
            if self.heading_sigma is not None:
                sigma = in_si(
                    "--heading-sigma:", self.heading_sigma, "degrees", math.radians(1), math.pi, zero=False
                )
            result["heading"] = [self.heading, sigma]
            result["declination"] = scale.declination()
        elif self.heading_sigma is not None:
            raise MagycError("--heading-sigma: has no effect without --heading CHANNEL")
        if self.soft_iron_walk is not None:
            result["soft_iron_walk"] = in_si(
                "--soft-iron-walk:", self.soft_iron_walk, "%", PERCENT, MOST_SOFT_IRON_WALK
            )
        return result


def scale_sigma(percent: float) -> float:
    """Return the prior standard deviation of the gyroscope's scale, which --gyroscope-scale gives in percent.

    Raises:
        MagycError: it is negative or too large.
    """
    from magyc_gtsam.estimators.smoother.options import MOST_SCALE

    return in_si("--gyroscope-scale:", percent, "%", PERCENT, MOST_SCALE)


def beforehand(misalignment: str | None, prior: Path | None, hard_iron_walk: float | None) -> dict[str, Any]:
    """Return misalignment (degrees), prior and walk (µT) as arguments of the smoother, batch and online, in JSON types.

    Raises:
        MagycError: the misalignment or the walk is not such a number, or the prior is not a calibration.
    """
    from magyc_gtsam.estimators.smoother.options import MOST_HARD_IRON_WALK
    from magyc_gtsam.factors.errors import MagycError

    result: dict[str, Any] = {}
    if misalignment is not None:
        result["misalignment"] = misalignment
        if misalignment != "auto":
            try:
                degrees = float(misalignment)
            except ValueError:
                degrees = math.nan
            if not 0 <= degrees < 45:
                raise MagycError(
                    f"--misalignment: must be a number of degrees from 0 to 45, or 'auto', got {misalignment!r}"
                )
            result["misalignment"] = math.radians(degrees)
    if prior is not None:
        from magyc_gtsam.calibration import Calibration

        result["prior"] = Calibration.load(prior).to_dict()
    if hard_iron_walk is not None:
        result["hard_iron_walk"] = in_si("--hard-iron-walk:", hard_iron_walk, "µT", MICRO, MOST_HARD_IRON_WALK)
    return result
