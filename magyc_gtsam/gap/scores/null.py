"""What chance alone would give: white or coloured draws of the innovations, and the tails of their statistics."""

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
_ORDER = 12  # of the autoregression, at most
_PASSES, _FEW = 3, 60  # of the draws through the filter, to find the spectrum
_BATCH = 100  # draws at a time


def colour(innovation: Array, drawn: Callable[[Array], Array], white: Draws) -> Draws:
    """Draws (3n, draws) of innovations that hang together as those of the data (3, n) do, where these do.

    Colour is drawn where it is, in the reading, and goes through the twin's filter, as what is in it does: on a turn
    the filter mixes the axes, and on a straight leg the direction follows what is slow. The spectrum of the reading is
    the one with which the innovations have that of the data, both of an autoregression, each axis by itself.

    Args:
        innovation: freed of the base model, and of what would pass for its colour; the draws have its level.
        drawn: innovations (k, 3, n), freed of the base model, of k draws (k, 3, n) of the windows' noise.
        white: (3n, draws) white draws; what is returned where the data are white.
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
    """(3, n // 2 + 1) of the autoregressions of draws (k, 3, n), each axis by itself."""
    n = rows.shape[2]
    turn = np.exp(-2j * np.pi * np.outer(np.fft.rfftfreq(n), np.arange(1, order + 1)))
    fits = [autoregression(rows[:, axis], order) for axis in range(3)]
    return np.array([power / np.abs(1 - turn @ coefficients) ** 2 for coefficients, power in fits])


def memory(innovation: Array) -> int:
    """The longest lag at which innovations (3, n), all axes together, significantly hang together; 0 for white."""
    n = innovation.shape[1]
    total = float(np.vdot(innovation, innovation))
    lags = range(1, min(_ORDER, n // 4) + 1)
    rho = np.array([float(np.vdot(innovation[:, lag:], innovation[:, :-lag])) / total for lag in lags])
    significant = np.flatnonzero(np.abs(rho) > RULES.coloured / np.sqrt(innovation.size))
    return int(significant[-1]) + 1 if len(significant) else 0


def autoregression(rows: Array, order: int) -> tuple[Array, float]:
    """(order,) coefficients of rows (..., n) by Yule–Walker, and the power that they leave."""
    n = rows.shape[-1]
    r = np.array([np.vdot(rows[..., lag:], rows[..., : n - lag]) for lag in range(order + 1)]) / rows.size
    coefficients = solve_toeplitz(r[:-1], r[1:])
    return coefficients, float(r[0] - coefficients @ r[1:])


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
