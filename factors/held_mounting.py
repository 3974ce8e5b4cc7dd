"""Test of the mounting that blocks hold, without making it a variable of the graph.

Where the true mounting is ᵇRₛ Exp(θ) and the graph holds ᵇRₛ, the graph's estimate is biased by D θ, and the
innovation of a block with the Jacobians J on its keys and M on the mounting has the mean −G θ, G = M − J D. With the
residual r = S⁻¹ν at the estimate that includes the block, and the covariance P of its keys there, the score and
information of θ are

    −Gᵀ r    and    Gᵀ S⁻¹ G = Gᵀ G − (Jᵀ G)ᵀ P (Jᵀ G),    and D grows by P Jᵀ G

(the generalised likelihood ratio of Willsky and Jones, 1976). Innovations are independent, so both may be summed over
blocks for any D: where D is only nearly right, the test loses power but stays valid. With a prior on θ they give the
evidence for a turned mounting, which at any time exceeds 1/α with a probability of at most α where the mounting is
right (Ville's inequality). D does not follow what other
factors correct between two blocks, and the sums miss most of a turn of 1°. The graph is therefore solved with the
mounting free (`free_fit.py`), which is exact, above a low threshold of the evidence, and anyway whenever the number of
blocks has grown threefold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.free_fit import FreeFit
from magyc_gtsam.factors.variables import Array


@dataclass(frozen=True)
class MountingLimits:
    """Limits of the test of a held mounting.

    Attributes:
        prior: rad, standard deviation of each angle of θ under the alternative to θ = 0.
        excess: factor by which squared innovations may exceed their expectation, for a model that is only nearly
            right.
        perhaps: evidence above which the graph is solved with the mounting free.
        first: number of blocks at which it is solved anyway: 60 blocks of 2 s determine a mounting to 0.16°.
        evidence: evidence of that solution above which the mounting counts as wrong.
        least: rad, smallest rotation that is reported.
        share: largest information of a block relative to that of the solver, which contains it, along any direction.
            It exceeds 1 where a solver has linearised its Python factors elsewhere: by 0.12 on a graph whose heading
            is known, by hundreds while it turns. Such a block is left out.
        lever: rad/rad, largest entry of D on an attitude. In a graph whose tilt is not determined D would grow without
            bound; it then starts at zero again.
        growth: factors of the number of blocks between two solutions, with and without such evidence.
    """

    prior: float = math.radians(2.0)
    excess: float = 1.3
    perhaps: float = 10.0
    first: int = 60
    evidence: float = 1e5
    least: float = math.radians(0.5)
    share: float = 1.01
    lever: float = 10.0
    growth: tuple[float, float] = (1.25, 3.0)


class HeldMounting:
    """The evidence for a turned mounting, accumulated block by block.

    Attributes:
        blocks: number of blocks so far.
        wrong: whether a solution with the mounting free has found it wrong.
        since: s, time of the block after which it first was; NaN before.
        shift: (p, 3) D of the last block's keys.
    """

    def __init__(self, limits: MountingLimits) -> None:
        self.limits = limits
        self.blocks, self.wrong, self.since = 0, False, math.nan
        self.shift: Array = np.zeros((0, 3))
        self._axis: Array = np.zeros(0)
        self._information, self._score = np.zeros((3, 3)), np.zeros(3)
        self._next, self._anyway = 0.0, float(limits.first)

    def add(self, gram: Array, axis: Array, covariance: Array, *, counts: bool) -> None:
        """Add a block.

        Args:
            gram: (p + 4, p + 4) products of the columns of [J M −r], at the estimate that includes the block.
            axis: (columns of the attitude,) tangent vector of the block's attitude for a rotation about the world's
                vertical.
            covariance: (p, p) covariance of the block's keys at that estimate.
            counts: whether the block is evidence; a block that is otherwise disturbed only updates D.
        """
        p = len(covariance)
        shift = self._carried(axis, p)
        on_keys, crossed = gram[:p, :p], gram[:p, p : p + 3]
        if np.linalg.eigvals(covariance @ on_keys).real.max() > self.limits.share:
            return
        pulled = crossed - on_keys @ shift  # Jᵀ G
        if counts:
            square = gram[p : p + 3, p : p + 3] - shift.T @ crossed - pulled.T @ shift  # Gᵀ G
            self._information = self._information + square - pulled.T @ covariance @ pulled
            self._score = self._score + gram[p : p + 3, -1] - shift.T @ gram[:p, -1]
        shift = shift + covariance @ pulled
        self.shift = (
            shift if np.abs(shift[: len(axis)]).max(initial=0.0) < self.limits.lever else np.zeros_like(shift)
        )
        self._axis = axis
        self.blocks += 1

    def _carried(self, axis: Array, columns: int) -> Array:
        """Predict D for the next block's keys: of the attitude the rotation about the vertical, of the other keys
        unchanged.
        """
        if len(self.shift) != columns:
            return np.zeros((columns, 3))
        shift, attitude = self.shift.copy(), len(axis)
        shift[:attitude] = np.outer(axis, self._axis @ self.shift[:attitude])
        return shift

    @property
    def covariance(self) -> Array:
        """Covariance (3, 3) of θ, given all blocks and its prior."""
        return np.asarray(np.linalg.inv(self._information + np.eye(3) / self.limits.prior**2))

    @property
    def mean(self) -> Array:
        """Mean (3,) of θ in rad, given all blocks and its prior."""
        return np.asarray(self.covariance @ self._score)

    @property
    def evidence(self) -> float:
        """Logarithm of the Bayes factor of θ drawn from its prior against θ = 0, given all blocks."""
        limits = self.limits
        information = np.eye(3) + limits.prior**2 * self._information / limits.excess
        score = limits.prior * self._score / limits.excess
        gained = 0.5 * float(score @ np.linalg.solve(information, score))
        return gained - 0.5 * float(np.linalg.slogdet(information)[1])

    @property
    def due(self) -> bool:
        """Whether to solve the graph with the mounting free."""
        doubtful = self.wrong or self.evidence > math.log(self.limits.perhaps)
        return self.blocks >= (self._next if doubtful else self._anyway)

    @property
    def certain(self) -> bool:
        """Whether the evidence of the last solution suffices, for a turn that is large enough to be reported."""
        enough = self.evidence > math.log(self.limits.evidence)
        return enough and bool(np.linalg.norm(self.mean) > self.limits.least)

    @property
    def error(self) -> Array | None:
        """Mean (3,) of θ in rad; None where the mounting is not wrong."""
        return self.mean if self.wrong else None

    def solved(self, fit: FreeFit | None) -> None:
        """Take over a solution of the graph with the mounting free; None where there is none."""
        self._next, self._anyway = (growth * self.blocks for growth in self.limits.growth)
        if fit is not None:
            self._information, self._score = fit.information[:3, :3], fit.score[:3]
            self.shift, self._axis = fit.shift[:, :3], fit.axis

    def conclude(self, wrong: bool, time: float) -> None:
        """Record whether the mounting is wrong, at the time in s of the last block."""
        self.wrong = wrong
        if wrong != math.isfinite(self.since):
            self.since = time if wrong else math.nan

    def considered(self, gram: Array, covariance: Array) -> tuple[Array, Array]:
        """Return the last block at the estimate with the mounting at its mean, and the mounting among the keys.

        Returns:
            Products (p + 4, p + 4) of the columns as in `add`, and the covariance (p + 3, p + 3) of the keys and θ.
        """
        p, mean, spread, shift = len(covariance), self.mean, self.covariance, self.shift
        turn = np.eye(p + 4)
        turn[:p, -1], turn[p : p + 3, -1] = shift @ mean, -mean
        crossed = -shift @ spread
        return turn.T @ gram @ turn, np.block([[covariance - crossed @ shift.T, crossed], [crossed.T, spread]])
