"""Residual (7) of the MAGYC paper: the calibrated field changes only by the calibrated rotation rate.

    r_i = [w_i − b]× (C m_i − d) + C ṁ_i,    C = unvech(l)

It is linear in the 21 numbers z = (l, d, [b]×C, b × d): r_i = Φ_i z. With the triangular factor T of a QR
decomposition of all Φ_i stacked, Σ‖r_i‖² = ‖T z‖² exactly, for any number of samples.

Field and derivative may be in any unit (sigma is then in that unit per second); d is in the field's unit.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.chain.rotations import skew
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Noise, Residual, custom_factor, measured, standard_deviation
from magyc_gtsam.factors.kernels import robustify, tuning_constant
from magyc_gtsam.factors.units import check_rates
from magyc_gtsam.factors.variables import Array, gyro_bias, vector

Samples = tuple[Array, Array, Array]

MONOMIALS = 21
_CROSS_UNITS = skew(np.eye(3))
_BLOCK = 4096  # samples decomposed at a time, which bounds the memory


def derivative_samples(magnetic_field: ArrayLike, derivative: ArrayLike, angular_rate: ArrayLike) -> Samples:
    """Check m, ṁ and w and return each as (n, 3); a single (3,) counts as n = 1.

    Raises:
        MagycError: shapes that differ or are wrong, or values that are not finite.
    """
    m = measured("magnetic_field", np.atleast_2d(magnetic_field), (None, 3))
    return (
        m,
        measured("derivative", np.atleast_2d(derivative), (len(m), 3)),
        measured("angular_rate", np.atleast_2d(angular_rate), (len(m), 3)),
    )


def soft_iron_design(vectors: Array) -> Array:
    """Return the matrices X (n, 3, 6) with C v = X l for vectors v (n, 3)."""
    return np.einsum("jrc,nc->nrj", SYMMETRIC_UNITS, vectors)


def gyro_derivative_error(
    samples: Samples,
    l: Array,  # noqa: E741
    d: Array,
    b: Array,
    want_jacobians: bool = False,
) -> Residual:
    """Return residual (7) of n samples, (n, 3), and its Jacobians (8) on l, d, b: (n, 3, 6), (n, 3, 3) twice."""
    m, derivative, w = samples
    c = unvech(l)
    rotation = skew(w - b)
    field = m @ c - d  # C is symmetric
    residual = (rotation @ field[:, :, None])[:, :, 0] + derivative @ c
    if not want_jacobians:
        return residual, []
    on_soft_iron = rotation @ soft_iron_design(m) + soft_iron_design(derivative)  # (8a)
    return residual, [on_soft_iron, -rotation, skew(field)]  # (8b), (8c)


def gyro_derivative_factor(
    soft_iron_key: int,
    hard_iron_key: int,
    gyro_bias_key: int,
    magnetic_field: ArrayLike,
    derivative: ArrayLike,
    angular_rate: ArrayLike,
    noise: Noise,
    *,
    robust: str | None = None,
    tuning: float | None = None,
) -> gtsam.CustomFactor:
    """Return residual (7) as one factor on (l, d, b) over one sample or any number of them.

    Args:
        soft_iron_key: l, 6-vector, vech of the soft iron's inverse.
        hard_iron_key: d = C h, 3-vector or `Point3`.
        gyro_bias_key: b, 3-vector, `Point3` or `ConstantBias`.
        magnetic_field, derivative, angular_rate: (n, 3), or (3,) for one sample.
        noise: standard deviation per row, or a GTSAM noise model of 3n rows.
        robust: name of a kernel that weights each sample separately; `noise` must then be a number.
        tuning: constant of the kernel; default 95 % efficiency.

    Raises:
        MagycError: wrong shapes, values that are not finite, rates in another unit, unknown kernel.
    """
    samples = derivative_samples(magnetic_field, derivative, angular_rate)
    check_rates("gyro derivative", samples[2])
    rows = 3 * len(samples[0])
    keys, keys_read = (soft_iron_key, hard_iron_key, gyro_bias_key), [vector(6), vector(3), gyro_bias]

    if robust is None:

        def error(l: Array, d: Array, b: Array, want_jacobians: bool) -> Residual:  # noqa: E741
            residual, jacobians = gyro_derivative_error(samples, l, d, b, want_jacobians)
            return residual.reshape(rows), [j.reshape(rows, -1) for j in jacobians]

        return custom_factor("gyro derivative", noise, keys, keys_read, rows, error)

    if isinstance(noise, gtsam.noiseModel.Base):
        raise MagycError("gyro derivative: with a robust kernel `noise` must be one standard deviation")
    sigma = standard_deviation(noise)
    k = tuning_constant(robust, 3, tuning)

    def robust_error(l: Array, d: Array, b: Array, want_jacobians: bool) -> Residual:  # noqa: E741
        residual, jacobians = gyro_derivative_error(samples, l, d, b, want_jacobians)
        residual, jacobians = robustify(robust, residual / sigma, [j / sigma for j in jacobians], k)
        return residual.reshape(rows), [j.reshape(rows, -1) for j in jacobians]

    return custom_factor("robust gyro derivative", 1.0, keys, keys_read, rows, robust_error)


@dataclass(frozen=True, eq=False)
class CompressedGyroDerivative:
    """The sum of ‖r_i‖² over any number of equally weighted samples, exactly, in 21 × 21 numbers.

    Attributes:
        triangular: (21, 21) upper triangular T, diagonal ≥ 0; with `samples` it is the whole state.
        samples: number of compressed samples.

    Raises:
        MagycError: `triangular` is not 21 × 21 finite numbers.
    """

    triangular: Array
    samples: int

    def __post_init__(self) -> None:
        triangular = measured("triangular", self.triangular, (MONOMIALS, MONOMIALS))
        if np.tril(triangular, -1).any():
            raise MagycError("triangular: entries below the diagonal")
        object.__setattr__(self, "triangular", triangular)

    @classmethod
    def empty(cls) -> CompressedGyroDerivative:
        """Return a compression of no samples."""
        return cls(np.zeros((MONOMIALS, MONOMIALS)), 0)

    @classmethod
    def from_samples(
        cls, magnetic_field: ArrayLike, derivative: ArrayLike, angular_rate: ArrayLike
    ) -> CompressedGyroDerivative:
        """Return the compression of samples, (n, 3) each."""
        return cls.empty().update(magnetic_field, derivative, angular_rate)

    def update(
        self, magnetic_field: ArrayLike, derivative: ArrayLike, angular_rate: ArrayLike
    ) -> CompressedGyroDerivative:
        """Return a compression that includes more samples, (n, 3) each or (3,) for one."""
        m, rate, w = derivative_samples(magnetic_field, derivative, angular_rate)
        triangular = self.triangular
        for first in range(0, len(m), _BLOCK):
            rows = slice(first, first + _BLOCK)
            triangular = _triangular(triangular, _monomial_design(m[rows], rate[rows], w[rows]))
        return CompressedGyroDerivative(triangular, self.samples + len(m))

    def error(self, l: Array, d: Array, b: Array, want_jacobians: bool = False) -> Residual:  # noqa: E741
        """Return T z (21,), and its Jacobians on l, d, b: (21, 6), (21, 3), (21, 3)."""
        z, jacobians = _monomials(l, d, b, want_jacobians)
        return self.triangular @ z, [self.triangular @ jacobian for jacobian in jacobians]

    def cost(self, l: Array, d: Array, b: Array) -> float:  # noqa: E741
        """Return Σ‖r_i‖² over all samples."""
        residual, _ = self.error(l, d, b)
        return float(residual @ residual)

    def factor(
        self, soft_iron_key: int, hard_iron_key: int, gyro_bias_key: int, noise: Noise
    ) -> gtsam.CustomFactor:
        """Return one factor on (l, d, b) of 21 rows, equal to one residual (7) per sample.

        Args:
            soft_iron_key, hard_iron_key, gyro_bias_key, noise: as in `gyro_derivative_factor`; `noise` applies to
                every sample's rows.
        """
        keys = (soft_iron_key, hard_iron_key, gyro_bias_key)
        variables = [vector(6), vector(3), gyro_bias]
        return custom_factor("compressed gyro derivative", noise, keys, variables, MONOMIALS, self.error)


def _monomials(l: Array, d: Array, b: Array, want_jacobians: bool) -> Residual:  # noqa: E741
    """Return z = (l, d, [b]× C row by row, b × d) and ∂z/∂l, ∂z/∂d, ∂z/∂b."""
    c, cross = unvech(l), skew(b)
    z = np.concatenate([l, d, (cross @ c).ravel(), cross @ d])
    if not want_jacobians:
        return z, []
    on_soft_iron = np.zeros((MONOMIALS, 6))
    on_soft_iron[:6] = np.eye(6)
    on_soft_iron[9:18] = (cross @ SYMMETRIC_UNITS).reshape(6, 9).T
    on_offset = np.zeros((MONOMIALS, 3))
    on_offset[6:9] = np.eye(3)
    on_offset[18:] = cross
    on_bias = np.zeros((MONOMIALS, 3))
    on_bias[9:18] = (_CROSS_UNITS @ c).reshape(3, 9).T
    on_bias[18:] = -skew(d)
    return z, [on_soft_iron, on_offset, on_bias]


def _monomial_design(m: Array, derivative: Array, w: Array) -> Array:
    """Return the rows (3n, 21) of Φ with r = Φ z: [w]× C m + C ṁ | −[w]× d | −([b]× C) m | b × d."""
    rotation = skew(w)
    result = np.zeros((len(m), 3, MONOMIALS))
    result[:, :, :6] = rotation @ soft_iron_design(m) + soft_iron_design(derivative)
    result[:, :, 6:9] = -rotation
    for i in range(3):
        result[:, i, 9 + 3 * i : 12 + 3 * i] = -m
    result[:, :, 18:] = np.eye(3)
    return result.reshape(-1, MONOMIALS)


def _triangular(first: Array, second: Array) -> Array:
    """Return the triangular factor, with a diagonal ≥ 0, of both matrices stacked."""
    triangular = np.linalg.qr(np.vstack([first, second]), mode="r")
    return np.triu(np.where(np.diag(triangular) < 0, -1.0, 1.0)[:, None] * triangular)
