"""`ellipsoid`: the algebraic L2 ellipsoid fit (Foster and Elkaim 2008), and common parts of all algebraic fits.

Equation numbers are those of the Autocal paper (Hong et al. 2020). Samples of the sensor model (1) lie on

    g_j = mᵀ C m + 2 dᵀ m + e = 0                                                                          (3), (5)

which is linear and homogeneous in the unknowns (C, d, e), so that a fit needs a normalisation. Here it is the
Frobenius norm 1 of the 4×4 matrix [[C, d], [dᵀ, e]]: the least-squares solution is then a singular vector, as in
section III-A of the paper, and does not depend on the orientation of the axes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.ellipsoid.entry_point import entry_point
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import Ellipsoid
from magyc_gtsam.recording import Array

_ROWS, _COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])  # elements of C, the diagonal first
_NOT_AN_ELLIPSOID = "the quadric that fits the samples best is not an ellipsoid"


class Standardised(NamedTuple):
    """Standardised samples of section II-B: measured = centre + unit · value, value (3, n)."""

    value: Array
    centre: Array
    unit: float


class Quadric(NamedTuple):
    """The quadric (5) up to scale: C (3, 3) symmetric, d (3,), e."""

    shape: Array
    linear: Array
    constant: float


def standardise(samples: Array) -> Standardised:
    """Subtract the median and divide by the standard deviation (section II-B).

    One standard deviation is used for all axes, so that spheres remain spheres.

    Args:
        samples: (n, 3), any unit.
    """
    columns = np.ascontiguousarray(samples.T)
    centre = np.median(columns, axis=1)
    value = columns - centre[:, None]
    unit = float(np.sqrt(np.einsum("in,in->", value, value) / samples.size))
    return Standardised(value / unit, centre, unit)


def monomials(value: Array) -> Array:
    """Return the factors (10, n) of C11, C22, C33, C12, C13, C23, d1, d2, d3 and e in (5), for samples (3, n)."""
    x, y, z = value
    result = np.empty((10, value.shape[1]))
    np.multiply(value, value, out=result[:3])
    np.multiply(x, y, out=result[3])
    np.multiply(x, z, out=result[4])
    np.multiply(y, z, out=result[5])
    result[3:6] *= 2
    np.multiply(value, 2, out=result[6:9])
    result[9] = 1.0
    return result


def quadric(unknowns: Array) -> Quadric:
    """Return the quadric of (10,) unknowns, in the order of `monomials`."""
    shape = np.empty((3, 3))
    shape[_ROWS, _COLUMNS] = shape[_COLUMNS, _ROWS] = unknowns[:6]
    return Quadric(shape, unknowns[6:9], float(unknowns[9]))


def sensor_model(fit: Quadric, data: Standardised) -> tuple[Array, Array] | None:
    """Return K (3, 3), upper triangular, and b (3,) in the unit of the samples, by lines 2 to 4 of Algorithm 1.

    The result is None if the quadric is not an ellipsoid.
    """
    eigenvalues = np.linalg.eigvalsh(fit.shape)
    sign = np.sign(eigenvalues[1])
    if not sign * eigenvalues[0 if sign > 0 else 2] > 1e-12 * abs(eigenvalues[2 if sign > 0 else 0]):
        return None
    offset = -np.linalg.solve(fit.shape, fit.linear)
    mu = -float(offset @ fit.linear) - fit.constant
    if not sign * mu > 0:
        return None
    root = np.linalg.cholesky(sign * fit.shape).T  # C = Rᵀ R, R upper triangular: chol(C) of the paper
    matrix = np.sqrt(sign * mu) * np.linalg.inv(root)
    return data.unit * matrix, data.centre + data.unit * offset


def fit_ellipsoid(samples: Array) -> tuple[Array, Array] | None:
    """Return K and b of the L2 fit to samples (n, 3) of any unit; None if the quadric is not an ellipsoid.

    The fit is not robust: one outlier can spoil it. The minimum of Σ g_j² with Frobenius norm 1 is the last right
    singular vector of the (n, 10) design, computed by QR and the singular value decomposition of the triangle.
    """
    data = standardise(samples)
    scale = np.array([1, 1, 1, *[np.sqrt(0.5)] * 6, 1])  # off-diagonal unknowns occur twice in the 4×4 matrix
    triangle = np.linalg.qr((monomials(data.value) * scale[:, None]).T, mode="r")
    return sensor_model(quadric(np.linalg.svd(triangle)[2][-1] * scale), data)


def algebraic(
    method: str,
    fit: Callable[[Array], tuple[Array, Array] | None],
    covariance: Callable[[Array, Array, Array], Array | None] = lambda *_: None,
) -> Callable[..., Calibration]:
    """Return the entry point of an algebraic method.

    Args:
        method: name in the registry.
        fit: samples (n, 3) → K and b, or None if they do not lie on an ellipsoid.
        covariance: samples, K and b → (9, 9); None takes that of least squares.
    """

    def fitted(samples: Array) -> Ellipsoid:
        found = fit(samples)
        if found is None:
            return Ellipsoid(np.full((3, 3), np.nan), np.zeros(3), False, _NOT_AN_ELLIPSOID)
        solved = "converged: a convex problem, solved at once"
        return Ellipsoid(*found, message=solved, covariance=covariance(samples, *found))

    return entry_point(method, fitted)


calibrate_ellipsoid = algebraic("ellipsoid", fit_ellipsoid)
