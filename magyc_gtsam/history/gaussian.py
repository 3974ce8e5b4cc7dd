"""The Gaussian log-density that the filters and the grouping of a history share."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.recording import Array


def log_density(residual: Array, covariance: Array) -> Array:
    """Return the logarithm of the density N(0, covariance) at `residual`, over stacked (…, n) and (…, n, n)."""
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, residual[..., None])[..., 0]
    half_determinant = np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=-1)
    result: Array = (
        -0.5 * (white**2).sum(axis=-1) - half_determinant - 0.5 * residual.shape[-1] * np.log(2 * np.pi)
    )
    return result
