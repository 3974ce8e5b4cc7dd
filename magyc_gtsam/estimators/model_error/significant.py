"""The families that are significant, with jointly fitted amplitudes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.model_error.component import Component, FamilyTest, moves
from magyc_gtsam.estimators.model_error.components import fit_components
from magyc_gtsam.estimators.model_error.motion import WindowMotion
from magyc_gtsam.estimators.smoother.beside import ColumnProducts
from magyc_gtsam.estimators.smoother.stacked import Stacked
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, SKEW
from magyc_gtsam.factors.chain.rotations import Array

_HARD_IRON = slice(6, 9)
_BLOCKS = (slice(0, 6), _HARD_IRON, slice(9, 12))
# Second-order share of a parameter error; the first order missed 0.1 to 0.2 of it on 5 % scale errors, dead zones and
# cubics.
_SECOND_ORDER = 0.15


class JointFit(NamedTuple):
    """The joint fit of the significant families.

    Attributes:
        covariance: (p, p) of θ and of the terms.
        components: families with an amplitude above 0, with covariances (p, p).
        normal, score, variance: G (K, K), s (K,) and v (K,) of all columns, for tests of further families.
        found: the families with the rows of their columns.
        stacked: their columns; None if there are none.
    """

    covariance: Array
    components: tuple[Component, ...]
    normal: Array
    score: Array
    variance: Array
    found: tuple[tuple[FamilyTest, slice], ...]
    stacked: Stacked | None

    @property
    def active(self) -> Iterator[tuple[FamilyTest, slice]]:
        """The families whose variance is above 0 in the joint fit."""
        return ((each, own) for each, own in self.found if self.variance[own].any())


def shown_by(beside: ColumnProducts, motion: WindowMotion, found: Sequence[FamilyTest]) -> JointFit:
    """Fit the amplitudes of the families `found` jointly, in the order given."""
    varying = np.zeros((len(beside.estimated.free),) * 2)
    if not found:
        return JointFit(varying, (), np.zeros((0, 0)), np.zeros(0), np.zeros(0), (), None)
    stacked = Stacked.of([each.new for each in found])
    normal, groups = stacked.across(stacked), stacked.groups
    each_move = moves(beside, motion, found)
    for each, own in zip(found, groups, strict=True):
        normal[own, own] = each.new.normal
    score = np.concatenate([each.new.score for each in found])
    most = [each.family.most for each in found]
    usual = [each.family.likely(motion) for each in found]
    fitted = fit_components(normal, score, beside.square, groups, most, beside.freedom, usual)
    components = []
    for each, own, move, amplitude in zip(found, groups, each_move, fitted.amplitude, strict=True):
        if amplitude > 0:
            covariance = move @ fitted.second[own, own] @ move.T
            size, period = each.family.size(float(amplitude), motion), each.family.period(motion)
            family = each.family
            if family.of_iron:  # the calibration is the mean of the hard iron, which differs from its later value
                varying[_HARD_IRON, _HARD_IRON] += size**2 * np.eye(3)
                covariance[_HARD_IRON, _HARD_IRON] += size**2 * np.eye(3)
            words = family.sentence(size, period)
            components.append(Component(family.name, words, size, each.gain, covariance, period, family.of_place))
    every = np.concatenate(each_move, axis=1)
    covariance = _to_second_order(every @ fitted.second @ every.T + varying, len(beside.fit.free) > PARAMETERS)
    pairs = tuple(zip(found, groups, strict=True))
    return JointFit(covariance, tuple(components), normal, score, fitted.variance, pairs, stacked)


def _to_second_order(covariance: Array, with_skew: bool) -> Array:
    """Add the second-order error, which may lie in any direction of the same block of parameters."""
    result = covariance.copy()
    for rows in (*_BLOCKS, SKEW) if with_skew else _BLOCKS:
        size = float(np.trace(covariance[rows, rows]))
        result[rows, rows] += _SECOND_ORDER**2 * size * np.eye(rows.stop - rows.start)
    return result
