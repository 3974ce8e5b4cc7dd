"""Checks of units where a factor is made: a field in µT or a rate in degrees per second is rejected, never rescaled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_finite
from magyc_gtsam.factors.variables import Array


@dataclass(frozen=True)
class LargestReadings:
    """The limits of plausible values in SI units.

    Attributes:
        field: T, strength of the world's field. The Earth's is 22 to 67 µT; the margin allows for a field beside
            steel.
        noise: T, standard deviation of a magnetometer sample: from a fluxgate to a phone beside its battery.
        reading: T, largest magnetometer reading; a hard iron of ten times the field stays far below it.
        rate: rad/s, twice the range of the fastest common gyroscopes (2000 deg/s).
        rate_noise: rad/s, standard deviation of a gyroscope sample.
    """

    field: tuple[float, float] = (8e-6, 175e-6)
    noise: tuple[float, float] = (1e-9, 10e-6)
    reading: float = 10e-3
    rate: float = 70.0
    rate_noise: float = 0.5


LIMITS = LargestReadings()
_SCALES = {"µT": 1e-6, "nT": 1e-9, "gauss": 1e-4, "milligauss": 1e-7}
_ROUNDING = 1e-9  # relative margin, so that the limits themselves are allowed


def check_field(name: str, strength: float) -> None:
    """Raise an error for a field strength in T that does not occur on Earth."""
    low, high = LIMITS.field
    if not low * (1 - _ROUNDING) <= strength <= high * (1 + _ROUNDING):
        raise MagycError(
            f"{name}: a field of {strength:.4g} T; it must be between 8 and 175 µT"
            f"{_likely(strength, low, high)}; give it in T"
        )


def check_noise(name: str, sigma: float) -> None:
    """Raise an error for a standard deviation of a magnetometer sample, in T, that no magnetometer has."""
    low, high = LIMITS.noise
    if not (is_finite(sigma) and low * (1 - _ROUNDING) <= sigma <= high * (1 + _ROUNDING)):
        raise MagycError(
            f"{name}: noise of {_shown(sigma)} T; it must be a number between 1 nT and 10 µT"
            f"{_likely(sigma, low, high)}; give it in T"
        )


def check_readings(name: str, field: ArrayLike) -> None:
    """Raise an error for magnetometer readings (n, 3) or (3,) in T that are in another unit."""
    largest = float(np.abs(np.asarray(field)).max(initial=0.0))
    if largest > LIMITS.reading:
        raise MagycError(
            f"{name}: a field of {largest:.4g} T; it must be below 10 mT"
            f"{_likely(largest, *LIMITS.field)}; give it in T"
        )


def check_rates(name: str, rate: Array) -> None:
    """Raise an error for angular rates in rad/s that are in another unit."""
    largest = float(np.abs(rate).max(initial=0.0))
    if largest > LIMITS.rate:
        raise MagycError(
            f"{name}: an angular rate of {largest:.4g} rad/s; it must be below {LIMITS.rate:g}; likely unit: deg/s; "
            "give it in rad/s"
        )


def check_rate_noise(name: str, sigma: float) -> None:
    """Raise an error for a standard deviation of a gyroscope sample, in rad/s, that no gyroscope has."""
    if not (is_finite(sigma) and 0 <= sigma <= LIMITS.rate_noise):
        raise MagycError(
            f"{name}: gyroscope noise of {_shown(sigma)} rad/s; it must be a number between 0 and "
            f"{LIMITS.rate_noise:g}; give it in rad/s"
        )


def _shown(value: object) -> str:
    """Return a number with four digits, and anything else as Python writes it."""
    return f"{value:.4g}" if is_finite(value) else f"{value!r:.40}"


def _likely(value: float, low: float, high: float) -> str:
    """Return a note on the units in which the value would be inside the limits; empty where there is none."""
    units = [unit for unit, scale in _SCALES.items() if is_finite(value) and low <= value * scale <= high]
    return f"; likely unit: {' or '.join(units)}" if units else ""
