"""Null distribution of the score tests: white or coloured draws of the innovations, and the tails of the statistics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.special import gammaincc, gammainccinv, gammaln

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.rules import RULES

Draws = NDArray[np.float32]  # half the memory, and enough for a threshold
TAIL = 0.9
_ORDER = 12  # maximum order of the autoregression
_PASSES, _FEW = 3, 60  # iterations, and draws in each, to estimate the spectrum of the readings
_BATCH = 100  # draws at a time


def colour(innovation: Array, drawn: Callable[[Array], Array], white: Draws) -> Draws:
    """Return draws (3n, draws) of innovations with the autocorrelation of the data's, if these are autocorrelated.

    Coloured noise is drawn in the reading and filtered by the twin, because the colour of the data arises in the
    reading: during a turn the filter mixes the axes, and on a straight leg the direction follows slow errors. The
    spectrum of the reading is iterated until the innovations have the spectrum of the data; both are spectra of
    autoregressions, each axis separately.

    Args:
        innovation: (3, n) after the projection, without effects that would be taken for colour; the draws have its
            standard deviation.
        drawn: function that returns the projected innovations (k, 3, n) of draws (k, 3, n) of the windows' noise.
        white: (3n, draws) white draws, returned if the data are white.
    """
    order = memory(innovation)
    if not order:
        return white
    n = innovation.shape[1]
    windows = np.fft.rfft(white.T.reshape(-1, 3, n))
    wanted = _spectrum(innovation[None], order)
    of_reading = wanted
    for _ in range(_PASSES):
        few = drawn(np.fft.irfft(windows[:_FEW] * np.sqrt(of_reading), n))
        of_reading = of_reading * wanted / _spectrum(few, order)
    batches = [
        drawn(np.fft.irfft(windows[i : i + _BATCH] * np.sqrt(of_reading), n)).astype(np.float32)
        for i in range(0, len(windows), _BATCH)
    ]
    result = np.concatenate(batches)
    result *= (innovation.std(axis=1) / result.std(axis=(0, 2)))[:, None]
    return result.reshape(-1, 3 * n).T


def _spectrum(rows: Array, order: int) -> Array:
    """Return the spectra (3, n // 2 + 1) of the autoregressions of draws (k, 3, n), each axis separately."""
    n = rows.shape[2]
    turn = np.exp(-2j * np.pi * np.outer(np.fft.rfftfreq(n), np.arange(1, order + 1)))
    fits = [autoregression(rows[:, axis], order) for axis in range(3)]
    return np.array([power / np.abs(1 - turn @ coefficients) ** 2 for coefficients, power in fits])


def memory(innovation: Array) -> int:
    """Return the longest significant lag of the autocorrelation of innovations (3, n), axes together; 0 if white."""
    n = innovation.shape[1]
    total = float(np.vdot(innovation, innovation))
    lags = range(1, min(_ORDER, n // 4) + 1)
    rho = np.array([float(np.vdot(innovation[:, lag:], innovation[:, :-lag])) / total for lag in lags])
    significant = np.flatnonzero(np.abs(rho) > RULES.coloured / np.sqrt(innovation.size))
    return int(significant[-1]) + 1 if len(significant) else 0


def autoregression(rows: Array, order: int) -> tuple[Array, float]:
    """Return the Yule–Walker coefficients (order,) of rows (..., n), and the power of their prediction errors."""
    n = rows.shape[-1]
    r = np.array([np.vdot(rows[..., lag:], rows[..., : n - lag]) for lag in range(order + 1)]) / rows.size
    coefficients = solve_toeplitz(r[:-1], r[1:])
    return coefficients, float(r[0] - coefficients @ r[1:])


def surprises(statistic: Array, ranks: Array) -> Array:
    """Return −ln P(χ² > statistic); by the asymptotic series where the probability underflows."""
    half_k = 0.5 * np.maximum(ranks, 1)[:, None].astype(float)
    half = 0.5 * np.maximum(statistic, 1e-9)
    table = gammaincc(half_k, half)
    far = half - (half_k - 1) * np.log(half) + gammaln(half_k) - np.log1p(np.maximum(half_k - 1, 0) / half)
    return np.where(table > 1e-280, -np.log(np.maximum(table, 1e-280)), far)


def largest_surprises(statistic: Array, ranks: np.ndarray, count: int) -> Array:
    """Return the `count` largest of the draws' maxima of −ln p over the variants of statistics (variants, draws).

    −ln p grows with the statistic: such a maximum is one of the `count` largest at the rank at which it occurs.
    """
    best = np.full(statistic.shape[1], -np.inf)
    for rank in np.unique(ranks):
        highest = statistic[ranks == rank].max(axis=0)
        some = np.argpartition(highest, -count)[-count:]
        best[some] = np.maximum(best[some], surprises(highest[None, some], np.array([rank]))[0])
    return np.sort(best)[-count:]


def quantile(surprise: float, rank: int) -> float:
    """Return the statistic whose −ln p is `surprise`."""
    if surprise < 600:
        return 2 * float(gammainccinv(0.5 * rank, np.exp(-surprise)))
    return 2 * (surprise + (0.5 * rank - 1) * np.log(surprise) - float(gammaln(0.5 * rank)))


def tail(statistic: Array, ranks: np.ndarray) -> tuple[float, float]:
    """Return the 90 % quantile of the draws' largest −ln p and the mean excess above it, the slope, at least 1.

    Args:
        statistic: (variants, draws).
        ranks: (variants,) degrees of freedom.
    """
    place = TAIL * (statistic.shape[1] - 1)
    largest = largest_surprises(statistic, ranks, statistic.shape[1] - int(place))
    level = float(largest[0] + place % 1 * (largest[1] - largest[0]))
    beyond = largest[largest > level] - level
    return level, max(float(beyond.mean()) if len(beyond) else 1.0, 1.0)
