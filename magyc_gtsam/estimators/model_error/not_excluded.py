"""Bayesian model averaging over sensor effects that the data can neither show nor exclude.

A family with prior odds π has amplitudes up to a largest one, each octave equally probable. With L(v) the likelihood
ratio of `components` against v = 0, the posterior odds are π times the mean of L(v) over the octaves, and the second
moment of the coefficients, E[β βᵀ], is averaged over v with weights L(v) (Hoeting and others, Bayesian model averaging,
Statist. Sci. 1999). No threshold is needed: the probability of an effect is close to 0 if the data exclude it and close
to 1 if they show it; on a motion that does not observe it, its prior odds and amplitudes determine the covariance. The
size of a filter is bounded by the delay: a filter with delay τ has a second-order term of up to τ²/2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import exp
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.model_error.component import Component, FamilyTest, JointFit, moves
from magyc_gtsam.estimators.model_error.components import (
    FixedColumns,
    PrincipalAxes,
    likeliest,
    log_likelihoods,
    principal,
)
from magyc_gtsam.estimators.model_error.moments import averaged_moments, propagated
from magyc_gtsam.estimators.model_error.motion import WindowMotion
from magyc_gtsam.estimators.smoother.beside import ColumnProducts, Stacked
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
    if not groups:
        return []
    halvings = np.arange(max(octaves))
    variance = np.square(most)[:, None] * (freedom / square) * 0.25**halvings
    gain, left = log_likelihoods(groups, square, freedom, variance)
    gain[halvings >= np.array(octaves)[:, None]] = -np.inf
    top = gain.max(axis=1)
    share = np.exp(gain - top[:, None])
    total = share.sum(axis=1)
    evidence = top + np.log(total / octaves)
    share /= total[:, None]
    level = share * left / freedom
    amplitude = np.sqrt((level * variance).sum(axis=1))
    seconds = averaged_moments(groups, variance, share, level)
    return [Averaged(*each) for each in zip(evidence.tolist(), seconds, amplitude.tolist(), strict=True)]


_LOG_RATIO_BOUND = 50.0  # nats, bound of a log-likelihood ratio
_LEAST_ODDS = 0.03  # upper bound of the posterior odds below which a family is skipped


def not_excluded(
    beside: ColumnProducts, motion: WindowMotion, every: Sequence[FamilyTest], shown: JointFit
) -> list[Component]:
    """Return a component for each family that is not excluded, with a covariance (p, p) of θ and of the terms.

    Each is considered in addition to the families that are shown and in place of any one of them; the likelier
    hypothesis counts.
    """
    there = [each.family for each, _ in shown.active]
    open_ones, largest = [], []
    for each in every:
        # A bound for the family by itself (beside others its gain may differ): no mean over amplitudes exceeds the
        # maximum of the likelihood.
        unlikely = each.family.prior * _bounded_exp(each.gain) < _LEAST_ODDS
        if not unlikely and each.family not in there and (most := each.family.likely(motion)) > 0:
            open_ones.append(each)
            largest.append(most)
    hypotheses = _likeliest(beside, open_ones, largest, shown)
    components = []
    covariances = propagated(moves(beside, motion, open_ones), [known.second for _, known in hypotheses])
    for each, covariance, (odds, known) in zip(open_ones, covariances, hypotheses, strict=True):
        share = odds / (1 + odds)
        size = each.family.size(known.amplitude, motion)
        words = each.family.sentence(size, None)
        components.append(
            Component(each.family.name, words, size, known.evidence, share * covariance, share=share)
        )
    return components


class _Others(NamedTuple):
    """The families that a hypothesis has beside the one considered.

    Attributes:
        held: their columns.
        prior, gain: prior odds and gain in log-likelihood of the family that is replaced; those of none otherwise.
    """

    held: FixedColumns
    prior: float = 1.0
    gain: float = 0.0


def _others(beside: ColumnProducts, shown: JointFit) -> Iterator[_Others]:
    """Yield all families that are shown, then all but one, for each of them."""
    yield _Others(FixedColumns.of(shown.normal, shown.score, shown.variance, beside.square))
    for replaced, own in shown.active:
        variance = shown.variance.copy()
        variance[own] = 0.0
        held = FixedColumns.of(shown.normal, shown.score, variance, beside.square)
        known, pulled = held.explained(shown.normal[:, own])
        new = shown.normal[own, own] - known, shown.score[own] - pulled
        most = replaced.family.most**2 * beside.freedom / held.left
        yield _Others(held, replaced.family.prior, likeliest(*new, held.left, beside.freedom, most).gain)


def _likeliest(
    beside: ColumnProducts, families: Sequence[FamilyTest], largest: Sequence[float], shown: JointFit
) -> list[tuple[float, Averaged]]:
    """Return the odds and posterior of each family in its likeliest hypothesis."""
    octaves = [each.family.octaves for each in families]
    if shown.stacked is None or not shown.variance.any() or not families:
        axes = [each.principal for each in families]
        every = averaged_of_each(axes, beside.square, beside.freedom, largest, octaves)
        return [(_odds(each, known), known) for each, known in zip(families, every, strict=True)]
    stacked = Stacked.of([each.new for each in families])
    across = shown.stacked.across(stacked)
    hypotheses = []
    for others in _others(beside, shown):
        known, pulled = others.held.explained(across)
        axes = [
            principal(each.new.normal - known[own, own], each.new.score - pulled[own])
            for each, own in zip(families, stacked.groups, strict=True)
        ]
        every = averaged_of_each(axes, others.held.left, beside.freedom, largest, octaves)
        hypotheses.append([(_odds(*each, others), each[1]) for each in zip(families, every, strict=True)])
    return [max(each, key=lambda hypothesis: hypothesis[0]) for each in zip(*hypotheses, strict=True)]


def _odds(each: FamilyTest, known: Averaged, others: _Others | None = None) -> float:
    prior, gain = (1.0, 0.0) if others is None else (others.prior, others.gain)
    return each.family.prior / prior * _bounded_exp(known.evidence - gain)


def _bounded_exp(nats: float) -> float:
    return exp(min(max(nats, -_LOG_RATIO_BOUND), _LOG_RATIO_BOUND))
