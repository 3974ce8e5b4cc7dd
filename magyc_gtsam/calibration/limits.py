"""Check the values of a calibration: their types, shapes and physically possible ranges."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from magyc_gtsam.factors.chain.small import singular_vectors
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_finite, numbers
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.observability import Observability
from magyc_gtsam.recording.checks import FIELD_RANGE, Array

_LARGEST_RATE = 70.0  # rad/s, twice the range of the fastest common gyroscopes
_LONGEST_DELAY = 60.0  # s
_LARGEST_CONDITION_NUMBER = 1e6  # largest condition number of the soft iron
_SCALE_RANGE = (1e-3, 1e3)  # geometric mean of the soft iron's singular values
PLAUSIBLE_FIELD = (8e-6, 175e-6)  # T, of a calibrated field: the Earth's, with a factor 2.5 for the scale
_ASYMMETRY = 1e-6  # largest asymmetry of a covariance, relative to its largest element
_KINDS = {
    "converged": (bool | np.bool_, "true or false"),
    "message": (str, "text"),
    "method": (str, "text"),
    "terms": (tuple, "a tuple of Term"),
    "observability": (Observability | None, "an Observability"),
    "noise": (Mapping, "a mapping of names to numbers"),
    "diagnostics": (Mapping, "a mapping of names to values"),
    "configuration": (Mapping, "a mapping of names to values"),
}


def checked(calibration: Any) -> dict[str, Array]:
    """Return the arrays of a calibration that is being built, read-only and float64, by name.

    What no instrument can have is refused only where the result would be trusted: one that is not trusted is only
    shown, and never exported or applied.

    Args:
        calibration: a `Calibration`, which calls this before its arrays are converted.

    Raises:
        MagycError: a value has the wrong type or shape, or lies outside the physically possible range.
    """
    for name, (kind, words) in _KINDS.items():
        value = getattr(calibration, name)
        if not isinstance(value, kind):
            raise MagycError(f"{name} must be {words}, got {shortened(value)!r}")
    square = (9, 9) if calibration.gyro_bias is None else (12, 12)
    shapes = {"soft_iron": (3, 3), "hard_iron": (3,), "gyro_bias": (3,)}
    shapes |= {"covariance": square, "noise_covariance": square}
    arrays = {}
    for name, shape in shapes.items():
        value = getattr(calibration, name)
        if value is None and name not in ("soft_iron", "hard_iron"):
            continue
        array = numbers(name, value)
        if array.shape != shape or not np.isfinite(array).all():
            raise MagycError(f"{name} must be {shape} finite numbers, got {shortened(array.tolist())}")
        if shape == square:
            _check_covariance(name, array)
        array.flags.writeable = False
        arrays[name] = array
    singular_values = singular_vectors(arrays["soft_iron"])[0]
    if not singular_values[2] * _LARGEST_CONDITION_NUMBER > singular_values[0]:
        raise MagycError(
            f"soft_iron is singular or nearly so, and cannot be applied: its singular values are "
            f"{singular_values.tolist()}"
        )
    _check_number("delay", calibration.delay, -math.inf)
    for name in ("delay_sigma", "field_strength"):
        if getattr(calibration, name) is not None:
            _check_number(name, getattr(calibration, name), 0.0)
    for sensor, value in calibration.noise.items():
        _check_number(f"noise of {sensor}", value, 0.0)
    if not all(isinstance(term, Term) for term in calibration.terms):
        raise MagycError(f"terms must be a tuple of Term, got {shortened(calibration.terms)!r}")
    if calibration.trusted:
        _check_possible(calibration, arrays, float(np.cbrt(np.prod(singular_values))))
    return arrays


def warn_if_implausible(field: Array) -> None:
    """Warn the caller's caller if the median strength of a calibrated field (N, 3) or (3,) T is not the Earth's."""
    strength = np.linalg.norm(np.atleast_2d(field), axis=1)
    median = float(np.median(strength)) if len(strength) else np.nan
    low, high = PLAUSIBLE_FIELD
    if np.isfinite(median) and not low <= median <= high:
        warnings.warn(
            f"apply: the calibrated field has a median strength of {median * 1e6:.3g} µT, outside "
            f"{low * 1e6:g} to {high * 1e6:g} µT; "
            "check that the input is in tesla, raw, and from the instrument that was calibrated",
            stacklevel=3,
        )


def _check_covariance(name: str, covariance: Array) -> None:
    if np.abs(covariance - covariance.T).max() > _ASYMMETRY * np.abs(covariance).max():
        raise MagycError(f"{name} must be a symmetric matrix")
    if (np.diag(covariance) < 0).any():
        raise MagycError(f"{name} has negative variances on its diagonal")


def _check_possible(calibration: Any, arrays: Mapping[str, Array], scale: float) -> None:
    """Raise a MagycError if no instrument has the values of a calibration whose soft iron has a mean `scale`."""
    limits = {"gyro_bias": (_LARGEST_RATE, "rad/s"), "delay": (_LONGEST_DELAY, "s")}
    if calibration.magnetic_field_unit == "T":
        limits |= {"hard_iron": (FIELD_RANGE, "T"), "field_strength": (FIELD_RANGE, "T")}
        low, high = _SCALE_RANGE
        if not low <= scale <= high:
            raise MagycError(f"soft_iron must scale the field by {low:g} to {high:g}, got {scale:g}")
    for name, (limit, unit) in limits.items():
        value = getattr(calibration, name)
        largest = np.abs(arrays[name]).max() if name in arrays else abs(value or 0.0)
        if largest > limit:
            raise MagycError(f"{name} must be at most {limit:g} {unit}, got {np.asarray(value).tolist()}")


def _check_number(name: str, value: Any, low: float) -> None:
    if not is_finite(value) or value < low:
        least = "" if low == -math.inf else f" of at least {low:g}"
        raise MagycError(f"{name} must be a finite number{least}, got {shortened(value)!r}")
