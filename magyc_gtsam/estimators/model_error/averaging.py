"""What an instrument may do and the data can neither show nor exclude: averaging over models.

A family with odds π beforehand has amplitudes up to its largest, each octave alike. With L(v) the likelihood of
`components` over that of none, the odds that it is there are π times the mean of L(v), and what is then known of its
coefficients is E[β βᵀ], averaged over v likewise (Hoeting and others, Bayesian model averaging, Statist. Sci. 1999).
No threshold: what the data exclude is small, what they show counts in full, and in between it counts by its odds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


class Averaged(NamedTuple):
    """Of one family: ln of the mean likelihood over that of none, E[β βᵀ] (k, k), and the mean amplitude."""

    evidence: float
    second: Array
    amplitude: float


def averaged(normal: Array, score: Array, square: float, freedom: float, most: float, octaves: int) -> Averaged:
    """Of one group with G (k, k) and s (k,) over `octaves` of amplitude from `most` down, in its columns' unit."""
    value, vector = np.linalg.eigh(normal)
    value, pull = np.maximum(value, 0.0), vector.T @ score
    variance = most**2 * freedom / square * 0.25 ** np.arange(octaves)[:, None]
    spread = 1 + variance * value
    left = np.maximum(square - variance[:, 0] * ((1 / spread) @ pull**2), 1e-9 * square)
    gain = -0.5 * (np.log(spread).sum(axis=1) + freedom * np.log(left / square))
    top = float(gain.max())
    share = np.exp(gain - top)
    evidence = top + float(np.log(share.mean()))
    share /= share.sum()
    known = variance / spread
    mean = known * pull
    level = left / freedom
    second = (vector * (share @ (level[:, None] * known))) @ vector.T
    means = mean @ vector.T
    second += (means.T * share) @ means
    return Averaged(evidence, second, float(np.sqrt(share @ (variance[:, 0] * level))))
