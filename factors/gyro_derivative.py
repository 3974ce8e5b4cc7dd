"""Residual (7) of the MAGYC paper: the calibrated field changes only as the calibrated gyroscope turns.

    r_i = [w_i − b]× (C m_i − d) + C ṁ_i,    C = unvech(l)

Field and derivative may be in any unit (sigma is then in that unit per second), d in the field's unit.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Array, Noise, Residual, custom_factor, gyro_bias, measured, vector
from magyc_gtsam.factors.robust import robustify, tuning_constant
from magyc_gtsam.factors.rotations import skew
from magyc_gtsam.factors.soft_iron import SYMMETRIC_UNITS, unvech

Samples = tuple[Array, Array, Array]


def derivative_samples(magnetic_field: ArrayLike, derivative: ArrayLike, angular_rate: ArrayLike) -> Samples:
    """m, ṁ and w, checked: each (n, 3), a single (3,) counting as n = 1.

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
    """The matrices X with C v = X l for vectors v (n, 3): (n, 3, 6)."""
    return np.einsum("jrc,nc->nrj", SYMMETRIC_UNITS, vectors)


def gyro_derivative_error(
    samples: Samples,
    l: Array,  # noqa: E741
    d: Array,
    b: Array,
    want_jacobians: bool = False,
) -> Residual:
    """Residual (7) of n samples, (n, 3), and its Jacobians (8) on l, d, b: (n, 3, 6), (n, 3, 3) twice."""
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
    keys: Sequence[int],
    magnetic_field: ArrayLike,
    derivative: ArrayLike,
    angular_rate: ArrayLike,
    noise: Noise,
    *,
    robust: str | None = None,
    tuning: float | None = None,
) -> gtsam.CustomFactor:
    """Residual (7) as one factor on (l, d, b) over one sample or window, or over any number of them.

    Args:
        keys: of l (6-vector), d (3-vector or `Point3`) and b (3-vector, `Point3` or `ConstantBias`).
        magnetic_field, derivative, angular_rate: (n, 3), or (3,) for one sample.
        noise: standard deviation per row, or a GTSAM noise model of 3n rows.
        robust: name of a kernel that weighs each sample by itself; `noise` must then be a number.
        tuning: of the kernel; default 95 % efficiency.

    Raises:
        MagycError: wrong shapes, values that are not finite, unknown kernel.
    """
    samples = derivative_samples(magnetic_field, derivative, angular_rate)
    rows = 3 * len(samples[0])
    keys_read = [vector(6), vector(3), gyro_bias]

    if robust is None:

        def error(l: Array, d: Array, b: Array, want_jacobians: bool) -> Residual:  # noqa: E741
            residual, jacobians = gyro_derivative_error(samples, l, d, b, want_jacobians)
            return residual.reshape(rows), [j.reshape(rows, -1) for j in jacobians]

        return custom_factor("gyro derivative", noise, keys, keys_read, rows, error)

    if isinstance(noise, gtsam.noiseModel.Base):
        raise MagycError("gyro derivative: with a robust kernel `noise` must be one standard deviation")
    k, sigma = tuning_constant(robust, 3, tuning), float(noise)

    def robust_error(l: Array, d: Array, b: Array, want_jacobians: bool) -> Residual:  # noqa: E741
        residual, jacobians = gyro_derivative_error(samples, l, d, b, want_jacobians)
        residual, jacobians = robustify(robust, residual / sigma, [j / sigma for j in jacobians], k)
        return residual.reshape(rows), [j.reshape(rows, -1) for j in jacobians]

    return custom_factor("robust gyro derivative", 1.0, keys, keys_read, rows, robust_error)
