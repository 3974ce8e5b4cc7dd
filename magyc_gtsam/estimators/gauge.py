"""The gauge freedom that magnetometer and gyroscope leave: the scale of the soft iron against the field strength."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.calibration.limits import PLAUSIBLE_FIELD
from magyc_gtsam.factors.chain.facts import field_strength as strength_of
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array

LARGEST_NOISE = (1e-3, 10.0)  # T, rad/s
_SCALE = 2.5  # factor by which an instrument's scale may be wrong


def check_field_strength(value: Any) -> None:
    """Raise unless `value` can be the strength of the true field in T; None means that it is unknown.

    Raises:
        MagycError: `value` is not a number, or far outside the range of the Earth's field.
    """
    if value is None:
        return
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        raise MagycError(f"field_strength: must be a number of tesla, got {value!r}")
    if not PLAUSIBLE_FIELD[0] <= value <= PLAUSIBLE_FIELD[1]:
        low, high = PLAUSIBLE_FIELD
        raise MagycError(
            f"field_strength: must be that of the Earth, 20e-6 to 70e-6 T ({low:g} to {high:g} T is accepted), got "
            f"{value:g} T ({value * 1e6:.3g} µT)"
        )


def check_noise(value: Any) -> None:
    """Raise unless `value` can be the noise per sample, (magnetometer T, gyroscope rad/s); None means unknown.

    Raises:
        MagycError: `value` is not a pair of numbers, or one of them is 0 or larger than any sensor's.
    """
    if value is None:
        return
    pair = isinstance(value, (tuple, list, np.ndarray)) and len(value) == 2
    if not pair or not all(
        isinstance(each, (int, float, np.number)) and not isinstance(each, bool) and 0 < each < most
        for each, most in zip(value, LARGEST_NOISE, strict=True)
    ):
        raise MagycError(
            "noise: must be a pair (magnetometer T, gyroscope rad/s) above 0, and below {:g} T and {:g} rad/s, got "
            "{!r}".format(*LARGEST_NOISE, value)
        )


def doubt_strength(measured: float, known: float | None) -> str:
    """Return why the field as the sensor reads it cannot be that of the Earth; "" if it can.

    The scale of an instrument may be wrong by a factor of `_SCALE`, whereas a wrong unit is an error of ten.

    Args:
        measured: T, the strength of the calibrated field if the soft iron has determinant 1.
        known: T, the true strength; None if it is not known.
    """
    low, high = PLAUSIBLE_FIELD if known is None else (known / _SCALE, known * _SCALE)
    if low <= measured <= high:
        return ""
    of = "the Earth's is 20 to 70" if known is None else f"that of the place is {known * 1e6:.3g}"
    return (
        f"the calibrated field is {measured * 1e6:.3g} µT strong, {of} ({low * 1e6:.3g} to {high * 1e6:.3g} is "
        "accepted): likely the unit is another (magnetic_unit=)"
    )


class IronScale(NamedTuple):
    """The factorisation B = field strength · soft iron, with the Jacobian that transforms covariances.

    Attributes:
        soft_iron: (3, 3).
        strength: T.
        slopes: (6, 6) Jacobian of vech(soft iron) with respect to vech(B).
        sigma: T, standard deviation of a given strength.
    """

    soft_iron: Array
    strength: float
    slopes: Array
    sigma: float

    @classmethod
    def of(cls, scaled: Array, field_strength: float | None = None, sigma: float = 0.0) -> IronScale:
        """Factorise B; the arguments are those of `fix_scale`."""
        if field_strength is not None:
            return cls(scaled / field_strength, field_strength, np.eye(6) / field_strength, sigma)
        entries = vech(scaled)
        strength, slope = strength_of(entries)  # it moves with B
        slopes = (np.eye(6) - np.outer(entries / strength, slope)) / strength
        return cls(scaled / strength, strength, slopes, sigma)

    def of_parameters(self, rows: Array) -> Array:
        """Transform rows (12, k) of derivatives of (vech(B) T, other parameters) to (vech(soft iron), the same)."""
        return np.concatenate([self.slopes @ rows[:6], rows[6:]])

    def covariance(self, covariance: Array) -> Array:
        """Transform the covariance of (vech(B) T, other parameters) to that of (vech(soft iron), the same)."""
        jacobian = np.eye(len(covariance))
        jacobian[:6, :6] = self.slopes
        result: Array = jacobian @ covariance @ jacobian.T
        if self.sigma:  # A = B/F
            shape = vech(self.soft_iron)
            result[:6, :6] += np.outer(shape, shape) * (self.sigma / self.strength) ** 2
        return result


def fix_scale(
    scaled: Array, covariance: Array, field_strength: float | None = None, sigma: float = 0.0
) -> tuple[Array, float, Array]:
    """Split B = field strength · soft iron.

    Args:
        scaled: (3, 3) B in T.
        covariance: (12, 12) of vech(B) T, hard iron T, gyroscope bias rad/s; (9, 9) without the bias.
        field_strength: T; None takes ∛det B, so that the soft iron has determinant 1.
        sigma: T, standard deviation of `field_strength`.

    Returns:
        Soft iron (3, 3), field strength T, and the covariance, of the given size, of vech(soft iron), hard iron
        and gyroscope bias; its rank is one less than full if the determinant was fixed.
    """
    scale = IronScale.of(scaled, field_strength, sigma)
    return scale.soft_iron, scale.strength, scale.covariance(covariance)
