"""Test of the heading of the field that blocks hold, against the heading that the rest of the graph knows.

Blocks turn the graph to their field: with a wrong declination nothing else disagrees with them by much at any one time,
and innovations show nothing. Only the graph solved with the field's turn ψ free (`free_fit.py`) has the heading of all
its other factors, e.g. of positions against accelerations or odometry. Without such factors ψ keeps its prior.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from magyc_gtsam.factors.free_fit import FreeFit


@dataclass(frozen=True)
class FieldLimits:
    """Limits of the test of a held field.

    Attributes:
        prior: rad, standard deviation of ψ under the alternative to ψ = 0, that of a declination left out.
        excess: factor by which squared innovations may exceed their expectation, for a model that is only nearly
            right.
        perhaps: evidence above which the graph is soon solved again.
        first: number of blocks at which it is solved first: beside a position every second 60 blocks of 2 s determine
            ψ to 0.1 to 0.3°, and errors of positions that last half a minute turn it by less than `least`.
        evidence: evidence above which the field counts as turned.
        least: rad, smallest turn that is reported alone: positions with errors that last half a minute, of twice the
            stated size, turned ψ by 1.8°.
        growth: factors of the number of blocks between two solutions, with and without such evidence.
    """

    prior: float = math.radians(10.0)
    excess: float = 1.3
    perhaps: float = 10.0
    first: int = 60
    evidence: float = 1e5
    least: float = math.radians(2.0)
    growth: tuple[float, float] = (1.25, 3.0)


class HeldField:
    """The evidence for a turned field, from the last solution with ψ free.

    Attributes:
        blocks: number of blocks so far.
        wrong: whether a solution with the field free has found it turned.
        since: s, time of the block after which it first was; NaN before.
    """

    def __init__(self, limits: FieldLimits) -> None:
        self.limits = limits
        self.blocks, self.wrong, self.since = 0, False, math.nan
        self._information = self._score = self._next = 0.0
        self._anyway = float(limits.first)

    @property
    def mean(self) -> float:
        """Mean of ψ in rad, given its prior."""
        return self._score / (self._information + self.limits.prior**-2)

    @property
    def evidence(self) -> float:
        """Logarithm of the Bayes factor of ψ drawn from its prior against ψ = 0."""
        limits = self.limits
        information = 1.0 + limits.prior**2 * self._information / limits.excess
        score = limits.prior * self._score / limits.excess
        return 0.5 * (score**2 / information - math.log(information))

    @property
    def certain(self) -> bool:
        """Whether the evidence suffices."""
        return self.evidence > math.log(self.limits.evidence)

    @property
    def due(self) -> bool:
        """Whether to solve the graph with ψ free."""
        doubtful = self.wrong or self.evidence > math.log(self.limits.perhaps)
        return self.blocks >= (self._next if doubtful else self._anyway)

    @property
    def error(self) -> float | None:
        """Mean of ψ in rad; None where the field is not turned."""
        return self.mean if self.wrong else None

    def solved(self, fit: FreeFit | None) -> None:
        """Take over a solution with ψ free; None where there is none."""
        self._next, self._anyway = (growth * self.blocks for growth in self.limits.growth)
        if fit is not None:
            self._information, self._score = max(float(fit.information[3, 3]), 0.0), float(fit.score[3])

    def conclude(self, wrong: bool, time: float) -> None:
        """Record whether the field is turned, at the time in s of the last block."""
        self.wrong = wrong
        if wrong != math.isfinite(self.since):
            self.since = time if wrong else math.nan
