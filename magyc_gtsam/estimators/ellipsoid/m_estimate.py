"""Covariance of robust ellipsoid fits: that of an M-estimate, whatever the distribution of the residuals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.estimators.ellipsoid.magnetometer_only import UNKNOWNS, symmetric_root
from magyc_gtsam.recording import Array

Blocks = NDArray[np.int_]

_SINGULAR = 1e-12  # smallest over largest eigenvalue of the information
_BLOCK, _LEAST_BLOCKS = 1.0, 60  # s, and how many blocks make a covariance


def distance_jacobian(matrix: Array, direction: Array, normal: Array) -> Array:
    """(9, n): −∂distance/∂(vech √(K Kᵀ), b), from K (3, 3), x̂ and the normals, both (3, n)."""
    x, n = np.linalg.solve(symmetric_root(matrix), matrix @ direction), normal
    mixed = [n[0] * x[1] + n[1] * x[0], n[0] * x[2] + n[2] * x[0], n[1] * x[1], n[1] * x[2] + n[2] * x[1]]
    return np.array([n[0] * x[0], *mixed, n[2] * x[2], *n])


def l1_curvature(residual: Array, sigma: float) -> Array:
    """(n,) in place of ρ'' where ρ = σ |r|, which has none: the density of the residuals at zero (Powell 1984)."""
    band = len(residual) ** -0.2
    return np.asarray((np.abs(residual) < band * sigma) / band)


def m_covariance(
    jacobian: Array, influence: Array, curvature: Array, blocks: Blocks | None = None
) -> Array | None:
    """H⁻¹ (Σ ψ² a aᵀ) H⁻¹ with H = Σ ρ'' a aᵀ (Huber 1981).

    Args:
        jacobian: (9, n) a.
        influence, curvature: (n,) ψ = ρ' and ρ''.
        blocks: (n,) ascending; samples of one block may err together, and are summed before they are squared
            (Liang and Zeger 1986). None takes all samples as independent.

    Returns:
        (9, 9); None where the samples do not determine the parameters.
    """
    information = (jacobian * curvature) @ jacobian.T
    eigenvalues = np.linalg.eigvalsh(information)
    if not eigenvalues[0] > _SINGULAR * eigenvalues[-1]:
        return None
    inverse = np.linalg.inv(information)
    score = jacobian * influence
    if blocks is not None:
        score = np.add.reduceat(score, np.flatnonzero(np.diff(blocks, prepend=blocks[0] - 1)), axis=1)
    count = score.shape[1]
    result: Array = count / max(count - UNKNOWNS, 1) * inverse @ (score @ score.T) @ inverse
    return result


def time_blocks(time: Array) -> Blocks | None:
    """Blocks for `m_covariance`, because disturbances last; None for too few samples.

    Blocks of a second, or shorter where the recording would not give enough of them.
    """
    if len(time) < 2 * _LEAST_BLOCKS:
        return None
    since = time - time[0]
    return np.floor(since / min(_BLOCK, since[-1] / _LEAST_BLOCKS)).astype(int)
