"""The probability that an effect would be found: of evidence beyond the odds against one more effect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import chndtr

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.evidence.beside import LEAST
from magyc_gtsam.gap.evidence.candidates import modes
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import scales_of

ENOUGH = -PRIOR.named  # nats


class Detectable(NamedTuple):
    """Of the least determined parameter of an effect at B settings: what is needed to find it, and its size there.

    Attributes:
        share: (B,) prior probability of the setting.
        needed: (B,) statistic from which it is found, χ² with `values` degrees of freedom.
        size: (B,) mean of the statistic, without its degrees of freedom, at the smallest value that matters.
        values: number of values of the effect at these settings.
    """

    share: Array
    needed: Array
    size: Array
    values: int


def power_of(name: str, everywhere: Sequence[tuple[float, Array]], strength: float = 1.0) -> float:
    """Return the probability of finding the smallest value that matters, times `strength`, averaged over the settings.

    It is that of the least determined parameter at each setting. The setting that noise prefers says nothing: a jump is
    found in the middle of a recording, but not at its ends.

    Args:
        name: of the effect.
        everywhere: see `Weighed`.
        strength: multiple of the smallest value that matters.
    """
    return _power(detectable(name, everywhere), strength)


def found_from(name: str, everywhere: Sequence[tuple[float, Array]], probability: float) -> float:
    """Return the strength, as in `power_of`, that is found with a probability; infinite if none is."""
    groups = detectable(name, everywhere)
    if sum(float(each.share[each.size > 0].sum()) for each in groups) < probability:
        return float("inf")
    size, needed = (np.concatenate([getattr(each, what) for each in groups]) for what in ("size", "needed"))
    middle = 0.5 * float(np.log(np.median(needed / np.maximum(size, 1e-300))))
    log = brentq(lambda log: _power(groups, float(np.exp(log))) - probability, middle - 30, middle + 30)
    return float(np.exp(log))


def detectable(name: str, everywhere: Sequence[tuple[float, Array]]) -> list[Detectable]:
    """Return the detectability of an effect, by the number of its values; see `power_of`."""
    groups = []
    for count in sorted({len(information) for _, information in everywhere}):
        same = [(cell, information) for cell, information in everywhere if len(information) == count]
        cell, information = np.array([one for one, _ in same]), np.array([one for _, one in same])
        eigenvalue, vector = np.linalg.eigh(information)
        eigenvalue = np.maximum(eigenvalue, LEAST * eigenvalue[:, -1:] + np.finfo(float).tiny)
        mode = modes(name, count)  # of a drift all matter from the same size on
        least = np.argmax((vector**2 / eigenvalue[:, None]).sum(axis=2) / mode**2, axis=1)
        needed, size = needed_and_size(name, information, cell, np.diag(mode)[least][:, None])
        groups.append(Detectable(np.exp(cell), needed[:, 0], size[:, 0], count))
    return groups


def _power(groups: Sequence[Detectable], strength: float) -> float:
    total = sum(float(each.share @ found(each.needed, strength**2 * each.size, each.values)) for each in groups)
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
    return np.asarray(1 - chndtr(needed, count, np.minimum(size, certain)), dtype=float)
