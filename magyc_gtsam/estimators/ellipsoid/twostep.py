"""`twostep`: Alonso and Shuster, "Complete linear attitude-independent magnetometer calibration", 2002.

Equation numbers are those of section 3 of the review (Papafotis, Nikitas, Sotiriadis, Sensors 2021, 21, 5288).
The samples enter only through sums, so the cost of an iteration does not depend on their number.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.estimators.ellipsoid.entry_point import entry_point
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import REMEDY, Ellipsoid, check_positive, ended
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, vech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array

ORDER = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # order of a symmetric matrix's elements in (11) and (16)
UNITS = SYMMETRIC_UNITS[[0, 3, 5, 1, 2, 4]]  # the six symmetric unit matrices in that order
_ROUNDING = 1e-9  # share of the field, least noise that is assumed


def twostep(
    y: Array, *, noise: float | None = None, tolerance: float = 1e-10, max_iterations: int = 100
) -> Ellipsoid:
    """Fit the ellipsoid to samples (n, 3) without units, until η (12), the squared step in sigmas, is at `tolerance`.

    `noise` is σ of a sample. If it is None, a first pass in the limit σ → 0, which affects only μ (5a), gives σ from
    its residuals.
    """
    check_positive(tolerance=tolerance, max_iterations=max_iterations)
    if noise is not None:
        check_positive(noise=noise)
        return _twostep(y, noise, tolerance, max_iterations)[0]
    _, sigma = _twostep(y, 0.0, tolerance, max_iterations)
    return _twostep(y, max(sigma, _ROUNDING), tolerance, max_iterations)[0]


calibrate_twostep = entry_point("twostep", twostep)


def _twostep(y: Array, noise: float, tolerance: float, max_iterations: int) -> tuple[Ellipsoid, float]:
    """Return the estimate with the given σ, and the σ of its residuals."""
    z = (y**2).sum(axis=1) - 1  # (4), ‖m‖ = 1
    L = np.hstack([2 * y, -squares(y)])  # (6)
    mu = -3 * noise**2  # (5a)
    # (5b): (I + D) y − h is the field, of length 1 apart from noise. In the limit σ → 0 any variance can be used.
    variance = 4 * noise**2 + 6 * noise**4 if noise else 1.0

    # (7), with equal weights
    n = len(y)
    z_mean, L_mean = z.mean(), L.mean(axis=0)
    z_centred, L_centred = z - z_mean, L - L_mean
    mean_variance = variance / n
    # (8) for c alone with E = 0, as TWOSTEP for the bias. All ‖m_k‖ are equal, so z_k + 1 is the sum of the squares in
    # L_k, and (8) for c and E has the exact but trivial solution c = 0, E = −I.
    information = L_centred.T @ L_centred / variance
    target = L_centred.T @ z_centred / variance
    centred = np.zeros(9)
    centred[:3] = np.linalg.solve(information[:3, :3], target[:3])

    theta, eta, iterations = centred, np.inf, 0
    while eta > tolerance and iterations < max_iterations:
        c, E = theta[:3], theta[3:][ORDER]
        v = np.linalg.solve(np.eye(3) + E, c)  # (10a)
        phi = np.concatenate([2 * v, -squares(v[None])[0]])  # (10b)
        slope = L_mean - phi
        total = information + np.outer(slope, slope) / mean_variance
        gradient = (  # (10c)
            information @ theta - target - (z_mean - L_mean @ theta + c @ v - mu) * slope / mean_variance
        )
        step = -np.linalg.solve(total, gradient)  # (9)
        eta = float(step @ total @ step)  # (12)
        theta = theta + step
        iterations += 1
    converged = bool(eta <= tolerance)

    # (13), (14a): (I + D)² = I + E
    c, E = theta[:3], theta[3:][ORDER]
    s, U = np.linalg.eigh(E)
    if not np.isfinite(theta).all() or s[0] <= -1:
        raise MagycError(
            f"method 'twostep' failed: I + E has the eigenvalue {1 + s[0]:.3g}, no ellipsoid fits; {REMEDY}"
        )
    D = (U * (np.sqrt(1 + s) - 1)) @ U.T
    T = np.linalg.inv(np.eye(3) + D)  # (15)
    # Unlike (14b): (I + D)⁻¹ c is the bias of Alonso and Shuster's model y = T (m + h); that of (2) is T times it.
    h = np.linalg.solve(np.eye(3) + E, c)
    residual = z - L @ theta + c @ h - mu
    ellipsoid = Ellipsoid(
        T,
        h,
        converged,
        ended(converged, iterations),
        covariance=_covariance(np.linalg.inv(total), T, h) if noise else None,
        diagnostics={"iterations": iterations},
    )
    return ellipsoid, float(np.sqrt(residual @ residual / max(n - 9, 1))) / 2


def squares(y: Array) -> Array:
    """Return (6a), S (n, 6) of y (n, 3), so that yᵀ E y = S · (E11, E22, E33, E12, E13, E23)."""
    return np.einsum("ni,jik,nk->nj", y, UNITS, y)


def _covariance(theta: Array, T: Array, h: Array) -> Array:
    """Return the covariance (9, 9) of vech(T) and h from that of (c, E), by T² (I + E) = I and (I + E) h = c."""
    squared = T @ T
    t, U = np.linalg.eigh(T)
    dT = -U @ (U.T @ squared @ UNITS @ squared @ U / (t[:, None] + t)) @ U.T  # T dT + dT T = −T² dE T²
    jacobian = np.zeros((9, 9))
    jacobian[:6, 3:] = vech(dT).T
    jacobian[6:, :3] = squared
    jacobian[6:, 3:] = -squared @ (UNITS @ h).T
    covariance: Array = jacobian @ theta @ jacobian.T
    return covariance
