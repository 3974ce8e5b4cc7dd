"""What chance alone would give: white or coloured draws of the innovations, and the tails of their statistics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import gammaincc, gammainccinv, gammaln

from magyc_gtsam.factors.rotations import Array

Draws = NDArray[np.float32]  # half the memory, and enough for a threshold
TAIL = 0.9
_ORDER = 12  # of the autoregression, at most
_COLOURED = 3.0  # standard deviations from which an autocorrelation counts


def colour(innovation: Array, white: Draws) -> Draws:
    """White draws (3n, draws) given the autocorrelation of the innovations (3, n), where it is significant."""
    coefficients = autoregression(innovation)
    if not len(coefficients):
        return white
    n = innovation.shape[1]
    shaped = lfilter([1.0], np.concatenate([[1.0], -coefficients]), white.reshape(3, n, -1), axis=1)
    shaped = shaped.reshape(white.shape)
    return (shaped / shaped.std()).astype(np.float32)


def autoregression(innovation: Array) -> Array:
    """(order,) coefficients by Yule–Walker, the three axes pooled; empty where the innovations are white."""
    n = innovation.shape[1]
    total = float(np.vdot(innovation, innovation))
    rho = [1.0]
    for lag in range(1, min(_ORDER, n // 4) + 1):
        value = float(np.vdot(innovation[:, lag:], innovation[:, :-lag])) / total
        rho.append(value)
    significant = np.flatnonzero(np.abs(rho[1:]) > _COLOURED / np.sqrt(innovation.size))
    if not len(significant):
        return np.zeros(0)
    order = int(significant[-1]) + 1
    r = np.array(rho[: order + 1])
    toeplitz = r[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
    return np.linalg.solve(toeplitz, r[1:])


def surprises(statistic: Array, ranks: Array) -> Array:
    """−ln P(χ² > statistic), beyond where the tables end by the asymptotic series."""
    half_k = 0.5 * np.maximum(ranks, 1)[:, None].astype(float)
    half = 0.5 * np.maximum(statistic, 1e-9)
    table = gammaincc(half_k, half)
    far = half - (half_k - 1) * np.log(half) + gammaln(half_k) - np.log1p(np.maximum(half_k - 1, 0) / half)
    return np.where(table > 1e-280, -np.log(np.maximum(table, 1e-280)), far)


def largest_surprises(statistic: Array, ranks: np.ndarray) -> Array:
    """(draws,) largest −ln p over the variants of statistics (variants, draws), one table look-up for each rank."""
    best = [surprises(statistic[ranks == r].max(axis=0)[None], np.array([r]))[0] for r in np.unique(ranks)]
    return np.max(best, axis=0)


def quantile(surprise: float, rank: int) -> float:
    """The statistic whose −ln p is `surprise`."""
    if surprise < 600:
        return 2 * float(gammainccinv(0.5 * rank, np.exp(-surprise)))
    return 2 * (surprise + (0.5 * rank - 1) * np.log(surprise) - float(gammaln(0.5 * rank)))


def tail(largest: Array) -> tuple[float, float]:
    """The 90 % point of the draws' maxima and the slope of the exponential beyond it."""
    level = float(np.quantile(largest, TAIL))
    beyond = largest[largest > level] - level
    return level, max(float(beyond.mean()) if len(beyond) else 1.0, 1.0)
