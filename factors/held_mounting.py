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
blocks has doubled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.free_fit import FreeFit
from magyc_gtsam.factors.held import Held, HeldLimits
from magyc_gtsam.factors.variables import Array


@dataclass(frozen=True)
class MountingLimits(HeldLimits):
    """Limits of the test of a held mounting.

    Attributes:
        share: largest information of a block relative to that of the solver, which contains it, along any direction.
            It exceeds 1 where a solver has linearised its Python factors elsewhere: by 0.12 on a graph whose heading
            is known, by hundreds while it turns. Such a block is left out.
        lever: rad/rad, largest entry of D on an attitude. In a graph whose tilt is not determined D would grow without
            bound; it then starts at zero again.
    """

    prior: float = math.radians(2.0)
    least: float = math.radians(0.5)
    share: float = 1.01
    lever: float = 10.0


class HeldMounting(Held):
    """The evidence for a turned mounting θ, accumulated block by block.

    Attributes:
        shift: (p, 3) D of the last block's keys.
        sigma: (3,) rad, standard deviations with which the last solution of the graph determines θ, the field being
            right; None before.
    """

    def __init__(self, limits: MountingLimits) -> None:
        super().__init__(limits, 3)
        self.limits = limits
        self.shift: Array = np.zeros((0, 3))
        self._axis: Array = np.zeros(0)
        self.sigma: Array | None = None

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
    def certain(self) -> bool:
        """Whether the evidence suffices, for a turn that is large enough to be reported."""
        return super().certain and self.turn > self.limits.least

    def solved(self, fit: FreeFit | None) -> None:
        """Take over a solution of the graph with the mounting free; None where there is none."""
        self.tried()
        if fit is not None:
            self._information, self._score = fit.information[:3, :3], fit.score[:3]
            self.shift, self._axis = fit.shift[:, :3], fit.axis

    def determined(self, fit: FreeFit) -> None:
        """Take over how well a solution determines θ, whether or not it is otherwise taken over."""
        if fit.information[:3, :3].any():
            self.sigma = np.sqrt(np.diag(np.linalg.inv(fit.information[:3, :3] + np.eye(3) / np.pi**2)))

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
