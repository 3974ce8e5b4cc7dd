"""What chance alone would give: white or coloured draws of the innovations, and the tails of their statistics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.special import gammaincc, gammainccinv, gammaln

from magyc_gtsam.factors.rotations import Array

Draws = NDArray[np.float32]  # half the memory, and enough for a threshold
TAIL = 0.9
_ORDER = 12  # of the autoregression, at most
_COLOURED = 3.0  # standard deviations from which an autocorrelation counts


def colour(innovation: Array, white: Draws) -> Draws:
    """White draws (3n, draws) given the autocorrelation of the innovations (3, n), where it is significant.

    Each axis has its own: what the gyroscope leaves open, the innovations show less of.
    """
    order = memory(innovation)
    if not order:
        return white
    overall, shaped = innovation.std(), []
    for row, draws in zip(innovation, white.reshape(3, innovation.shape[1], -1), strict=True):
        drawn = lfilter([1.0], np.concatenate([[1.0], -autoregression(row, order)]), draws, axis=0)
        shaped.append(drawn * (row.std() / (overall * drawn.std())))
    return np.concatenate(shaped).astype(np.float32)


def memory(innovation: Array) -> int:
    """The longest lag at which innovations (3, n), all axes together, significantly hang together; 0 for white."""
    n = innovation.shape[1]
    total = float(np.vdot(innovation, innovation))
    lags = range(1, min(_ORDER, n // 4) + 1)
    rho = np.array([float(np.vdot(innovation[:, lag:], innovation[:, :-lag])) / total for lag in lags])
    significant = np.flatnonzero(np.abs(rho) > _COLOURED / np.sqrt(innovation.size))
    return int(significant[-1]) + 1 if len(significant) else 0


def autoregression(row: Array, order: int) -> Array:
    """(order,) coefficients of innovations (n,) by Yule–Walker."""
    r = np.array([float(row[lag:] @ row[: len(row) - lag]) for lag in range(order + 1)])
    return solve_toeplitz(r[:-1], r[1:])


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
