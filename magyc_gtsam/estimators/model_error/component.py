"""One thing that a model lacks, and columns that stand for it beside a fit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from magyc_gtsam.estimators.model_error.components import likeliest
from magyc_gtsam.estimators.model_error.families import Family
from magyc_gtsam.estimators.model_error.motion import Motion
from magyc_gtsam.estimators.smoother.beside import Beside, New
from magyc_gtsam.factors.chain.rotations import Array


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
    """A family beside a fit: its columns' products, and its gain in log-likelihood by itself."""

    family: Family
    new: New
    gain: float

    def moves(self, beside: Beside, motion: Motion) -> Array:
        """(P, k) by how much a unit of each column puts the parameters off those that hold at the end."""
        move = beside.move(self.new)
        if self.family.at_end is not None:
            there = self.family.at_end(motion)
            move[: len(there)] -= there
        return move


def tested(beside: Beside, motion: Motion, families: Iterable[Family]) -> list[Tested]:
    """Each family by itself."""
    return [_tested(beside, family, beside.of(family.columns(motion))) for family in families]


def tested_together(beside: Beside, motion: Motion, families: Sequence[Family]) -> list[Tested]:
    """The same, faster where each has few columns."""
    new = beside.of_each([family.columns(motion) for family in families])
    return [_tested(beside, *pair) for pair in zip(families, new, strict=True)]


def _tested(beside: Beside, family: Family, new: New) -> Tested:
    most = family.most**2 * beside.freedom / beside.square
    return Tested(family, new, likeliest(new.normal, new.score, beside.square, beside.freedom, most).gain)
