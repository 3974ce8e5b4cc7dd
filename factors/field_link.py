"""Link between two field directions: a field fixed in the world rotates in the sensor frame as the gyroscope measures.

ΔR is preintegrated at b₀ and corrected to first order when the bias moves, as `PreintegratedRotation`
does. The residual is the chord x̂₂ − ΔRᵀ x̂₁ (3 rows) rather than the angle in the tangent plane (2 rows):
both have the same cost to second order, and the chord's Jacobians need no derivative of a tangent basis.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.chain.gyroscope_track import GyroscopeTrack
from magyc_gtsam.factors.chain.preintegration import interruptions
from magyc_gtsam.factors.chain.rotations import skew
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Noise, Residual, check_kind, custom_factor, measured, standard_deviation
from magyc_gtsam.factors.numbers import is_finite
from magyc_gtsam.factors.units import check_rate_noise, check_rates
from magyc_gtsam.factors.variables import Array, direction, gyro_bias


@dataclass(frozen=True, eq=False)
class FieldLink:
    """The gyroscope preintegrated between two times.

    Attributes:
        rotation: (3, 3) ΔR at `bias`, from the sensor frame at the end to that at the start.
        lever: (3, 3) s, K = −∫ R dt: a bias change δ turns ΔR into Exp(K δ) ΔR.
        bias: (3,) rad/s, b₀.
        squared_time: s², Σ dt²; the angle's variance is σ_g² times it.
    """

    rotation: Array
    lever: Array
    bias: Array
    squared_time: float

    def __post_init__(self) -> None:
        for name, shape in {"rotation": (3, 3), "lever": (3, 3), "bias": (3,)}.items():
            object.__setattr__(self, name, measured(f"field link's {name}", getattr(self, name), shape))

    def error(self, x1: Array, x2: Array, b: Array, want_jacobians: bool = False) -> Residual:
        """Return x̂₂ − ΔR(b)ᵀ x̂₁ (3,), and its Jacobians on x̂₁, x̂₂ and b, (3, 3) each."""
        correction = self.lever @ (self.bias - b)
        turn = self.rotation.T @ gtsam.Rot3.Expmap(correction).matrix()  # ΔR(b)ᵀ
        residual = x2 - turn @ x1
        if not want_jacobians:
            return residual, []
        # Exp(φ + dφ) x = Exp(φ) (x − [x]× J dφ), J the right Jacobian of SO(3), and dφ = −K db.
        right_jacobian = gtsam.Rot3.ExpmapDerivative(correction)
        return residual, [-turn, np.eye(3), -turn @ skew(x1) @ right_jacobian @ self.lever]


def preintegrate(
    time: ArrayLike,
    angular_rate: ArrayLike,
    start: float,
    end: float,
    bias: ArrayLike = (0.0, 0.0, 0.0),
    *,
    interval_mean: bool = False,
) -> FieldLink:
    """Integrate a gyroscope from `start` to `end` (`rotations.increments`).

    Args:
        time: (n,) s, strictly ascending, covering start to end.
        angular_rate: (n, 3) rad/s, values AT `time`; interpolated linearly at start and end.
        start, end: s, start < end.
        bias: (3,) rad/s, where to linearise.
        interval_mean: the rates are means since the previous stamp instead.

    Raises:
        MagycError: wrong shapes or units, values that are not finite, samples that do not cover the interval, or a
            pause of the gyroscope within it (`interruptions`).
    """
    t = measured("time", time, (None,))
    w = measured("angular_rate", angular_rate, (len(t), 3))
    b = measured("bias", bias, (3,))
    check_rates("field link", w)
    check_rates("field link: bias", b)
    if not (is_finite(start) and is_finite(end)):
        raise MagycError(f"field link from {start!r:.40} to {end!r:.40}; both must be finite numbers of s")
    if len(t) < 2 or (np.diff(t) <= 0).any() or not t[0] <= start < end <= t[-1]:
        covered = f"{t[0]:.3f} to {t[-1]:.3f} s" if len(t) else "none"
        raise MagycError(
            f"field link from {start:.3f} to {end:.3f} s needs ascending samples across it, got {covered}"
        )
    holes = interruptions(t)
    holes = holes[(t[holes] < end) & (t[holes + 1] > start)]
    if len(holes):
        raise MagycError(
            f"field link from {start:.3f} to {end:.3f} s: the gyroscope pauses from {t[holes[0]]:.3f} to "
            f"{t[holes[0] + 1]:.3f} s; end the links before it and begin anew after it"
        )
    inside = (t > start) & (t < end)
    stamps = np.concatenate([[start], t[inside], [end]])
    track = GyroscopeTrack.integrate(t, w, b, interval_mean=interval_mean, stamps=stamps)
    # Steps may be long here, so that ∫ R dt is taken exactly over each.
    r = track.matrices.T.reshape(-1, 3, 3)
    lever = -np.einsum("nij,njk,n->ik", r[:-1], left_jacobian(track.increment), track.step)
    return FieldLink(r[-1], lever, b, float(track.squared_time[-1]))


def left_jacobian(rotation_vector: Array) -> Array:
    """Return J (n, 3, 3) with Exp(φ + dφ) = Exp(J dφ) Exp(φ) to first order, for φ (n, 3) rad."""
    angle = np.linalg.norm(rotation_vector, axis=1)
    small = angle < 1e-4
    a = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle**2 / 24, 2.0 * np.sin(0.5 * a) ** 2 / a**2)
    second = np.where(small, 1 / 6 - angle**2 / 120, (a - np.sin(a)) / a**3)
    cross = skew(rotation_vector)
    return np.eye(3) + first[:, None, None] * cross + second[:, None, None] * (cross @ cross)


def field_link_factor(
    first_direction_key: int,
    second_direction_key: int,
    gyro_bias_key: int,
    link: FieldLink,
    gyroscope_noise: Noise,
) -> gtsam.CustomFactor:
    """Return the link as a factor on (x̂₁, x̂₂, b).

    Args:
        first_direction_key, second_direction_key: x̂₁ and x̂₂, `Unit3`.
        gyro_bias_key: b, 3-vector, `Point3` or `ConstantBias`.
        link: as returned by `preintegrate`.
        gyroscope_noise: σ_g rad/s per sample and axis, or a noise model of the 3 rows in rad.

    Raises:
        MagycError: no link, or a noise that no gyroscope has.
    """
    check_kind("field link: `link`", link, FieldLink, "what preintegrate returns")
    if isinstance(gyroscope_noise, gtsam.noiseModel.Base):
        noise = gyroscope_noise
    else:
        check_rate_noise("field link", gyroscope_noise)
        noise = standard_deviation(gyroscope_noise, "the gyroscope") * np.sqrt(link.squared_time)
    keys = (first_direction_key, second_direction_key, gyro_bias_key)
    return custom_factor("field link", noise, keys, [direction, direction, gyro_bias], 3, link.error)
