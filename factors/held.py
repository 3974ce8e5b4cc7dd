"""The evidence that angles which the blocks hold are wrong, and when the graph is next solved with them free."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.free_fit import FreeFit
from magyc_gtsam.factors.variables import Array


@dataclass(frozen=True)
class HeldLimits:
    """Limits of such a test.

    Attributes:
        prior: rad, standard deviation of each angle under the alternative to 0.
        least: rad, smallest rotation that is reported alone.
        excess: factor by which squared innovations may exceed their expectation, for a model that is only nearly
            right.
        perhaps: evidence above which the graph is soon solved with the angles free.
        first: number of blocks at which it is solved in any case: 60 blocks of 2 s determine a mounting to 0.16°, and
            beside a position every second the field's heading to 0.1 to 0.3°.
        early: (number of blocks, rad): where it is solved before, and for which angles: positions whose errors last for
            half a minute turned the field's heading by 7° at 30 blocks.
        gross: rad, angle of which the linear solution says no more than that it is large.
        evidence: evidence of that solution above which the angles count as wrong.
        growth: factors of the number of blocks between two solutions, with and without such evidence.
    """

    prior: float
    least: float
    excess: float = 1.3
    perhaps: float = 10.0
    first: int = 60
    early: tuple[tuple[int, float], ...] = tuple((n, math.radians(a)) for n, a in ((20, 15), (30, 10), (45, 7)))
    gross: float = math.radians(30.0)
    evidence: float = 1e5
    growth: tuple[float, float] = (1.25, 2.0)


class Held:
    """The evidence for k angles that are held at 0.

    Attributes:
        limits: of the test.
        blocks: number of blocks so far.
        wrong: whether a solution with the angles free has found them wrong.
        since: s, time of the block after which it first was; NaN before.
    """

    def __init__(self, limits: HeldLimits, count: int) -> None:
        self._limits = limits
        self.blocks, self.wrong, self.since = 0, False, math.nan
        self._information, self._score = np.zeros((count, count)), np.zeros(count)
        self._next, self._anyway, self._looked = 0.0, float(limits.first), 0

    @property
    def covariance(self) -> Array:
        """Covariance (k, k) of the angles, given all blocks and their prior."""
        return np.asarray(np.linalg.inv(self._information + np.eye(len(self._score)) / self._limits.prior**2))

    @property
    def mean(self) -> Array:
        """Mean (k,) of the angles in rad, given all blocks and their prior."""
        return np.asarray(self.covariance @ self._score)

    @property
    def turn(self) -> float:
        """Size of their mean, rad."""
        return float(np.linalg.norm(self.mean))

    @property
    def evidence(self) -> float:
        """Logarithm of the Bayes factor of angles drawn from their prior against 0, given all blocks."""
        limits = self._limits
        information = np.eye(len(self._score)) + limits.prior**2 * self._information / limits.excess
        score = limits.prior * self._score / limits.excess
        gained = 0.5 * float(score @ np.linalg.solve(information, score))
        return gained - 0.5 * float(np.linalg.slogdet(information)[1])

    @property
    def certain(self) -> bool:
        """Whether the evidence suffices."""
        return self.evidence > math.log(self._limits.evidence)

    @property
    def due(self) -> bool:
        """Whether to solve the graph with the angles free."""
        doubtful = self.wrong or self.evidence > math.log(self._limits.perhaps)
        return self.blocks >= (self._next if doubtful else self._anyway)

    @property
    def early(self) -> bool:
        """Whether to solve the graph for a large angle; asked once at each of these numbers of blocks."""
        before, self._looked = self._looked, self.blocks
        return any(before < count <= self.blocks for count, _ in self._limits.early)

    @property
    def large(self) -> float:
        """Angle (rad) that is looked for at this number of blocks, before the `first` solution."""
        reached = [angle for count, angle in self._limits.early if count <= self.blocks]
        return reached[-1] if reached else self._limits.gross

    @property
    def error(self) -> Array | None:
        """Mean (k,) of the angles in rad; None where they are not wrong."""
        return self.mean if self.wrong else None

    def solved(self, fit: FreeFit | None) -> None:
        """Take over a solution with the angles free; None where there is none."""
        raise NotImplementedError

    def gross_by(self, fit: FreeFit) -> bool:
        """Return whether a solution, which is not taken over, finds such a large angle."""
        found = copy(self)
        found.solved(fit)
        return found.certain and found.turn > self.large

    def tried(self) -> None:
        """Record that the graph was solved with the angles free, whether there is a solution or not."""
        self._next, self._anyway = (growth * self.blocks for growth in self._limits.growth)

    def conclude(self, wrong: bool, time: float) -> None:
        """Record whether the angles are wrong, at the time in s of the last block."""
        self.wrong = wrong
        if wrong != math.isfinite(self.since):
            self.since = time if wrong else math.nan
