"""The World Magnetic Model against its published test values, and the limits of its arguments."""

from __future__ import annotations

from datetime import date, datetime
from typing import Any

import numpy as np
import pytest

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.world_field import world_magnetic_field

# Test values of the WMM reports: day, altitude km, latitude, longitude; X, Y, Z in nT; D, I in degrees.
# The reports' half years are a thousandth of a year from the day, 0.1 nT of secular variation.
PUBLISHED = [
    ("2010-01-01", 0, 80, 0, 6649.5, -714.6, 54346.2, -6.13, 82.98),
    ("2012-07-02", 100, 0, 120, 37448.1, 559.7, -11044.2, 0.86, -16.43),
    ("2015-01-01", 0, 80, 0, 6636.6, -451.9, 54408.9, -3.90, 83.03),
    ("2015-01-01", 100, -80, 240, 5612.2, 14789.3, -50385.8, 69.22, -72.57),
    ("2017-07-02", 0, 0, 120, 39569.4, 252.3, -11067.9, 0.37, -15.63),
    ("2020-01-01", 0, 80, 0, 6570.4, -146.3, 54606.0, -1.28, 83.14),
    ("2020-01-01", 100, -80, -120, 5744.9, 14799.5, -49969.4, 68.78, -72.37),
    ("2022-07-02", 0, 0, 120, 39684.7, -42.2, -10809.5, -0.06, -15.24),
    ("2027-07-02", 100, -80, 240, 5984.0, 14760.1, -49317.7, 67.93, -72.10),
]


@pytest.mark.parametrize(("day", "altitude", "latitude", "longitude", "x", "y", "z", "d", "i"), PUBLISHED)
def test_published_values(
    day: str,
    altitude: float,
    latitude: float,
    longitude: float,
    x: float,
    y: float,
    z: float,
    d: float,
    i: float,
) -> None:
    field = world_magnetic_field(latitude, longitude, day, altitude * 1e3)
    np.testing.assert_allclose(field.vector * 1e9, [x, y, z], rtol=0, atol=0.25)
    assert field.strength * 1e9 == pytest.approx(np.linalg.norm([x, y, z]), abs=0.25)
    assert np.degrees(field.declination) == pytest.approx(d, abs=0.01)
    assert np.degrees(field.inclination) == pytest.approx(i, abs=0.01)


def test_a_day_may_be_a_date_or_its_text() -> None:
    fields = [
        world_magnetic_field(52.5, 13.4, day).vector
        for day in ("2021-05-03", date(2021, 5, 3), datetime(2021, 5, 3, 17, 0))
    ]
    assert np.array_equal(fields[0], fields[1])
    assert np.array_equal(fields[0], fields[2])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((91, 0, "2021-05-03"), "latitude: must be .* got 91"),
        ((0, 400, "2021-05-03"), "longitude: must be .* got 400"),
        ((0, 0, "2021-05-03", 1e6), "altitude"),
        ((float("nan"), 0, "2021-05-03"), "latitude"),
        ((0, 0, "2009-12-31"), "2010-01-01 to 2029-12-31"),
        ((0, 0, "2030-01-01"), "2010-01-01 to 2029-12-31"),
        ((0, 0, "3 May 2021"), "YYYY-MM-DD"),
        ((0, 0, None), "date: None is not a day"),
        ((0, 0, 2026.2), "date: 2026.2 is not a day"),
        (("a", 0, "2021-05-03"), "latitude: must be a number between -90 and 90, got 'a'"),
        ((0, [1, 2], "2021-05-03"), r"longitude: must be a number .* got \[1, 2\]"),
    ],
)
def test_what_is_refused(arguments: tuple[Any, Any, Any], says: str) -> None:
    with pytest.raises(MagycError, match=says):
        world_magnetic_field(*arguments)
