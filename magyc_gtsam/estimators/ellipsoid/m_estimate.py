"""The covariance of robust ellipsoid fits as M-estimates, for any distribution of the residuals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.estimators.ellipsoid.magnetometer_only import UNKNOWNS, symmetric_root
from magyc_gtsam.recording import Array

Blocks = NDArray[np.int_]

_SINGULAR = 1e-12  # ratio of smallest to largest eigenvalue of the information matrix below which it is singular
_BLOCK, _LEAST_BLOCKS = 1.0, 60  # s, longest block; least number of blocks for a covariance


def distance_jacobian(matrix: Array, direction: Array, normal: Array) -> Array:
    """Return −∂distance/∂(vech √(K Kᵀ), b) (9, n), from K (3, 3), x̂ and the normals, both (3, n)."""
    x, n = np.linalg.solve(symmetric_root(matrix), matrix @ direction), normal
    mixed = [n[0] * x[1] + n[1] * x[0], n[0] * x[2] + n[2] * x[0], n[1] * x[1], n[1] * x[2] + n[2] * x[1]]
    return np.array([n[0] * x[0], *mixed, n[2] * x[2], *n])


def l1_curvature(residual: Array, sigma: float) -> Array:
    """Return a substitute (n,) for ρ'' of ρ = σ |r|, by the density of the residuals at zero (Powell 1984)."""
    band = len(residual) ** -0.2
    return np.asarray((np.abs(residual) < band * sigma) / band)


def m_covariance(
    jacobian: Array, influence: Array, curvature: Array, blocks: Blocks | None = None
) -> Array | None:
    """Return H⁻¹ (Σ ψ² a aᵀ) H⁻¹ with H = Σ ρ'' a aᵀ (Huber 1981).

    Args:
        jacobian: (9, n) a.
        influence, curvature: (n,) ψ = ρ' and ρ''.
        blocks: (n,) ascending block numbers; samples of one block may have correlated errors, and their scores are
            summed before squaring (Liang and Zeger 1986). None assumes independent samples.

    Returns:
        (9, 9); None if the samples do not determine the parameters.
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
    """Return blocks for `m_covariance`, because disturbances are correlated in time; None for too few samples.

    A block lasts a second, or less if the recording would otherwise have too few blocks.
    """
    if len(time) < 2 * _LEAST_BLOCKS:
        return None
    since = time - time[0]
    return np.floor(since / min(_BLOCK, since[-1] / _LEAST_BLOCKS)).astype(int)
