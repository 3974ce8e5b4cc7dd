"""The probability that an effect would be found: of evidence beyond the odds against one more effect."""

from __future__ import annotations

import numpy as np
from scipy.stats import ncx2

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import Weighed

ENOUGH = -PRIOR.named  # nats


def power_of(weighed: Weighed) -> float:
    """Return the probability of finding the smallest value that matters, of the least determined parameter."""
    least = np.eye(len(weighed.score))[int(np.argmax(np.diag(weighed.estimate[1])))]
    needed, size = needed_and_size(weighed.information, weighed.cell, least[None])
    return float(ncx2.sf(needed, len(least), size)[0])


def needed_and_size(information: Array, cell: float, values: Array) -> tuple[Array, Array]:
    """Return the statistic (directions,) from which values are found, χ² with k degrees of freedom, and its size.

    The evidence of a statistic T at a scale s of the prior is ½ c T − ½ ln det(1 + s² I), where c is the share that the
    prior leaves of T in the direction of the values; the most favourable scale counts, with its share of the average.

    Args:
        information: (k, k) of the values, I.
        cell: log prior of their setting.
        values: (directions, k).
    """
    eigenvalue, vector = np.linalg.eigh(information)
    eigenvalue = np.maximum(eigenvalue, 1e-12)
    square = (values @ vector) ** 2 * eigenvalue
    size = square.sum(axis=1)
    growth = PRIOR.scales[:, None] ** 2 * eigenvalue
    share = (growth / (1 + growth)) @ square.T / np.maximum(size, 1e-300)
    nats = ENOUGH - cell + np.log(len(growth)) + 0.5 * np.log1p(growth).sum(axis=1)
    needed: Array = (2 * nats[:, None] / np.maximum(share, 1e-300)).min(axis=0)
    return needed, size
