"""Checks of units where a factor is made: a field in µT or a rate in degrees per second is rejected, never rescaled."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_finite


@dataclass(frozen=True)
class LargestValues:
    """The limits of plausible values in SI units.

    Attributes:
        field: T, strength of the world's field. The Earth's is 22 to 67 µT; the margin allows for a field beside
            steel.
        noise: T, standard deviation of a magnetometer sample: from a fluxgate to a phone beside its battery.
        model: T, standard deviations of a noise model, which may be wide so that its rows count little.
        reading: T, largest magnetometer reading; a hard iron of ten times the field stays far below it.
        rate: rad/s, twice the range of the fastest common gyroscopes (2000 deg/s).
        rate_noise: rad/s, standard deviation of a gyroscope sample.
        unit: T per unit of a key: from the picotesla of an observatory to graphs in SI.
        turn: rad, standard deviation of a mounting; from a quarter turn on it says nothing.
        delay: s, of the magnetometer; longer than any filter or radio link.
        gyroscope_step: s between two gyroscope samples; the slowest logs have several per second.
        delay_sigma: s, standard deviation of a delay that is a variable; a block lasts about as long.
        bias_walk: rad/s per √hour; it allows a gyroscope to change by 9 deg/s within a second.
        elapsed: s between two nodes, 32 years; below any present time stamp in s since 1970.
    """

    field: tuple[float, float] = (8e-6, 175e-6)
    noise: tuple[float, float] = (1e-9, 10e-6)
    model: tuple[float, float] = (1e-9, 1e-3)
    reading: float = 10e-3
    rate: float = 70.0
    rate_noise: float = 0.5
    unit: tuple[float, float] = (1e-12, 1.0)
    turn: float = math.pi / 2
    delay: float = 10.0
    gyroscope_step: float = 0.5
    delay_sigma: float = 1.0
    bias_walk: float = 10.0
    elapsed: float = 1e9


LIMITS = LargestValues()
_SCALES = {"µT": 1e-6, "nT": 1e-9, "gauss": 1e-4, "milligauss": 1e-7}
_MILLISECONDS = "likely unit: ms; give it in s"
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


def check_unit(field_unit: float, name: str = "field_unit") -> None:
    """Raise an error for a unit of a key that is not a number of T, or that no graph has."""
    low, high = LIMITS.unit
    if not (is_finite(field_unit) and low <= field_unit <= high):
        raise MagycError(
            f"{name} {field_unit!r:.40}; it must be a number between {low:g} and {high:g}, in T per unit of the key: "
            "1e-6 for a key in µT"
        )


def check_turn(name: str, sigma: float) -> None:
    """Raise an error for a standard deviation of a mounting, in rad, that is likely in degrees."""
    _check_largest(
        f"{name}: standard deviation", sigma, LIMITS.turn, "rad", "likely unit: degrees; give it in rad"
    )


def check_lag(name: str, delay: float) -> None:
    """Raise an error for a delay in s that is likely in ms."""
    _check_largest(f"{name}: delay", delay, LIMITS.delay, "s", _MILLISECONDS)


def check_late(name: str, delay: float, sigma: float) -> None:
    """Raise an error for a delay and its standard deviation, in s, that are likely in ms."""
    check_lag(name, delay)
    _check_largest(f"{name}: standard deviation", sigma, LIMITS.delay_sigma, "s", _MILLISECONDS)


def check_steps(name: str, time: Array) -> None:
    """Raise an error for ascending stamps (n,) of a gyroscope, in s, that are likely in another unit."""
    step = float(np.diff(time).min()) if len(time) > 1 else 0.0
    if step > LIMITS.gyroscope_step:
        raise MagycError(
            f"{name}: the closest gyroscope samples are {step:.4g} s apart; it must be at most "
            f"{LIMITS.gyroscope_step:g} s; likely unit: ms, µs or ns; give all stamps in s"
        )


def check_model(name: str, sigmas: Array) -> None:
    """Raise an error for standard deviations (n,) of a noise model, in T, that are likely in another unit than its
    own; 0 stands for a row that holds exactly.
    """
    low, high = LIMITS.model
    wrong = sigmas[(sigmas != 0) & ~((sigmas >= low * (1 - _ROUNDING)) & (sigmas <= high * (1 + _ROUNDING)))]
    if len(wrong):
        raise MagycError(
            f"{name}: a noise model of {wrong[0]:.4g} T; it must be between 1 nT and 1 mT; a model is in "
            "`field_unit`, which is µT by default: divide its standard deviations in T by `field_unit`"
        )


def check_bias_walk(name: str, sigma: Array) -> None:
    """Raise an error for changes of a gyroscope's bias, in rad/s per √hour, that are likely in degrees."""
    remedy = "likely unit: deg/s or deg/h; give it in rad/s per √hour"
    _check_largest(name, float(sigma.max()), LIMITS.bias_walk, "rad/s per √hour", remedy)


def check_elapsed(name: str, elapsed: float) -> None:
    """Raise an error for a time between two nodes, in s, that is likely in another unit or a time stamp."""
    remedy = "32 years; likely in ns, µs or ms, or a time stamp: give the time between the two nodes in s"
    _check_largest(name, elapsed, LIMITS.elapsed, "s", remedy)


def _check_largest(name: str, value: float, limit: float, unit: str, remedy: str) -> None:
    if abs(value) > limit * (1 + _ROUNDING):
        raise MagycError(f"{name} of {value:.4g} {unit}; it must be at most {limit:.4g} {unit}; {remedy}")


def _shown(value: object) -> str:
    """Return a number with four digits, and anything else as Python writes it."""
    return f"{value:.4g}" if is_finite(value) else f"{value!r:.40}"


def _likely(value: float, low: float, high: float) -> str:
    """Return a note on the units in which the value would be inside the limits; empty where there is none."""
    units = [unit for unit, scale in _SCALES.items() if is_finite(value) and low <= value * scale <= high]
    return f"; likely unit: {' or '.join(units)}" if units else ""
