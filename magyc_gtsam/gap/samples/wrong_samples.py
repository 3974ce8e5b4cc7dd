"""Single samples that are wrong: compared with their neighbours, on the scale that holds around them.

What a model misses is coloured and larger at some times than at others. A global distribution of its innovations has
heavy tails without any wrong sample, and hides those there are. So each sample is compared with what its neighbours
on both sides say, the statistic of an additive outlier: with the autoregression A(z) of the innovations, the residual
is A(1/z) A(z) v / Σ a². (Fox, Outliers in time series, 1972; Chen and Liu, Joint estimation of model parameters and
outlier effects in time series, 1993.) White innovations are their own residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import convolve1d, maximum_filter1d, median_filter

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.scores.null import autoregression, memory

_MEDIAN = 2.366  # of χ²₃
_AROUND = 201  # samples whose median is the scale: known to 7 %, by which white noise gets no tails worth a nat
_LEAST = 0.01  # of the scale of the whole, that the local one may be
_PASSES = 8  # of taking wrong samples out of what their neighbours are compared with


def spikes(innovation: Array, level: float, limit: float) -> NoiseScore:
    """Single samples that are wrong among innovations (3, n) of `level` T: a mixture of normal distributions.

    One more than of the noise itself, which has two where the wider one is not rare.
    """
    order, residual, square, hit = _stand_out(innovation)
    noise, mixture = _one(square), _one(square).with_wider(square)
    if mixture.share[-1] >= RULES.rare:
        noise, mixture = mixture, mixture.with_wider(square)
        hit &= mixture.belongs[-1] > 0.5
    gain, share = mixture.likelihood - noise.likelihood, float(mixture.share[-1])
    ratio, belongs = float(mixture.variance[-1] / mixture.variance[-2]), mixture.belongs[-1]
    # A spike stands alone or has one beside it: what comes in stretches is a disturbance, not a wrong sample.
    beyond = np.pad(square > RULES.spike**2, 1)
    single = hit & ~beyond[:-2] & ~beyond[2:]
    groups = hit & ~np.pad(hit, 1)[:-2]
    alone = float(single.sum() / max(groups.sum(), 1))
    # White innovations are the sensor's noise. What hangs together is the model's misfit, which has tails of its own:
    # beside it, at least half of the wrong samples must stand out by themselves.
    apart = not order or _MEDIAN * ratio > RULES.spike**2
    evidence = gain - RULES.chance
    significant = (
        evidence > limit and hit.sum() >= 2 and alone > RULES.spikes_alone and share < RULES.rare and apart
    )
    total = max(float(belongs.sum()), 1e-9)
    height = float(np.sqrt(belongs @ (residual**2).sum(axis=0) / (3 * total))) * level
    return NoiseScore(
        "spikes",
        2 * gain,
        2 * (limit + RULES.chance),
        evidence,
        significant,
        np.array([height]),
        np.array([height / np.sqrt(max(6 * total, 1.0))]),
        {"share": share, "count": float(hit.sum())},
        hit,
    )


def _stand_out(innovation: Array) -> tuple[int, Array, Array, np.ndarray]:
    """How each sample stands out of its neighbours.

    Returns:
        The memory of the innovations, the residuals (3, n), their squared length (n,) in local sigmas, and which
        samples are wrong (n,). These are replaced by what their neighbours say before others are compared with them.
        Only the largest among neighbours is: a wrong sample makes those beside it seem wrong, too, and what were
        taken for wrong with it would be followed by more.
    """
    length = np.sqrt((innovation**2).sum(axis=0))
    usual = np.sqrt(_local_scale(length**2))
    clean = innovation * np.minimum(1.0, RULES.spike / np.maximum(length / usual, 1e-12))
    hit = np.zeros(innovation.shape[1], dtype=bool)
    for _ in range(_PASSES):
        order = memory(clean)  # anew, for wrong samples make innovations seem whiter than they are
        kernels = [_between(row, order) for row in clean]
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


def _between(row: Array, order: int) -> Array:
    """(2 order + 1,) weights of the neighbours in a residual, 0 for the sample itself."""
    ahead = np.append(1.0, -autoregression(row, order)[0]) if order else np.ones(1)
    weights: Array = np.convolve(ahead, ahead[::-1]) / (ahead @ ahead)
    weights[order] = 0.0
    return weights


def _local_scale(square: Array) -> Array:
    """Variance of one axis from the squared lengths (n,) around each sample."""
    size = min(_AROUND, (len(square) - 1) // 2 * 2 + 1)
    median = np.asarray(median_filter(square, size=size, mode="reflect"), dtype=float)
    return np.maximum(median, max(_LEAST * float(np.median(square)), np.finfo(float).tiny)) / _MEDIAN


@dataclass(frozen=True, eq=False)
class _Mixture:
    """Normal distributions of three axes, wider ones last: log-likelihood, shares and variances (k,), whose (k, n)."""

    likelihood: float
    share: Array
    variance: Array
    belongs: Array

    def with_wider(self, square: Array) -> _Mixture:
        """One more distribution, by expectation and maximisation."""
        share = np.append(0.99 * self.share, 0.01)
        variance = np.append(self.variance, max(float(square.max()) / 3, 4 * self.variance[-1]))
        likelihood, belongs = self.likelihood, self.belongs
        for _ in range(60):
            density = np.log(share / variance**1.5)[:, None] - 0.5 * square / variance[:, None]
            total = np.logaddexp.reduce(density, axis=0)
            likelihood, belongs = float(total.sum()), np.exp(density - total)
            share = np.clip(belongs.mean(axis=1), 1e-6, 1.0)
            variance = (belongs @ square) / (3 * np.maximum(belongs.sum(axis=1), 1e-9))
            variance[-1] = max(variance[-1], 1.5 * variance[-2])
        return _Mixture(likelihood, share, variance, belongs)


def _one(square: Array) -> _Mixture:
    """A single normal distribution of squared lengths (n,)."""
    n, variance = len(square), float(square.mean()) / 3
    return _Mixture(-1.5 * n * (np.log(variance) + 1), np.ones(1), np.array([variance]), np.ones((1, n)))
