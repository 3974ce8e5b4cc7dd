"""What an instrument may do and the data neither show nor exclude, by its odds (`averaging`).

There is no threshold of evidence: on a motion that does not show it, it has its odds and sizes from before the data,
times the move that these make. A filter's size the delay says: one that delays by τ has a second order of up to τ²/2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from magyc_gtsam.estimators.model_error.averaging import Averaged, averaged
from magyc_gtsam.estimators.model_error.component import Component, Tested
from magyc_gtsam.estimators.model_error.components import by_others, likeliest
from magyc_gtsam.estimators.model_error.motion import WindowMotion
from magyc_gtsam.estimators.model_error.shown import Shown
from magyc_gtsam.estimators.smoother.beside import ColumnProducts
from magyc_gtsam.factors.chain.rotations import Array

_FARTHEST = 50.0  # nats
_LITTLE = 0.03  # odds that no mean can pass, below which a family moves nothing


def not_excluded(
    beside: ColumnProducts, motion: WindowMotion, every: Sequence[Tested], shown: Shown
) -> list[Component]:
    """Each family with odds beforehand: beside what is shown, or in the place of one of it, whichever is likelier."""
    components = []
    there = [each.family for each, _ in shown.active]
    for each in every:
        family = each.family
        # Beside others its gain may be another one; by itself no mean over amplitudes is above the likeliest.
        unlikely = family.prior * _likelihood(each.gain) < _LITTLE
        if unlikely or family in there or family.likely(motion) <= 0:
            continue
        odds, known = max(_ways(beside, each, shown, family.likely(motion)), key=lambda way: way[0])
        share = odds / (1 + odds)
        move = each.moves(beside, motion)
        covariance = share * (move @ known.second @ move.T)
        size = family.size(known.amplitude, motion)
        words = family.sentence(size, None)
        components.append(Component(family.name, words, size, known.evidence, covariance, share=share))
    return components


def _ways(beside: ColumnProducts, each: Tested, shown: Shown, largest: float) -> Iterator[tuple[float, Averaged]]:
    """The odds of a family in each way that it may be there, and what is then known of it."""
    freedom, octaves = beside.freedom, each.family.octaves
    if not shown.variance.any():
        known = averaged(each.new.normal, each.new.score, beside.square, freedom, largest, octaves)
        yield each.family.prior * _likelihood(known.evidence), known
        return
    across = np.concatenate([other.new.across(each.new) for other, _ in shown.found])
    normal = np.block([[shown.normal, across], [across.T, each.new.normal]])
    score = np.concatenate([shown.score, each.new.score])
    prior = np.concatenate([shown.variance, np.zeros(len(each.new.score))])
    mine = slice(len(shown.score), len(score))

    def without(held: Array, own: slice) -> tuple[Array, Array, float]:
        explained, left = by_others(normal, score, held, own, beside.square)
        return normal[own, own] - explained[:, :-1], score[own] - explained[:, -1], left

    known = averaged(*without(prior, mine), freedom, largest, octaves)
    yield each.family.prior * _likelihood(known.evidence), known
    for rival, own in shown.active:
        others = prior.copy()
        others[own] = 0.0
        products = without(others, own)
        gain = likeliest(*products, freedom, rival.family.most**2 * freedom / products[2]).gain
        known = averaged(*without(others, mine), freedom, largest, octaves)
        yield each.family.prior / rival.family.prior * _likelihood(known.evidence - gain), known


def _likelihood(nats: float) -> float:
    return float(np.exp(np.clip(nats, -_FARTHEST, _FARTHEST)))
