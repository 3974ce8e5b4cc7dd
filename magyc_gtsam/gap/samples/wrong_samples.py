"""Test for wrong single samples: a comparison with their neighbours, on the local scale.

The misfit of a model is coloured and its level varies with time. The global distribution of its innovations therefore
has heavy tails without any wrong sample, which hide the wrong ones. So each sample is compared with its prediction from
the neighbours on both sides, the statistic of an additive outlier: with the autoregression A(z) of the innovations, the
residual is A(1/z) A(z) v / Σ a². (Fox, Outliers in time series, 1972; Chen and Liu, Joint estimation of model
parameters and outlier effects in time series, 1993.) For white innovations it is the innovation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.ndimage import convolve1d, maximum_filter1d, median_filter

from magyc_gtsam.estimators.smoother.fit import COLOURED
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.noise_effects import NoiseScore

_ORDER = 12  # maximum order of the autoregression
_MEDIAN = 2.366  # of χ²₃
_LOCAL = 201  # samples in the median of the local scale: its error of 7 % gives white noise no tails worth a nat
_LEAST = 0.01  # of the global scale, lower limit of the local scale and of that of an axis
_PASSES = 8  # of replacing wrong samples in the neighbours that others are compared with


def spikes(innovation: Array, level: float, limit: float) -> NoiseScore:
    """Test for wrong samples among innovations (3, n) of `level` T, with a mixture of normal distributions.

    The mixture has one distribution more than the noise, which has two if the wider one is not rare.
    """
    axes = np.sqrt(
        np.median(innovation**2, axis=1, keepdims=True)
    )  # the noise of each, which spikes hardly change
    axes = np.maximum(axes / max(float(np.sqrt((axes**2).mean())), np.finfo(float).tiny), _LEAST)
    order, residual, square, hit = _outliers(innovation / axes)
    noise, mixture = _one(square), _one(square).with_wider(square)
    if mixture.share[-1] >= RULES.rare:
        noise, mixture = mixture, mixture.with_wider(square)
        hit &= mixture.belongs[-1] > 0.5
    gain, share = mixture.likelihood - noise.likelihood, float(mixture.share[-1])
    ratio, belongs = float(mixture.variance[-1] / mixture.variance[-2]), mixture.belongs[-1]
    # A spike is one wrong sample or two adjacent ones; a longer run is a disturbance, not a wrong sample.
    beyond = np.pad(square > RULES.spike**2, 1)
    single = hit & ~beyond[:-2] & ~beyond[2:]
    groups = hit & ~np.pad(hit, 1)[:-2]
    alone = float(single.sum() / max(groups.sum(), 1))
    # White innovations are the sensor's noise. Autocorrelated innovations are the model's misfit, which has heavy tails
    # itself: there, the median wrong sample must exceed the limit of a spike.
    apart = not order or _MEDIAN * ratio > RULES.spike**2
    evidence = gain - RULES.chance
    single_ones = hit.sum() >= 2 and alone > RULES.spikes_alone and share < RULES.rare and apart
    total = max(float(belongs.sum()), 1e-9)
    height = float(np.sqrt(belongs @ ((axes * residual) ** 2).sum(axis=0) / (3 * total))) * level
    return NoiseScore(
        "spikes",
        2 * gain,
        evidence,
        evidence > limit,
        evidence > limit and bool(single_ones),
        np.array([height]),
        np.array([height / np.sqrt(max(6 * total, 1.0))]),
        {"share": share, "count": float(hit.sum())},
        hit,
    )


def _outliers(innovation: Array) -> tuple[int, Array, Array, np.ndarray]:
    """Compute the residual of each sample from its neighbours, and detect additive outliers.

    A wrong sample makes its neighbours seem wrong, too, and the false ones would cause more. Therefore only the largest
    residual among neighbours is taken as wrong, and replaced by its prediction before others are compared with it.

    Returns:
        The order of the innovations' autoregression, the residuals (3, n), their squared length (n,) in local sigmas,
        and a mask (n,) of the wrong samples.
    """
    length = np.sqrt((innovation**2).sum(axis=0))
    usual = np.sqrt(_local_scale(length**2))
    clean = innovation * np.minimum(1.0, RULES.spike / np.maximum(length / usual, 1e-12))
    hit = np.zeros(innovation.shape[1], dtype=bool)
    for _ in range(_PASSES):
        order = memory(clean)  # estimated again, because wrong samples make innovations seem whiter than they are
        kernels = [_neighbour_weights(row, order) for row in clean]
        residual = np.stack(
            [row + convolve1d(c, k, mode="mirror") for row, c, k in zip(innovation, clean, kernels, strict=True)]
        )
        square = (residual**2).sum(axis=0)
        square = square / _local_scale(square)
        first = square == maximum_filter1d(square, 2 * order + 1)
        now = (square > RULES.spike**2) & (hit | first)
        clean = np.where(now, innovation - residual, innovation)
        if (now == hit).all():
            break
        hit = now
    return order, residual, square, hit


def _neighbour_weights(row: Array, order: int) -> Array:
    """Return the weights (2 order + 1,) of the neighbours in a residual, 0 for the sample itself."""
    ahead = np.ones(1)
    if order:  # by the equations of Yule and Walker
        r = np.array([np.vdot(row[lag:], row[: len(row) - lag]) for lag in range(order + 1)]) / len(row)
        ahead = np.append(1.0, -solve_toeplitz(r[:-1], r[1:]))
    weights: Array = np.convolve(ahead, ahead[::-1]) / (ahead @ ahead)
    weights[order] = 0.0
    return weights


def _local_scale(square: Array) -> Array:
    """Return the local variance of one axis around each sample, from the squared lengths (n,)."""
    size = min(_LOCAL, (len(square) - 1) // 2 * 2 + 1)
    median = np.asarray(median_filter(square, size=size, mode="reflect"), dtype=float)
    return np.maximum(median, max(_LEAST * float(np.median(square)), np.finfo(float).tiny)) / _MEDIAN


@dataclass(frozen=True, eq=False)
class _Mixture:
    """A mixture of normal distributions of three axes.

    Attributes:
        likelihood: log-likelihood.
        share, variance: (k,), the widest distribution last.
        belongs: (k, n) probability that a sample belongs to a distribution.
    """

    likelihood: float
    share: Array
    variance: Array
    belongs: Array

    def with_wider(self, square: Array) -> _Mixture:
        """Return the mixture with one more, wider distribution, fitted by expectation maximisation."""
        share = np.append(0.99 * self.share, 0.01)
        variance = np.append(self.variance, max(float(square.max()) / 3, 4 * self.variance[-1]))
        likelihood, belongs = self.likelihood, self.belongs
        for _ in range(60):
            density = np.log(share / variance**1.5)[:, None] - 0.5 * square / variance[:, None]
            largest = density.max(axis=0)
            belongs = np.exp(density - largest)
            total = belongs.sum(axis=0)
            belongs /= total
            likelihood = float((np.log(total) + largest).sum())
            share = np.clip(belongs.mean(axis=1), 1e-6, 1.0)
            variance = (belongs @ square) / (3 * np.maximum(belongs.sum(axis=1), 1e-9))
            variance[-1] = max(variance[-1], 1.5 * variance[-2])
        return _Mixture(likelihood, share, variance, belongs)


def _one(square: Array) -> _Mixture:
    """Return a single normal distribution, fitted to squared lengths (n,)."""
    n, variance = len(square), float(square.mean()) / 3
    return _Mixture(-1.5 * n * (np.log(variance) + 1), np.ones(1), np.array([variance]), np.ones((1, n)))


def autocorrelation(innovation: Array, most: int) -> Array:
    """Return the autocorrelation of innovations (3, n), axes together, at the lags 1 to `most`, fewer of a short n."""
    n, total = innovation.shape[1], float(np.vdot(innovation, innovation))
    lags = range(1, min(most, n // 4) + 1)
    return np.array([float(np.vdot(innovation[:, lag:], innovation[:, :-lag])) / total for lag in lags])


def memory(innovation: Array) -> int:
    """Return the longest significant lag of the autocorrelation of innovations (3, n), axes together; 0 if white."""
    rho = autocorrelation(innovation, _ORDER)
    significant = np.flatnonzero(np.abs(rho) > COLOURED / np.sqrt(innovation.size))
    return int(significant[-1]) + 1 if len(significant) else 0
