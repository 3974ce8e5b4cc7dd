"""Bayesian model averaging over effects that the data can neither show nor exclude.

A family with prior odds π has amplitudes up to a largest one, each octave equally probable. With L(v) the likelihood
ratio of `components` against v = 0, the posterior odds are π times the mean of L(v) over the octaves, and the second
moment of the coefficients, E[β βᵀ], is averaged over v with weights L(v) (Hoeting and others, Bayesian model averaging,
Statist. Sci. 1999). No threshold is needed: the probability of an effect is close to 0 if the data exclude it and close
to 1 if they show it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.model_error.principal import PrincipalAxes, stacked
from magyc_gtsam.factors.chain.rotations import Array


class Averaged(NamedTuple):
    """The average of one family over its amplitudes.

    Attributes:
        evidence: log of the mean likelihood ratio against no effect.
        second: (k, k) E[β βᵀ].
        amplitude: root mean square amplitude.
    """

    evidence: float
    second: Array
    amplitude: float


def averaged_of_each(
    groups: Sequence[PrincipalAxes], square: float, freedom: float, most: Sequence[float], octaves: Sequence[int]
) -> list[Averaged]:
    """Average each group by itself, over its number of `octaves` from its `most` down; `square` is yᵀy."""
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
