"""`l1-ellipsoid`: the L1 ellipsoid fit as a semidefinite program (Calafiore 2002; Autocal section II-C).

    minimise Σ γ_j   subject to   −γ_j ≤ g_j(C, d, e) ≤ γ_j,  trace C = 1,  C ⪰ 0                                  (6)

The paper uses trace C = 1 "for enforcing C ≻ 0", which it does not enforce; here the cone is part of the program.
"""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg.lapack import dposv

from magyc_gtsam.closest_point import closest_points
from magyc_gtsam.estimators.ellipsoid.ellipsoid import (
    Standardised,
    algebraic,
    monomials,
    quadric,
    sensor_model,
    standardise,
)
from magyc_gtsam.estimators.ellipsoid.kok_schon import UNKNOWNS, solve, trace_and_cone
from magyc_gtsam.estimators.ellipsoid.m_estimate import distance_jacobian, l1_curvature, m_covariance
from magyc_gtsam.recording import Array

_PASSES = 30
_SETTLED = 1e-2  # relative change of Σ|g| at which a start is accurate enough
_ROUNDED = 1e-2  # lower bound of |g| in the weights, as a share of its mean


def fit_l1_ellipsoid(samples: Array) -> tuple[Array, Array] | None:
    """Return K and b of (6) for samples (n, 3) of any unit; None if the best ellipsoid is flat or infinite.

    The fit is robust against outliers, but does not minimise an error in tesla.
    """
    data = standardise(samples)
    return _program(data, monomials(data.value))


def _program(data: Standardised, phi: Array) -> tuple[Array, Array] | None:
    """Solve (6) with Clarabel; the unknowns are (C, d, e) and γ (n,)."""
    n = phi.shape[1]
    minus_one = -sparse.identity(n, format="csc")
    g = sparse.csc_matrix(phi.T)
    fixed, bound, cones = trace_and_cone()
    matrix = sparse.vstack(
        [
            sparse.hstack([fixed, sparse.csc_matrix((fixed.shape[0], n))]),
            sparse.hstack([g, minus_one]),  # g − γ ≤ 0
            sparse.hstack([-g, minus_one]),  # −g − γ ≤ 0; both together imply γ ≥ 0
        ],
        format="csc",
    )
    linear = np.concatenate([np.zeros(UNKNOWNS), np.full(n, 1 / n)])
    unknowns = solve(
        sparse.csc_matrix((UNKNOWNS + n, UNKNOWNS + n)),
        linear,
        matrix,
        np.concatenate([bound, np.zeros(2 * n)]),
        [*cones, clarabel.NonnegativeConeT(2 * n)],
    )
    return sensor_model(quadric(unknowns[:UNKNOWNS]), data)


def l1_start(data: Standardised) -> tuple[Array, Array] | None:
    """Return K and b of (6), to a few percent of its cost, many times faster than the semidefinite program.

    Without the cone (6) is a linear L1 fit. If its minimum is an ellipsoid, the cone is inactive. Otherwise the
    program's solution is on the boundary of the cone, an infinite ellipsoid, and the result is None.
    """
    phi = monomials(data.value)
    reduced = phi[[0, 1, 3, 4, 5, 6, 7, 8, 9]]
    reduced[:2] -= phi[2]  # trace C = 1: C33 = 1 − C11 − C22
    solution = _linear_l1(reduced, phi[2])
    if solution is None:
        return None
    unknowns = np.insert(solution, 2, 1 - solution[0] - solution[1])
    return sensor_model(quadric(unknowns), data)


def l1_sphere(data: Standardised) -> tuple[Array, Array] | None:
    """Return K and b of the L1 sphere, C = I/3, which one-sided data distort less; None without a real radius."""
    linear = np.concatenate([2 * data.value, np.ones((1, data.value.shape[1]))])
    solution = _linear_l1(linear, np.einsum("in,in->n", data.value, data.value))
    if solution is None:
        return None
    return sensor_model(quadric(np.concatenate([[1, 1, 1, 0, 0, 0], solution])), data)


def _linear_l1(linear: Array, constant: Array) -> Array | None:
    """Return θ that minimises Σ |constant + θ · linear|, by iteratively reweighted least squares; None if singular."""
    weight = np.ones(linear.shape[1])
    before = np.inf
    for _ in range(_PASSES):
        weighted = linear * weight
        _, solution, singular = dposv(weighted @ linear.T, -weighted @ constant)
        if singular:
            return None
        g = np.abs(constant + solution @ linear)
        mean = float(g.mean())
        if not mean < (1 - _SETTLED) * before:
            break
        before = mean
        weight = 1 / np.maximum(g, _ROUNDED * mean)
    result: Array = solution
    return result


def covariance_of_l1(samples: Array, matrix: Array, offset: Array) -> Array | None:
    """Return the covariance (9, 9) of vech(√(K Kᵀ)) and b of (6).

    The residual g is the distance times the slope of ‖K⁻¹(m − b)‖².
    """
    points = closest_points(matrix, offset, samples.T)
    slope = np.linalg.norm(np.linalg.solve(matrix.T, points.direction), axis=0)
    g = slope * points.distance
    sigma = 1.4826 * float(np.median(np.abs(g)))
    jacobian = slope * distance_jacobian(matrix, points.direction, points.normal)
    return m_covariance(jacobian, sigma * np.sign(g), l1_curvature(g, sigma))


calibrate_l1_ellipsoid = algebraic("l1-ellipsoid", fit_l1_ellipsoid, covariance_of_l1)
