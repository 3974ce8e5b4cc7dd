"""The units in which instruments and drivers publish, and their factors to SI."""

from __future__ import annotations

import math

from magyc_gtsam.factors.errors import MagycError

COUNTS = "counts"  # unit of a magnetometer whose scale is unknown
_STANDARD_GRAVITY = 9.80665  # m/s², 1 g in data sheets

# Spellings in lower case; no two units of one quantity differ only in case.
_UNITS: dict[str, dict[str, float]] = {
    "magnetic_field": {
        **dict.fromkeys(("t", "tesla"), 1.0),
        **dict.fromkeys(("mt", "millitesla"), 1e-3),
        **dict.fromkeys(("ut", "µt", "μt", "microtesla"), 1e-6),
        **dict.fromkeys(("nt", "nanotesla"), 1e-9),
        **dict.fromkeys(("g", "ga", "gs", "gauss"), 1e-4),
        **dict.fromkeys(("mg", "mga", "mgs", "mgauss", "milligauss"), 1e-7),
    },
    "angular_rate": {
        **dict.fromkeys(("rad/s", "rad_s", "rads", "rps", "radps", "rad_per_s", "rad/sec"), 1.0),
        **dict.fromkeys(("mrad/s", "mrad_s", "mradps"), 1e-3),
        **dict.fromkeys(("deg/s", "deg_s", "dps", "°/s", "degps", "deg_per_s", "deg/sec"), math.pi / 180),
        **dict.fromkeys(("mdps", "mdeg/s", "mdeg_s"), math.pi / 180_000),
    },
    "acceleration": {
        **dict.fromkeys(("m/s^2", "m/s²", "m/s2", "m_s2", "mps2", "m/s/s", "m_s_2"), 1.0),
        **dict.fromkeys(("g", "g0"), _STANDARD_GRAVITY),
        **dict.fromkeys(("mg", "milli-g"), _STANDARD_GRAVITY * 1e-3),
    },
    "time": {
        **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1e9),
        **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e6),
        **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microseconds"), 1e3),
        **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), 1.0),
    },
}
_SHOWN = {
    "magnetic_field": "T, mT, uT, nT, gauss, mgauss, counts",
    "angular_rate": "rad/s, deg/s, mrad/s",
    "acceleration": "m/s^2, g, mg",
    "time": "s, ms, us, ns",
}


def factor(quantity: str, unit: str | float | None) -> float:
    """Return the factor from a unit to SI (nanoseconds for "time"); None is SI, and a number is the factor itself.

    Counts of a magnetometer have the factor 1: see `Recording.magnetic_field_unit`.

    Raises:
        MagycError: the unit is unknown.
    """
    if unit is None:
        return 1.0
    if not isinstance(unit, str):
        if isinstance(unit, bool) or not isinstance(unit, int | float) or not 0 < unit < math.inf:
            raise MagycError(f"unit of {quantity}: {unit!r} is not a positive factor to SI units")
        return float(unit)
    if is_counts(quantity, unit):
        return 1.0
    known = lookup(quantity, unit)
    if known is None:
        argument = f"{quantity.partition('_')[0]}_unit="
        raise MagycError(f"unit of {quantity}: {unit!r} is unknown; there are {_SHOWN[quantity]} ({argument})")
    return known


def lookup(quantity: str, unit: str) -> float | None:
    """Return the factor from a unit to SI; None if the unit is unknown."""
    return _UNITS[quantity].get(unit.strip().lower())


def is_counts(quantity: str, unit: str | float | None) -> bool:
    """Return whether a unit stands for raw counts of a magnetometer."""
    return quantity == "magnetic_field" and isinstance(unit, str) and unit.strip().lower() == COUNTS
