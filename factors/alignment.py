"""Coarse alignment: hold magnetometer blocks back until the graph's heading agrees with the one they imply.

A quadratic that is linearised at a heading far from the truth holds the graph there. Before any block enters, the
profile over the heading (`chain/heading_profile.py`) therefore gives the probability of the graph's heading error.
Blocks enter where the profile finds the heading near the truth, or where the profile is undecided and the graph's own
heading is certain enough; until then they wait. Where profile and graph contradict each other for several blocks in a
row, blocks that have entered are withdrawn. Where the profile finds the heading far off, a native prior on the
rotation, which GTSAM relinearises by itself, turns the graph (`heading_pull.py`); the prior is removed once the graph
has followed, or where the other factors contradict it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import gtsam
import numpy as np

from magyc_gtsam.factors.chain.heading_profile import HeadingProfile, block_rows, heading_profile, in_world
from magyc_gtsam.factors.heading_pull import rotation_of
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.variables import Array


@dataclass(frozen=True)
class AlignmentLimits:
    """Limits of the verdict on the graph's heading, each measured on vehicles of `benchmarks/slam_health.py starts`.

    Attributes:
        near: rad, heading error from which quadratics that are renewed still converge.
        sure: smallest probability of a heading error below `near` for the verdict "near".
        far: smallest probability of a heading within `peak` of the best one for the verdict "far", where "near" is
            not sure.
        peak: rad, half width of the interval around the best heading.
        apart: probability of "near" below which the graph's heading contradicts the blocks, even where they do not
            determine the heading yet.
        persistence: number of consecutive blocks needed for the verdict "far", and for withdrawing blocks on a
            contradiction.
        confident: rad, standard deviation of the graph's own heading below which blocks enter while the profile is
            undecided.
        steady: rad, turn by further Gauss–Newton steps below which that heading has settled.
        pull: rad, standard deviation about the vertical of the prior that turns the graph; about the other axes it is
            1 rad.
        resisted: number of consecutive blocks at which the other factors contradict the prior until it is removed.
        blocks: largest number of blocks kept for the profile.
    """

    near: float = np.radians(25.0)
    sure: float = 0.95
    far: float = 0.99
    peak: float = np.radians(20.0)
    apart: float = 0.01
    persistence: int = 3
    confident: float = np.radians(15.0)
    steady: float = np.radians(3.0)
    pull: float = np.radians(2.0)
    resisted: int = 10
    blocks: int = 200


class HeadingVerdict(str, Enum):
    """The verdict of a heading profile on the graph's heading."""

    UNDECIDED = "undecided"
    NEAR = "near"
    APART = "apart"  # the graph's heading is not near the true one, which is not determined yet
    FAR = "far"


@dataclass(frozen=True, eq=False)
class _Kept:
    """The part of a block that the heading profile needs."""

    details: BlockDetails
    rows: Array


class CoarseAlignment:
    """The profile over the heading from all blocks so far, evaluated at the graph's present attitudes.

    Attributes:
        profile: the latest profile; None before the first verdict.
        apart: number of consecutive verdicts that found the graph's heading not near.
    """

    def __init__(self, limits: AlignmentLimits) -> None:
        self.limits = limits
        self.profile: HeadingProfile | None = None
        self._blocks: list[_Kept] = []
        self._far = self.apart = self._unjudged = 0

    def __len__(self) -> int:
        return len(self._blocks)

    def add(self, details: BlockDetails) -> None:
        """Add a block, unless the largest number of blocks is reached."""
        self._unjudged += 1
        block, unit = details.block, details.field_unit
        if len(self._blocks) < self.limits.blocks:
            self._blocks.append(
                _Kept(details, block_rows(block.design[:, :, :3], block.share, block.field / unit))
            )

    @property
    def last(self) -> BlockDetails:
        """The newest block."""
        return self._blocks[-1].details

    @property
    def full(self) -> bool:
        """Whether the largest number of blocks is reached."""
        return len(self._blocks) >= self.limits.blocks

    @property
    def due(self) -> bool:
        """Whether a verdict is due: at each of the first 20 blocks, later after a tenth as many blocks as are kept."""
        return len(self._blocks) <= 20 or 10 * self._unjudged >= len(self._blocks)

    @property
    def attitudes(self) -> list[int]:
        """The keys of the attitudes, oldest first."""
        return [kept.details.attitude_key for kept in self._blocks]

    @property
    def needed(self) -> list[int]:
        """The keys of the attitudes, followed by those of the fields that are variables."""
        found = self.attitudes
        return list(
            dict.fromkeys(found + [d.details.field_key for d in self._blocks if d.details.field_key is not None])
        )

    def drop(self, gone: Sequence[int]) -> None:
        """Remove the blocks whose attitude keys have left the solver."""
        lost = set(gone)
        self._blocks = [kept for kept in self._blocks if kept.details.attitude_key not in lost]

    def judge(self, point: gtsam.Values, mean: Array, information: Array) -> HeadingVerdict:
        """Compute the profile at the attitudes in `point` and return its verdict on the heading.

        Args:
            point: values of the keys `needed`.
            mean, information: (9,) and (9, 9) of the prior on soft and hard iron.
        """
        self._unjudged = 0
        rotations = [rotation_of(point, kept.details.attitude_key) for kept in self._blocks]
        last = self._blocks[-1].details
        if last.field_key is not None:
            field = point.atPoint3(last.field_key)
        else:
            assert last.field is not None
            field = last.field / last.field_unit
        self.profile = heading_profile(
            np.vstack(
                [in_world(kept.rows, rotation) for kept, rotation in zip(self._blocks, rotations, strict=True)]
            ),
            field,
            last.sigma / last.field_unit,
            sum(kept.details.block.samples for kept in self._blocks),
            len(self._blocks),
            mean,
            information,
        )
        limits, best = self.limits, self.profile.best
        near = self.profile.within(limits.near)
        # A best heading just inside `near`, 18 to 25° off, counts too: "near" never becomes sure there.
        far = self.profile.within(limits.peak, best) >= limits.far
        self._far = self._far + 1 if far and near < limits.sure else 0
        self.apart = self.apart + 1 if near < limits.apart else 0
        if near >= limits.sure:
            return HeadingVerdict.NEAR
        if self._far >= limits.persistence:
            return HeadingVerdict.FAR
        return HeadingVerdict.APART if self.apart else HeadingVerdict.UNDECIDED
