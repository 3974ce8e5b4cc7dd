"""The Earth's magnetic field by the World Magnetic Model."""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_finite
from magyc_gtsam.recording import Array

_YEARS = (2010, 2030)  # the first year of the first model, and the year after the last model
# m. The model is specified from 1 km below the ellipsoid to 850 km; the lower limit here includes ocean trenches.
_ALTITUDES = (-10e3, 850e3)
_NANOTESLA = 1e-9


@dataclass(frozen=True, eq=False)
class WorldField:
    """The field of the World Magnetic Model at one place and time.

    Attributes:
        strength: T.
        declination: rad, direction of the horizontal field from true north, east positive.
        inclination: rad, angle of the field below the horizontal.
        vector: (3,) T, north, east, down.
    """

    strength: float
    declination: float
    inclination: float
    vector: Array


def world_magnetic_field(
    latitude: float, longitude: float, date: datetime.date | str, altitude: float = 0.0
) -> WorldField:
    """Return the Earth's main field, which does not include iron, buildings and rocks nearby.

    Args:
        latitude, longitude: degrees, north and east positive.
        date: a day, or its text "YYYY-MM-DD".
        altitude: m above the WGS 84 ellipsoid; above sea level is as good here.

    Raises:
        MagycError: a coordinate is out of range, or no model covers the date.
    """
    from pygeomag import GeoMag, calculate_decimal_year

    for name, value, low, high in (
        ("latitude", latitude, -90.0, 90.0),
        ("longitude", longitude, -180.0, 360.0),
        ("altitude", altitude, *_ALTITUDES),
    ):
        if not is_finite(value) or not low <= value <= high:
            raise MagycError(f"{name}: must be a number between {low:g} and {high:g}, got {value!r:.40}")
    day = _day(date)
    if not _YEARS[0] <= day.year < _YEARS[1]:
        raise MagycError(
            f"date: {day} is outside the World Magnetic Models, which cover {_YEARS[0]}-01-01 to "
            f"{_YEARS[1] - 1}-12-31; give the field strength itself"
        )
    model = GeoMag(base_year=day)
    field = model.calculate(latitude, longitude, altitude / 1e3, calculate_decimal_year(day))
    return WorldField(
        strength=field.f * _NANOTESLA,
        declination=math.radians(field.d),
        inclination=math.radians(field.i),
        vector=np.array([field.x, field.y, field.z]) * _NANOTESLA,
    )


def _day(date: datetime.date | str) -> datetime.date:
    if isinstance(date, datetime.datetime):
        return date.date()
    if isinstance(date, datetime.date):
        return date
    try:
        return datetime.date.fromisoformat(date)
    except (TypeError, ValueError):
        raise MagycError(f"date: {date!r:.40} is not a day; write it as 'YYYY-MM-DD'") from None
