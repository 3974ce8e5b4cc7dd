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
from magyc_gtsam.gap.rules import RULES

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


def power_of(name: str, everywhere: Sequence[tuple[float, Array]]) -> float:
    """Return the probability of finding the smallest value that matters, averaged over the settings.

    It is that of the least determined parameter at each setting. The setting that noise prefers says nothing: a jump is
    found in the middle of a recording, but not at its ends.

    Args:
        name: of the effect.
        everywhere: see `Weighed`.
    """
    return _power(_detectable(name, everywhere), 1.0)


def found_from(name: str, everywhere: Sequence[tuple[float, Array]]) -> float:
    """Return the multiple of the smallest value that matters that is found as `Rules.found_with` asks, or infinity."""
    groups = _detectable(name, everywhere)
    if sum(float(each.share[each.size > 0].sum()) for each in groups) < RULES.found_with:
        return float("inf")
    size, needed = (np.concatenate([getattr(each, what) for each in groups]) for what in ("size", "needed"))
    middle = 0.5 * float(np.log(np.median(needed / np.maximum(size, 1e-300))))
    log = brentq(lambda log: _power(groups, float(np.exp(log))) - RULES.found_with, middle - 30, middle + 30)
    return float(np.exp(log))


def _power(groups: Sequence[Detectable], strength: float) -> float:
    total = 0.0
    for each in groups:
        certain = 4 * each.needed + 100  # scipy's distribution fails far beyond
        size = np.minimum(strength**2 * each.size, certain)
        total += float(each.share @ (1 - chndtr(each.needed, each.values, size)))
    return min(total, 1.0)  # the shares of the settings are rounded


def _detectable(name: str, everywhere: Sequence[tuple[float, Array]]) -> list[Detectable]:
    """Return the detectability of an effect, by the number of its values.

    The evidence of a statistic T at a scale s of the prior is ½ c T − ½ ln det(1 + s² I), where I is the information on
    the values, and c the share that the prior leaves of T in the direction of the value; the most favourable scale
    counts, with its share of the average.
    """
    groups = []
    scales = PRIOR.scales[scales_of(name)]
    for count in sorted({len(information) for _, information in everywhere}):
        same = [(cell, information) for cell, information in everywhere if len(information) == count]
        cell, information = np.array([one for one, _ in same]), np.array([one for _, one in same])
        eigenvalue, vector = np.linalg.eigh(information)
        determined = np.maximum(eigenvalue, LEAST * eigenvalue[:, -1:] + np.finfo(float).tiny)
        mode = modes(name, count)  # of a drift all matter from the same size on
        least = np.argmax((vector**2 / determined[:, None]).sum(axis=2) / mode**2, axis=1)
        eigenvalue = np.maximum(eigenvalue, 1e-12)
        square = (mode[least, None] * vector[np.arange(len(least)), least]) ** 2 * eigenvalue
        size = square.sum(axis=1)
        growth = scales[:, None] ** 2 * eigenvalue[:, None]
        left = (growth / (1 + growth) @ square[..., None])[..., 0] / np.maximum(size, 1e-300)[:, None]
        nats = ENOUGH - cell[:, None] + np.log(len(scales)) + 0.5 * np.log1p(growth).sum(axis=2)
        needed = (2 * nats / np.maximum(left, 1e-300)).min(axis=1)
        groups.append(Detectable(np.exp(cell), needed, size, count))
    return groups
