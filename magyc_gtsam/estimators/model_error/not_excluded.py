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
    PrincipalAxes,
    likeliest,
    log_likelihoods,
    principal,
)
from magyc_gtsam.estimators.model_error.held_columns import HeldColumns, Products
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
    there = [each.family for each in shown.tests]
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
    """The families that a hypothesis has beside the ones considered.

    Attributes:
        products: of the ones considered.
        prior, gain: prior odds and gain in log-likelihood of the family that is replaced; those of none otherwise.
    """

    products: list[Products]
    prior: float = 1.0
    gain: float = 0.0


def _others(held: HeldColumns, beside: ColumnProducts, shown: JointFit, rows: list[slice]) -> Iterator[_Others]:
    """Yield all families that are shown, which are held, then all but one, for each of them; `rows` are considered."""
    yield _Others([held.of(own) for own in rows])
    assert shown.stacked is not None
    for replaced, own in zip(shown.tests, shown.stacked.groups, strict=True):
        alone = held.of(own)
        gain = likeliest(*alone, beside.freedom, replaced.family.most**2 * beside.freedom / alone.left).gain
        yield _Others(held.without(own, rows), replaced.family.prior, gain)


def _likeliest(
    beside: ColumnProducts, families: Sequence[FamilyTest], largest: Sequence[float], shown: JointFit
) -> list[tuple[float, Averaged]]:
    """Return the odds and posterior of each family in its likeliest hypothesis."""
    octaves = [each.family.octaves for each in families]
    if shown.stacked is None or not families:
        axes = [each.principal for each in families]
        every = averaged_of_each(axes, beside.square, beside.freedom, largest, octaves)
        return [(_odds(each, known), known) for each, known in zip(families, every, strict=True)]
    held, rows = _beside_shown(beside, families, shown)
    hypotheses = []
    for others in _others(held, beside, shown, rows):
        axes = [principal(each.normal, each.score) for each in others.products]
        every = averaged_of_each(axes, others.products[0].left, beside.freedom, largest, octaves)
        hypotheses.append([(_odds(*each, others), each[1]) for each in zip(families, every, strict=True)])
    return [max(each, key=lambda hypothesis: hypothesis[0]) for each in zip(*hypotheses, strict=True)]


def _beside_shown(
    beside: ColumnProducts, families: Sequence[FamilyTest], shown: JointFit
) -> tuple[HeldColumns, list[slice]]:
    """Return families beside those that are shown, which are held, and the rows of each; they are not compared."""
    assert shown.stacked is not None
    stacked, first = Stacked.of([each.new for each in families]), len(shown.score)
    rows = [slice(first + own.start, first + own.stop) for own in stacked.groups]
    normal = np.zeros((rows[-1].stop, rows[-1].stop))
    normal[:first, :first], normal[:first, first:] = shown.normal, shown.stacked.across(stacked)
    normal[first:, :first] = normal[:first, first:].T
    for each, own in zip(families, rows, strict=True):
        normal[own, own] = each.new.normal
    score = np.concatenate([shown.score, *(each.new.score for each in families)])
    held = HeldColumns(normal, score, beside.square)
    for own in shown.stacked.groups:
        held.hold(own, float(shown.variance[own.start]))
    return held, rows


def _odds(each: FamilyTest, known: Averaged, others: _Others | None = None) -> float:
    prior, gain = (1.0, 0.0) if others is None else (others.prior, others.gain)
    return each.family.prior / prior * _bounded_exp(known.evidence - gain)


def _bounded_exp(nats: float) -> float:
    return exp(min(max(nats, -_LOG_RATIO_BOUND), _LOG_RATIO_BOUND))
