"""What a calibration file may hold: numbers of the right kind, within what instruments can have."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording.checks import FIELD_RANGE
from magyc_gtsam.storage.mapping import numbers

_LARGEST_RATE = 70.0  # rad/s, twice the range of the fastest common gyroscopes
_LONGEST_DELAY = 60.0  # s
_WORST_CONDITION = 1e6  # ratio of the soft iron's axes
_SCALE = (1e-3, 1e3)  # of the field, by the soft iron
_ASYMMETRY = 1e-6  # of a covariance, relative


def check(data: Mapping[str, Any]) -> None:
    """Refuse what no calibration can be.

    Args:
        data: as `Calibration.to_dict` gives it.

    Raises:
        MagycError: a value of another kind than its name says, or beyond what an instrument can have.
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
    _soft_iron(numbers("soft_iron", data["soft_iron"]), in_counts)
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
            _number(name, data[name], low, high)
    for name, kind in (("converged", bool), ("message", str), ("method", str)):
        if name in data and not isinstance(data[name], kind):
            raise MagycError(f"{name} must be {'true or false' if kind is bool else 'text'}, got {data[name]!r}")
    noise = data.get("noise") or {}
    if not isinstance(noise, Mapping):
        raise MagycError(f"noise must be names with numbers, got {noise!r}")
    for sensor, value in noise.items():
        _number(f"noise of {sensor}", value, 0.0, math.inf)
    for term in data.get("terms") or ():
        if not isinstance(term, Mapping):
            raise MagycError(f"terms must be mappings, got {term!r}")
        for name in ("value", "covariance"):
            if term.get(name) is not None and not np.isfinite(numbers(f"{name} of a term", term[name])).all():
                raise MagycError(f"{name} of a term must be finite, got {term[name]}")


def _soft_iron(value: np.ndarray[Any, np.dtype[np.float64]], in_counts: bool) -> None:
    stretch = np.linalg.svd(value, compute_uv=False)
    if not stretch[2] * _WORST_CONDITION > stretch[0]:
        raise MagycError(f"soft_iron is singular, or nearly so: it stretches by {stretch.tolist()}")
    scale = float(np.prod(stretch)) ** (1 / 3)
    if not in_counts and not _SCALE[0] <= scale <= _SCALE[1]:
        raise MagycError(f"soft_iron scales the field by {scale:g}, {_SCALE[0]:g} to {_SCALE[1]:g} is accepted")


def _number(name: str, value: Any, low: float, high: float) -> None:
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not low <= value <= high
        or value == math.inf
    ):
        raise MagycError(f"{name} must be a number from {low:g} to {high:g}, got {value!r}")
