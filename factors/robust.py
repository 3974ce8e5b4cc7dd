"""GTSAM's robust noise models for the kernels of the Autocal paper, for factors that hold one sample each."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import standard_deviation
from magyc_gtsam.factors.kernels import tuning_constant


def robust_noise(
    name: str, sigma: float, dimension: int = 3, tuning: float | None = None
) -> gtsam.noiseModel.Robust:
    """Return GTSAM's own robust noise model of a kernel, for factors that hold one sample each.

    It weights a factor's whole residual: for stacked samples use `robustify` inside the factor.

    Args:
        name: name of the kernel.
        sigma: standard deviation of every row of the residual.
        dimension: rows of the residual.
        tuning: the kernel's constant in whitened units; default 95 % efficiency.
    """
    if not isinstance(dimension, int | np.integer) or isinstance(dimension, bool) or dimension < 1:
        raise MagycError(
            f"robust noise: dimension {dimension!r:.40}; it must be a whole number of rows, at least 1"
        )
    k, sigma = tuning_constant(name, dimension, tuning), standard_deviation(sigma)
    estimators = gtsam.noiseModel.mEstimator
    if name == "l1":  # GTSAM does not wrap L1; Huber(e/√k; √k) is the same function
        estimator, sigma = estimators.Huber.Create(np.sqrt(k)), sigma * np.sqrt(k)
    else:
        family: dict[str, Any] = {
            "huber": estimators.Huber,
            "cauchy": estimators.Cauchy,
            "geman-mcclure": estimators.GemanMcClure,
        }
        estimator = family[name].Create(k)
    return gtsam.noiseModel.Robust.Create(estimator, gtsam.noiseModel.Isotropic.Sigma(dimension, sigma))
