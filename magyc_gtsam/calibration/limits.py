"""Check the contents of a calibration file: types, shapes and physically possible ranges."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording.checks import FIELD_RANGE, Array
from magyc_gtsam.storage.mapping import numbers

_LARGEST_RATE = 70.0  # rad/s, twice the range of the fastest common gyroscopes
_LONGEST_DELAY = 60.0  # s
_LARGEST_CONDITION_NUMBER = 1e6  # largest condition number of the soft iron
_SCALE_RANGE = (1e-3, 1e3)  # geometric mean of the soft iron's singular values
_PLAUSIBLE_FIELD = (8e-6, 175e-6)  # T, of a calibrated field: the Earth's, with a factor 2.5 for the scale
_ASYMMETRY = 1e-6  # largest asymmetry of a covariance, relative to its largest element


def check(data: Mapping[str, Any]) -> None:
    """Check the values of a calibration file before a `Calibration` is built from them.

    Args:
        data: the mapping that `Calibration.to_dict` returns.

    Raises:
        MagycError: a value has the wrong type or shape, or lies outside the physically possible range.
    """
    in_counts = isinstance(data.get("configuration"), Mapping) and (
        data["configuration"].get("magnetic_field_unit") == "counts"
    )
    field_limit = math.inf if in_counts else FIELD_RANGE
    limits = {"soft_iron": (math.inf, ""), "hard_iron": (field_limit, "T"), "gyro_bias": (_LARGEST_RATE, "rad/s")}
    for name, (limit, unit) in limits.items():
        if data.get(name) is None:
            continue
        value = numbers(name, data[name])
        if not np.isfinite(value).all() or np.abs(value).max(initial=0.0) > limit:
            raise MagycError(f"{name} must be finite and at most {limit:g} {unit}, got {value.tolist()}")
        if name == "soft_iron" and value.shape != (3, 3):
            raise MagycError(f"soft_iron must be (3, 3) finite numbers, got {value.tolist()}")
    _check_soft_iron(numbers("soft_iron", data["soft_iron"]), in_counts)
    if data.get("covariance") is not None:
        covariance = numbers("covariance", data["covariance"])
        square = covariance.ndim == 2 and covariance.shape[0] == covariance.shape[1]
        scale = np.abs(covariance).max(initial=0.0)
        if not square or not (np.abs(covariance - covariance.T) <= _ASYMMETRY * scale).all():
            raise MagycError("covariance must be a symmetric matrix")
        if (np.diag(covariance) < 0).any():
            raise MagycError("covariance has negative variances on its diagonal")
    for name, low, high, optional in (
        ("delay", -_LONGEST_DELAY, _LONGEST_DELAY, False),
        ("delay_sigma", 0.0, math.inf, True),
        ("field_strength", 0.0, field_limit, True),
    ):
        if name in data and not (optional and data[name] is None):
            _check_number(name, data[name], low, high)
    for name, kind in (("converged", bool), ("message", str), ("method", str)):
        if name in data and not isinstance(data[name], kind):
            raise MagycError(f"{name} must be {'true or false' if kind is bool else 'text'}, got {data[name]!r}")
    noise = data.get("noise") or {}
    if not isinstance(noise, Mapping):
        raise MagycError(f"noise must be names with numbers, got {noise!r}")
    for sensor, value in noise.items():
        _check_number(f"noise of {sensor}", value, 0.0, math.inf)
    for term in data.get("terms") or ():
        if not isinstance(term, Mapping):
            raise MagycError(f"terms must be mappings, got {term!r}")
        for name in ("value", "covariance"):
            if term.get(name) is not None and not np.isfinite(numbers(f"{name} of a term", term[name])).all():
                raise MagycError(f"{name} of a term must be finite, got {term[name]}")


def warn_if_implausible(field: Array) -> None:
    """Warn the caller's caller if the median strength of a calibrated field (N, 3) or (3,) T is not the Earth's."""
    strength = np.linalg.norm(np.atleast_2d(field), axis=1)
    median = float(np.median(strength)) if len(strength) else np.nan
    low, high = _PLAUSIBLE_FIELD
    if np.isfinite(median) and not low <= median <= high:
        warnings.warn(
            f"apply: the calibrated field has a median strength of {median * 1e6:.3g} µT, outside "
            f"{low * 1e6:g} to {high * 1e6:g} µT; "
            "check that the input is in tesla, raw, and from the instrument that was calibrated",
            stacklevel=3,
        )


def _check_soft_iron(value: Array, in_counts: bool) -> None:
    singular_values = np.linalg.svd(value, compute_uv=False)
    if not singular_values[2] * _LARGEST_CONDITION_NUMBER > singular_values[0]:
        raise MagycError(f"soft_iron is singular or nearly so: its singular values are {singular_values.tolist()}")
    scale = float(np.prod(singular_values)) ** (1 / 3)
    low, high = _SCALE_RANGE
    if not in_counts and not low <= scale <= high:
        raise MagycError(f"soft_iron must scale the field by {low:g} to {high:g}, got {scale:g}")


def _check_number(name: str, value: Any, low: float, high: float) -> None:
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not low <= value <= high
        or value == math.inf
    ):
        raise MagycError(f"{name} must be a number from {low:g} to {high:g}, got {value!r}")
