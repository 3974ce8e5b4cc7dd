"""What an instrument may do and the data can neither show nor exclude: averaging over models.

A family with odds π beforehand has amplitudes up to its largest, each octave alike. With L(v) the likelihood of
`components` over that of none, the odds that it is there are π times the mean of L(v), and what is then known of its
coefficients is E[β βᵀ], averaged over v likewise (Hoeting and others, Bayesian model averaging, Statist. Sci. 1999).
No threshold: what the data exclude is small, what they show counts in full, and in between it counts by its odds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.model_error.principal import Principal, principal, stacked
from magyc_gtsam.factors.chain.rotations import Array


class Averaged(NamedTuple):
    """Of one family: ln of the mean likelihood over that of none, E[β βᵀ] (k, k), and the mean amplitude."""

    evidence: float
    second: Array
    amplitude: float


def averaged(normal: Array, score: Array, square: float, freedom: float, most: float, octaves: int) -> Averaged:
    """Of one group with G (k, k) and s (k,) over `octaves` of amplitude from `most` down, in its columns' unit."""
    return averaged_of_each([principal(normal, score)], square, freedom, [most], [octaves])[0]


def averaged_of_each(
    groups: Sequence[Principal], square: float, freedom: float, most: Sequence[float], octaves: Sequence[int]
) -> list[Averaged]:
    """Of groups each by itself, over the octaves of each from the `most` of each down; `square` is yᵀy."""
    value, pull = stacked(groups)
    halvings = np.arange(max(octaves, default=0))
    variance = np.square(most)[:, None] * (freedom / square) * 0.25**halvings
    spread = 1 + variance[:, :, None] * value[:, None]
    left = np.maximum(square - variance * ((1 / spread) @ np.square(pull)[:, :, None])[..., 0], 1e-9 * square)
    gain = -0.5 * (np.log(spread).sum(axis=2) + freedom * np.log(left / square))
    gain[halvings >= np.array(octaves)[:, None]] = -np.inf
    top = gain.max(axis=1)
    share = np.exp(gain - top[:, None])
    total = share.sum(axis=1)
    evidence = top + np.log(total / octaves)
    share /= total[:, None]
    known = variance[:, :, None] / spread
    level = left / freedom
    amplitude = np.sqrt((share * variance * level).sum(axis=1))
    scatter, mean = ((share * level)[:, None] @ known)[:, 0], known * pull[:, None]
    result = []
    for i, group in enumerate(groups):
        vector, size = group.vector, len(group.value)
        means = mean[i, :, :size] @ vector.T
        second = (vector * scatter[i, :size]) @ vector.T + (means.T * share[i]) @ means
        result.append(Averaged(float(evidence[i]), second, float(amplitude[i])))
    return result
