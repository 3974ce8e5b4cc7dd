"""The probability that an effect would be found: of evidence beyond the odds against one more effect."""

from __future__ import annotations

import numpy as np
from scipy.stats import ncx2

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.evidence.beside import LEAST
from magyc_gtsam.gap.evidence.candidates import modes
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import Weighed, scales_of

ENOUGH = -PRIOR.named  # nats


def power_of(weighed: Weighed) -> float:
    """Return the probability of finding the smallest value that matters, averaged over the settings.

    It is that of the least determined parameter at each setting. The setting that noise prefers says nothing: a jump is
    found in the middle of a recording, but not at its ends.
    """
    total = 0.0
    for count in {len(information) for _, information in weighed.everywhere}:
        same = [(cell, information) for cell, information in weighed.everywhere if len(information) == count]
        cell, information = np.array([one for one, _ in same]), np.array([one for _, one in same])
        eigenvalue, vector = np.linalg.eigh(information)
        eigenvalue = np.maximum(eigenvalue, LEAST * eigenvalue[:, -1:] + np.finfo(float).tiny)
        mode = modes(weighed.name, count)  # of a drift all matter from the same size on
        least = np.argmax((vector**2 / eigenvalue[:, None]).sum(axis=2) / mode**2, axis=1)
        needed, size = needed_and_size(weighed.name, information, cell, np.diag(mode)[least][:, None])
        total += float(np.exp(cell) @ found(needed, size, count)[:, 0])
    return min(total, 1.0)  # the shares of the settings are rounded


def needed_and_size(name: str, information: Array, cell: Array, values: Array) -> tuple[Array, Array]:
    """Return the statistic (B, directions) from which values are found, χ² with k degrees of freedom, and its size.

    The evidence of a statistic T at a scale s of the prior is ½ c T − ½ ln det(1 + s² I), where c is the share that the
    prior leaves of T in the direction of the values; the most favourable scale counts, with its share of the average.

    Args:
        name: of the effect.
        information: (B, k, k) of the values at B settings, I.
        cell: (B,) log prior of the settings.
        values: (B, directions, k).
    """
    eigenvalue, vector = np.linalg.eigh(information)
    eigenvalue = np.maximum(eigenvalue, 1e-12)[:, None]
    square = (values @ vector) ** 2 * eigenvalue
    size: Array = square.sum(axis=2)
    scales = PRIOR.scales[scales_of(name)]
    growth = scales[:, None] ** 2 * eigenvalue
    share = (growth / (1 + growth)) @ square.swapaxes(1, 2) / np.maximum(size, 1e-300)[:, None]
    nats = ENOUGH - cell[:, None] + np.log(len(scales)) + 0.5 * np.log1p(growth).sum(axis=2)
    needed: Array = (2 * nats[..., None] / np.maximum(share, 1e-300)).min(axis=1)
    return needed, size


def found(needed: Array, size: Array, count: int) -> Array:
    """Return the probability that a statistic of a size, χ² with `count` degrees of freedom, is the needed one."""
    certain = 4 * needed + 100  # scipy's distribution fails far beyond
    return np.asarray(ncx2.sf(needed, count, np.minimum(size, certain)), dtype=float)
