"""The scatter of the gyroscope bias from log to log, a variance component that the logs of an instrument determine.

The bias is another one each time that the gyroscope is switched on, and follows its temperature. How much it differs is
a property of the gyroscope: 1.3 mrad/s in BROAD's trials of one day, some 10 mrad/s where logs differ by 10 °C. It is
marginalised over a grid.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.history.gaussian import log_density
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.recording import Array

BIAS_SCATTERS = np.geomspace(0.5, 32.0, 7)  # mrad/s; neighbours differ by a factor of 2, as five logs determine it


def log_prior(model: HistoryModel) -> Array:
    """Return the logarithms of the prior probabilities (g,) of `BIAS_SCATTERS`."""
    weight = -0.5 * (np.log(BIAS_SCATTERS / model.bias_scatter) / model.bias_scatter_spread) ** 2
    result: Array = weight - np.logaddexp.reduce(weight)
    return result


def predicted_bias(bias: Array, covariance: Array, model: HistoryModel) -> tuple[Array, Array]:
    """Return mean (3,) and covariance (3, 3) of the bias in another log, mrad/s.

    Args:
        bias, covariance: (k, 3), (k, 3, 3) of the logs of an instrument, at least one.
        model: the prior of the scatter; that of the mean is flat.
    """
    eye = np.eye(3)
    total = covariance + (BIAS_SCATTERS**2)[:, None, None, None] * eye
    information = np.linalg.inv(total)
    of_mean = np.linalg.inv(information.sum(axis=1))
    mean = np.einsum("gij,gkjl,kl->gi", of_mean, information, bias)
    weight = log_prior(model) + log_density(bias - mean[:, None], total).sum(axis=1)
    weight += 0.5 * np.linalg.slogdet(of_mean)[1]
    share = np.exp(weight - weight.max())
    share /= share.sum()
    middle = share @ mean
    off = mean - middle
    spread = of_mean + (BIAS_SCATTERS**2)[:, None, None] * eye
    return middle, np.einsum("g,gij->ij", share, spread) + np.einsum("g,gi,gj->ij", share, off, off)
