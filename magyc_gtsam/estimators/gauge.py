"""The freedom no magnetometer and gyroscope can fix: the scale of the soft iron against the field strength."""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.factors.chain.field_chain import UPPER
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array
from magyc_gtsam.recording.checks import EARTH_FIELD

_SCALE = 2.5  # by which an instrument's own scale may be off


def check_field_strength(value: Any) -> None:
    """Refuse what cannot be the strength of the true field in T; None says that it is unknown.

    Raises:
        MagycError: no number, or far beyond any field of the Earth.
    """
    if value is None:
        return
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        raise MagycError(f"field_strength: {value!r} is no number of tesla")
    if not 1e-6 < value < 1e-3:
        raise MagycError(f"field_strength: {value:g} T is no field of the Earth (20e-6 to 70e-6 T)")


def doubt_strength(strength: float) -> str:
    """Why the strength that came out, in T, cannot be the true field's; "" where it can.

    An instrument whose own scale is unknown may be off by a factor, but a unit taken for another is off by ten.
    """
    low, high = EARTH_FIELD[0] / _SCALE, EARTH_FIELD[1] * _SCALE
    if low <= strength <= high:
        return ""
    return (
        f"the calibrated field is {strength * 1e6:.3g} µT strong, the Earth's is 20 to 70 ({low * 1e6:.3g} to "
        f"{high * 1e6:.3g} is accepted): likely the unit is another (--magnetic-unit)"
    )


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
        and gyroscope bias; of a rank less by one where the determinant was fixed.
    """
    strength = float(np.cbrt(abs(np.linalg.det(scaled)))) if field_strength is None else field_strength
    jacobian = np.eye(len(covariance))
    jacobian[:6, :6] /= strength
    if field_strength is None:  # the strength moves with B: d∛det B = ∛det B / 3 · tr(B⁻¹ dB)
        slope = strength / 3 * np.linalg.inv(scaled)[UPPER] * np.where(UPPER[0] == UPPER[1], 1.0, 2.0)
        jacobian[:6, :6] -= np.outer(scaled[UPPER], slope) / strength**2
    result = jacobian @ covariance @ jacobian.T
    if sigma:  # A = B/F
        shape = scaled[UPPER] / strength
        result[:6, :6] += np.outer(shape, shape) * (sigma / strength) ** 2
    return scaled / strength, strength, result
