"""`vasconcelos`: Vasconcelos, Elkaim, Silvestre, Oliveira and Cardeira, "Geometric approach to strapdown magnetometer
calibration in sensor frame", 2011.

Equation numbers are those of section 6 and appendix A.1 of the review (Papafotis, Nikitas, Sotiriadis, Sensors
2021, 21, 5288).
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.estimators.ellipsoid.entry_point import entry_point
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import (
    REMEDY,
    Ellipsoid,
    check_positive,
    ended,
)
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array

_FREE = 1e-8  # curvature relative to the largest below which a direction is a free rotation of T̂
_ROUNDING = 1e-12


def vasconcelos(y: Array, *, tolerance: float = 1e-10, max_iterations: int = 100) -> Ellipsoid:
    """Fit the ellipsoid to samples (n, 3) without units.

    Newton's method on the likelihood (33) from the algebraic ellipsoid, until the last step is at most `tolerance`
    long. All σ_k are equal, so they cancel. Newton's step (35) is restricted to the directions that (33) depends on (it
    is invariant to the three rotations of T̂), uses the absolute eigenvalues of the Hessian, and is halved until the
    cost falls.
    """
    check_positive(tolerance=tolerance, max_iterations=max_iterations)
    T_hat, h = initial_estimate(y)
    x = np.concatenate([T_hat.ravel(order="F"), h])  # (34)
    length, iterations = np.inf, 0
    while length > tolerance and iterations < max_iterations:
        gradient, hessian = derivatives(x, y)
        curvature, axes = np.linalg.eigh(hessian)
        curvature = np.abs(curvature)
        kept = curvature > _FREE * curvature.max()
        step = -axes[:, kept] @ ((axes[:, kept].T @ gradient) / curvature[kept])  # (35)
        length = float(np.linalg.norm(step))
        highest = cost(x, y) * (1 + _ROUNDING)
        while length > tolerance and cost(x + step, y) > highest:
            step, length = step / 2, length / 2
        x = x + step
        iterations += 1
    converged = length <= tolerance
    return Ellipsoid(
        np.linalg.inv(x[:9].reshape(3, 3, order="F")),
        x[9:],
        converged,
        ended(converged, iterations),
        diagnostics={"iterations": iterations, "cost": cost(x, y)},
    )


calibrate_vasconcelos = entry_point("vasconcelos", vasconcelos)


def initial_estimate(y: Array) -> tuple[Array, Array]:
    """Return T̂(0) (3, 3), lower triangular, and h(0) (3,), the algebraic ellipsoid of Foster and Elkaim.

    The explicit formulas (40) to (44) for factor and centre of this quadric have misprints in the review (tan ρ of (42)
    and β2 of (43) do not reproduce noise-free data), so both are computed from its matrix.
    """
    x1, x2, x3 = y.T
    L = np.stack([x1**2, x1 * x2, x1 * x3, x2**2, x2 * x3, x1, x2, x3, np.ones(len(y))], axis=1)  # (37)
    A, B, C, D, E, G, H, I, J = np.linalg.lstsq(L, x3**2, rcond=None)[0]  # (38), (39) # noqa: E741
    quadric = np.array([[-A, -B / 2, -C / 2], [-B / 2, -D, -E / 2], [-C / 2, -E / 2, 1.0]])
    h: Array = np.linalg.solve(quadric, [G, H, I]) / 2  # (41)
    radius = J + h @ quadric @ h
    if not radius > 0 or np.linalg.eigvalsh(quadric)[0] <= 0:
        raise MagycError(f"method 'vasconcelos' failed: the initial quadric is not an ellipsoid; {REMEDY}")
    # T̂ᵀ T̂ = quadric / radius with T̂ lower triangular, (40): Cholesky from the last row up
    T_hat: Array = np.linalg.cholesky(quadric[::-1, ::-1] / radius)[::-1, ::-1].T
    return T_hat, h


def cost(x: Array, y: Array) -> float:
    """Return (33) with σ = 1 at x (12,) = (vec T̂, h)."""
    T_hat, h = x[:9].reshape(3, 3, order="F"), x[9:]
    return float(np.sum((np.linalg.norm((y - h) @ T_hat.T, axis=1) - 1) ** 2))


def derivatives(x: Array, y: Array) -> tuple[Array, Array]:
    """Return gradient (12,) and Hessian (12, 12) of `cost`, by appendix A.1."""
    T_hat, h = x[:9].reshape(3, 3, order="F"), x[9:]
    u = y - h
    Tu = u @ T_hat.T
    norm = np.linalg.norm(Tu, axis=1)
    c = 1 - 1 / norm
    kron = np.einsum("ni,nj->nij", u, Tu).reshape(-1, 9)  # u_k ⊗ T̂ u_k
    TTu = Tu @ T_hat
    gradient = np.concatenate([2 * c @ kron, -2 * c @ TTu])  # (A1)

    both = np.hstack([kron, -TTu])
    hessian = 2 * (both / norm[:, None] ** 3).T @ both  # the first terms of (A3a) to (A3c)
    eye = np.eye(3)
    hessian[:9, :9] += 2 * np.kron(np.einsum("n,ni,nj->ij", c, u, u), eye)  # (A3a)
    mixed = np.kron((c @ u)[:, None], T_hat) + np.kron(eye, (c @ Tu)[:, None])  # (A3b)
    hessian[:9, 9:] -= 2 * mixed
    hessian[9:, :9] -= 2 * mixed.T
    hessian[9:, 9:] += 2 * c.sum() * T_hat.T @ T_hat  # (A3c)
    return gradient, hessian
