"""One thing that a model lacks, and columns that stand for it beside a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.model_error.components import likeliest_of_each
from magyc_gtsam.estimators.model_error.families import ColumnFamily
from magyc_gtsam.estimators.model_error.motion import WindowMotion
from magyc_gtsam.estimators.model_error.principal import Principal, principal
from magyc_gtsam.estimators.smoother.beside import ColumnProducts, New
from magyc_gtsam.factors.chain.rotations import Array

_SAYS = 1.0  # nats of gain, below which nothing depends on a family
# Of what is new in a column, the share that may be the gyroscope's noise: 0.02 at most on the four motions of the
# papers, 0.03 to 0.6 on vehicles that hardly tilt or turn at 0.03 rad/s, where scores are off by 3 to 17 nats.
_NOISE_SHARE = 0.03
# Of a column, the share that terms of the model must leave: they are made of samples, columns of windows, so that one
# of a term's own form keeps 0.001 to 0.005 of the gyroscope's noise.
_BESIDE_TERMS = 0.01


@dataclass(frozen=True, eq=False)
class Component:
    """One thing that the model lacks.

    Attributes:
        name: short; sentence: where it is and how large, in plain words.
        size: root mean square an axis: T of the field, rad/s or a share of the rate on the gyroscope.
        gain: of the log-likelihood, by itself.
        covariance: (P, P) of θ. Those of several need not add up to the whole, for they go together.
        period: s, of its variation in time; None where it is not one of time.
        of_place: whether it is the field of the place that varies.
        share: of 1, its probability.
    """

    name: str
    sentence: str
    size: float
    gain: float
    covariance: Array
    period: float | None = None
    of_place: bool = False
    share: float = 1.0


class Tested(NamedTuple):
    """A family beside a fit: its columns' products, their principal axes, and its gain in log-likelihood by itself.

    `moving` are the columns that move the parameters: more than `new`, of which the data say something.
    """

    family: ColumnFamily
    new: New
    principal: Principal
    gain: float
    moving: New


def moves(beside: ColumnProducts, motion: WindowMotion, families: Sequence[Tested]) -> list[Array]:
    """(P, k) of each by how much a unit of each column puts the parameters off those that hold at the end."""
    result = beside.moves([each.moving for each in families])
    for each, move in zip(families, result, strict=True):
        if each.family.at_end is not None:
            there = each.family.at_end(motion) * _beside_terms(each.moving)
            move[: len(there)] -= there
    return result


def tested(beside: ColumnProducts, motion: WindowMotion, families: Sequence[ColumnFamily]) -> list[Tested]:
    """Each family by itself."""
    new = beside.of_each([partial(family.columns_of, motion) for family in families])
    return [_informative(beside, motion, each) for each in _tested(beside, families, new)]


def _beside_terms(new: New) -> np.ndarray:
    """(k,) bool, which columns are more than terms of the model."""
    result: np.ndarray = new.left_by_terms > _BESIDE_TERMS
    return result


def _tested(beside: ColumnProducts, families: Sequence[ColumnFamily], new: Sequence[New]) -> list[Tested]:
    most = [family.most**2 * beside.freedom / beside.square for family in families]
    groups = [principal(each.normal, each.score) for each in new]
    found = likeliest_of_each(groups, beside.square, beside.freedom, most)
    each = zip(families, new, groups, found, strict=True)
    return [Tested(family, own, group, best.gain, own) for family, own, group, best in each]


def _informative(beside: ColumnProducts, motion: WindowMotion, tested: Tested) -> Tested:
    """Where the data speak for the family: without the columns that are terms, or that the gyroscope's noise makes up.

    That noise is in the residual as well, so that the score of such a column is biased. It moves the parameters all the
    same, with the amplitude that it has by its odds, or that the others show.
    """
    family, more = tested.family, _beside_terms(tested.new)
    if tested.gain < _SAYS or (more.all() and not (family.from_rate or family.mixed)):
        return tested
    if more.all() and family.mixed:
        return _without_noisy_mixtures(beside, motion, tested)
    columns, kept = family.columns_of(motion).dense, more
    if family.from_rate:
        noise = beside.of(columns.less(family.columns_of(motion.noisier).dense)).normal.diagonal()
        kept = more & (noise < _NOISE_SHARE * tested.new.normal.diagonal())
    if kept.all():
        return tested
    moving = tested.new if more.all() else beside.of(columns.only(more))
    return _tested(beside, [family], [beside.of(columns.only(kept))])[0]._replace(moving=moving)


def _without_noisy_mixtures(beside: ColumnProducts, motion: WindowMotion, tested: Tested) -> Tested:
    """As `_informative`, without mixtures of columns that the gyroscope's noise makes up."""
    family, columns = tested.family, tested.family.columns_of(motion).dense
    noise = beside.of(columns.less(family.columns_of(motion.noisier).dense)).normal
    value, axes, _ = tested.principal
    kept = np.einsum("ki,kl,li->i", axes, noise, axes) < _NOISE_SHARE * value
    if kept.all():
        return tested
    some = axes[:, kept] @ axes[:, kept].T
    new = tested.new
    told = New(
        some @ new.normal @ some, new.score @ some, new.explained @ some, lambda: columns.mixed(some), beside
    )
    return _tested(beside, [family], [told])[0]._replace(moving=new)
