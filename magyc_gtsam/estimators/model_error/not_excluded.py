"""Model averaging over sensor effects that the data neither show nor exclude (`averaging`).

There is no threshold of evidence: on a motion that does not observe an effect, its prior odds and amplitudes determine
the covariance. The size of a filter is bounded by the delay: a filter with delay τ has a second-order term of up to
τ²/2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import exp

import numpy as np

from magyc_gtsam.estimators.model_error.averaging import Averaged, averaged, averaged_of_each
from magyc_gtsam.estimators.model_error.component import Component, Tested, moves
from magyc_gtsam.estimators.model_error.components import Held, likeliest
from magyc_gtsam.estimators.model_error.motion import WindowMotion
from magyc_gtsam.estimators.model_error.shown import Shown
from magyc_gtsam.estimators.smoother.beside import ColumnProducts

_LOG_RATIO_BOUND = 50.0  # nats, bound of a log-likelihood ratio
_LEAST_ODDS = 0.03  # upper bound of the posterior odds below which a family is skipped


def not_excluded(
    beside: ColumnProducts, motion: WindowMotion, every: Sequence[Tested], shown: Shown
) -> list[Component]:
    """Return a component for each family that is not excluded.

    Each is considered in addition to the families that are shown and in place of any one of them; the likelier
    hypothesis counts.
    """
    there = [each.family for each, _ in shown.active]
    open_ones = []
    for each in every:
        # A bound for the family by itself (beside others its gain may differ): no mean over amplitudes exceeds the
        # maximum of the likelihood.
        unlikely = each.family.prior * _likelihood(each.gain) < _LEAST_ODDS
        if not unlikely and each.family not in there and each.family.likely(motion) > 0:
            open_ones.append(each)
    largest = [each.family.likely(motion) for each in open_ones]
    if shown.variance.any():
        shown_ones = Held.of(shown.normal, shown.score, shown.variance, beside.square)
        rivals = _rivals(beside, shown)
        likeliest_hypotheses = [
            max(_hypotheses(beside, each, shown, shown_ones, rivals, most), key=lambda hypothesis: hypothesis[0])
            for each, most in zip(open_ones, largest, strict=True)
        ]
    else:
        likeliest_hypotheses = _without_others(beside, open_ones, largest)
    components = []
    for each, move, (odds, known) in zip(
        open_ones, moves(beside, motion, open_ones), likeliest_hypotheses, strict=True
    ):
        share = odds / (1 + odds)
        covariance = share * (move @ known.second @ move.T)
        size = each.family.size(known.amplitude, motion)
        words = each.family.sentence(size, None)
        components.append(Component(each.family.name, words, size, known.evidence, covariance, share=share))
    return components


def _without_others(
    beside: ColumnProducts, families: Sequence[Tested], largest: Sequence[float]
) -> list[tuple[float, Averaged]]:
    """Return the odds and posterior of each family if no other family is shown; see `_hypotheses`."""
    octaves = [each.family.octaves for each in families]
    every = averaged_of_each(
        [each.principal for each in families], beside.square, beside.freedom, largest, octaves
    )
    return [
        (each.family.prior * _likelihood(known.evidence), known)
        for each, known in zip(families, every, strict=True)
    ]


def _rivals(beside: ColumnProducts, shown: Shown) -> list[tuple[float, Held, float]]:
    """Return, for each family that is shown, its prior odds, the other families, and its gain beside them."""
    result = []
    for rival, own in shown.active:
        variance = shown.variance.copy()
        variance[own] = 0.0
        others = Held.of(shown.normal, shown.score, variance, beside.square)
        known, pulled = others.explained(shown.normal[:, own])
        new = shown.normal[own, own] - known, shown.score[own] - pulled
        most = rival.family.most**2 * beside.freedom / others.left
        gain = likeliest(*new, others.left, beside.freedom, most).gain
        result.append((rival.family.prior, others, gain))
    return result


def _hypotheses(
    beside: ColumnProducts,
    each: Tested,
    shown: Shown,
    every: Held,
    rivals: Sequence[tuple[float, Held, float]],
    largest: float,
) -> Iterator[tuple[float, Averaged]]:
    """Yield the odds and posterior of a family in addition to the shown ones, and in place of each of them."""
    across = np.concatenate([other.new.across(each.new) for other, _ in shown.found])

    def known_beside(others: Held) -> Averaged:
        known, pulled = others.explained(across)
        new = each.new.normal - known, each.new.score - pulled
        return averaged(*new, others.left, beside.freedom, largest, each.family.octaves)

    known = known_beside(every)
    yield each.family.prior * _likelihood(known.evidence), known
    for prior, others, gain in rivals:
        known = known_beside(others)
        yield each.family.prior / prior * _likelihood(known.evidence - gain), known


def _likelihood(nats: float) -> float:
    return exp(min(max(nats, -_LOG_RATIO_BOUND), _LOG_RATIO_BOUND))
