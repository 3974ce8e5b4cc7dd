"""Numbers of options: checked in the unit of the option against the library's limits, and converted to SI units."""

from __future__ import annotations

PERCENT, MICRO, MILLI = 1e-2, 1e-6, 1e-3


def in_si(option: str, value: float, unit: str, scale: float, most: float, *, zero: bool = True) -> float:
    """Return the value of an option in SI units.

    Args:
        option: its name and a colon, with which the message begins.
        value: in its unit.
        unit: name of the unit.
        scale: SI units per unit.
        most: upper limit in SI units, itself not allowed.
        zero: whether 0 is allowed.

    Raises:
        MagycError: the value is negative, too large or not a number.
    """
    from magyc_gtsam.factors.errors import MagycError

    if 0 < value * scale < most or (zero and value == 0):
        return value * scale
    least = "0 or more" if zero else "above 0"
    raise MagycError(f"{option} must be {least} and below {most / scale:.10g} {unit}, got {value:.10g}")
