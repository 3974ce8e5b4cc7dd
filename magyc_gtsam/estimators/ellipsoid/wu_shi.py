"""`wu-shi`: Wu and Shi, "On calibration of three-axis magnetometer", 2015.

Joint maximum likelihood of the ellipsoid and all field directions, with Lagrange multipliers. Equation numbers are
those of section 8 and appendix A.2 of the review (Papafotis, Nikitas, Sotiriadis, Sensors 2021, 21, 5288). The
Hessian (A5) has arrowhead form: the 4 × 4 blocks of (m_k, λ_k) are coupled only through T and h, so that they are
eliminated one by one and the cost of an iteration is linear in the number of samples.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.closest_point import closest_points
from magyc_gtsam.estimators.ellipsoid.entry_point import entry_point
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import (
    REMEDY,
    Ellipsoid,
    check_positive,
    ended,
)
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array

_UPPER = np.array([0, 3, 4, 6, 7, 8])  # indices of the upper triangle in vec(T), column by column
_ROUNDING = 1e-12
_BLOCK = 20_000  # samples whose blocks of the Hessian are held in memory at once


def wu_shi(y: Array, *, tolerance: float = 1e-10, max_iterations: int = 50) -> Ellipsoid:
    """Fit the ellipsoid to samples (n, 3) without units.

    Newton's method on the Lagrangian (52) from the algebraic ellipsoid, until the last step in T and h is at most
    `tolerance` long. After each step (54) in T and h, the directions and multipliers are set to their optimum for the
    new T and h, whereas the review takes their linearised steps; the step is halved until the cost falls. Newton's
    method alone converges only from a start close to the minimum.
    """
    check_positive(tolerance=tolerance, max_iterations=max_iterations)
    T, h = initial_estimate(y)
    m, multiplier, cost = _eliminated(y, T, h)
    length, iterations = np.inf, 0
    while length > tolerance and iterations < max_iterations:
        dT, dh = newton_step(y, T, h, m, multiplier)  # (54)
        length, highest = float(np.sqrt(np.sum(dT**2) + np.sum(dh**2))), cost * (1 + _ROUNDING)
        m, multiplier, cost = _eliminated(y, T + dT, h + dh)
        while length > tolerance and cost > highest:
            dT, dh, length = dT / 2, dh / 2, length / 2
            m, multiplier, cost = _eliminated(y, T + dT, h + dh)
        T, h = T + dT, h + dh
        iterations += 1
    converged = length <= tolerance
    return Ellipsoid(
        T,
        h,
        converged,
        ended(converged, iterations),
        radial=False,
        diagnostics={"iterations": iterations, "cost": cost},
    )


calibrate_wu_shi = entry_point("wu-shi", wu_shi)


def _eliminated(y: Array, T: Array, h: Array) -> tuple[Array, Array, float]:
    """Return the directions m (n, 3) and multipliers λ (n,) that make (52) stationary for T and h, and its value."""
    m = closest_points(T, h, y.T).direction.T
    multiplier = np.sum(((y - h - m @ T.T) @ T) * m, axis=1)
    return m, multiplier, lagrangian(y, T, h, m, multiplier)


def initial_estimate(y: Array) -> tuple[Array, Array]:
    """Return T̂(0) (3, 3), upper triangular, and h(0) (3,), by (55) to (57).

    (57) has chol(A) in place of R⁻¹, a misprint: A = Rᵀ R with R = chol(A), so T̂ = R⁻¹.
    """
    Y = np.hstack([np.einsum("ni,nj->nij", y, y).reshape(-1, 9), y, np.ones((len(y), 1))])  # (55)
    # The products of two axes occur twice in Y; their difference must not be the smallest right singular vector.
    symmetric = np.hstack([Y[:, [0, 4, 8]], 2 * Y[:, [1, 2, 5]], Y[:, 9:]])
    z = np.linalg.svd(symmetric, full_matrices=False)[2][-1]  # (56)
    A = z[[0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(3, 3)
    b, c = z[6:9], z[9]
    scale = b @ np.linalg.solve(A, b) - 4 * c
    A, b = 4 * A / scale, 4 * b / scale
    if not np.linalg.eigvalsh(A)[0] > 0:
        raise MagycError(f"method 'wu-shi' failed: the initial quadric is not an ellipsoid; {REMEDY}")
    R = np.linalg.cholesky(A).T
    return np.linalg.inv(R), -np.linalg.solve(A, b) / 2  # (57)


def lagrangian(y: Array, T: Array, h: Array, m: Array, multiplier: Array) -> float:
    """Return the Lagrangian (52)."""
    return float(np.sum((y - h - m @ T.T) ** 2) + multiplier @ (np.sum(m**2, axis=1) - 1))


def newton_step(y: Array, T: Array, h: Array, m: Array, multiplier: Array) -> tuple[Array, Array]:
    """Return step (54) in T (3, 3) and h (3,), by (A4) to (A7) with the blocks of (m_k, λ_k) eliminated."""
    schur, gradient = np.zeros((9, 9)), np.zeros(9)
    for first in range(0, len(y), _BLOCK):
        part = slice(first, first + _BLOCK)
        for total, share in zip(
            (schur, gradient), _eliminate(y[part], T, h, m[part], multiplier[part]), strict=True
        ):
            total += share
    curvature, axes = np.linalg.eigh(schur)
    curvature = np.maximum(np.abs(curvature), _ROUNDING * np.abs(curvature).max())  # always a descent
    step = -axes @ ((axes.T @ gradient) / curvature)
    dT = np.zeros(9)
    dT[_UPPER] = step[:6]
    return dT.reshape(3, 3, order="F"), step[6:]


def _eliminate(y: Array, T: Array, h: Array, m: Array, multiplier: Array) -> tuple[Array, Array]:
    """Return the contribution of some samples to the Hessian (9, 9) and gradient (9,) of T and h.

    The samples' own unknowns are eliminated.
    """
    n, eye = len(y), np.eye(3)
    residual = y - h - m @ T.T  # u_k − T m_k
    # (A6)
    J_T = -2 * np.einsum("ni,nj->ij", m, residual).ravel()[_UPPER]
    J_h = -2 * residual.sum(axis=0)
    J_m = -2 * residual @ T + 2 * multiplier[:, None] * m
    J_multiplier = np.sum(m**2, axis=1) - 1
    # (A7)
    H_TT = 2 * np.kron(m.T @ m, eye)[np.ix_(_UPPER, _UPPER)]
    H_Th = 2 * np.kron(m.sum(axis=0)[:, None], eye)[_UPPER]
    H_Tm = 2 * (
        np.einsum("nc,ij->ncij", m, T).reshape(n, 9, 3) - np.einsum("ci,nr->ncri", eye, residual).reshape(n, 9, 3)
    )
    own = np.zeros((n, 4, 4))  # H_mm, H_mλ
    own[:, :3, :3] = 2 * T.T @ T + 2 * multiplier[:, None, None] * eye
    own[:, :3, 3] = own[:, 3, :3] = 2 * m
    border = np.zeros((n, 9, 4))  # H_Tm, H_hm; zero for λ
    border[:, :6, :3] = H_Tm[:, _UPPER]
    border[:, 6:, :3] = 2 * T
    shared = np.block([[H_TT, H_Th], [H_Th.T, 2 * n * eye]])
    own_gradient = np.hstack([J_m, J_multiplier[:, None]])

    solved = np.linalg.solve(own, np.concatenate([border.transpose(0, 2, 1), own_gradient[:, :, None]], axis=2))
    schur = shared - np.einsum("nab,nbc->ac", border, solved[:, :, :9])
    gradient = np.concatenate([J_T, J_h]) - np.einsum("nab,nb->a", border, solved[:, :, 9])
    return schur, gradient
