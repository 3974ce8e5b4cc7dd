"""The past marginalised: a chain of windows, eliminated but for θ and its last direction; eighteen numbers and their
information.

A `Marginal` is a quadratic cost on θ (16, a skew with it whether or not the chain carries one, so that it can be asked
for at any time) and the tangent (2) of the last window's direction. The direction is kept as
that window's mean field direction in the sensor frame, M g, which does not depend on the world frame in which the
gyroscope was integrated; so the chain continues from it in a frame of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.skew import with_angles
from magyc_gtsam.factors.chain.directions import QuadraticPrior
from magyc_gtsam.factors.chain.field_chain import (
    PARAMETERS,
    SKEW,
    WITH_SKEW,
    ChainState,
    FieldChain,
    Weights,
    iron_matrix,
)
from magyc_gtsam.factors.chain.rotations import Array

_UNMEASURED = 1e-3  # scale of the first window's field, which the marginal holds already
HARD_IRON = slice(6, 9)
BIAS = slice(9, 12)


class Marginal(NamedTuple):
    """½ xᵀ information x + gradientᵀ x, x = (θ − parameters, tangent of the last direction).

    parameters (16,); body (3,) and tangent (3, 2): the last window's M g and M times its tangent basis;
    information (18, 18); gradient (18,).
    """

    parameters: Array
    body: Array
    tangent: Array
    information: Array
    gradient: Array

    @property
    def minimum(self) -> Array:
        """θ of least cost, the skew held where it is: (13,) where that is 0, else (16,)."""
        rows = np.r_[:PARAMETERS, WITH_SKEW : WITH_SKEW + 2]
        information = self.information[np.ix_(rows, rows)]
        scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * scale * scale[:, None]
        away = -scale * np.linalg.solve(scaled + 1e-12 * np.eye(len(scale)), scale * self.gradient[rows])
        result = self.parameters.copy()
        result[:PARAMETERS] += away[:PARAMETERS]
        return result if result[SKEW].any() else result[:PARAMETERS]

    def forget(self, rows: slice) -> Marginal:
        """Nothing is known of these parameters any more; what they say of the others is marginalised."""
        return self.widen(rows, np.inf)

    def widen(self, rows: slice, sigma: float) -> Marginal:
        """These three parameters have since walked by `sigma` each."""
        if sigma == 0.0:
            return self
        information, gain = widened(self.information, rows, sigma)
        return self._replace(information=information, gradient=self.gradient - gain @ self.gradient[rows])


def widened(information: Array, rows: slice, sigma: float) -> tuple[Array, Array]:
    """The information when three parameters have walked by `sigma` each; and what to take off the gradient per unit
    of theirs."""
    cross, block = information[:, rows], information[rows, rows]
    # Λ' = Λ − Λ_w (Λ_ww + Q⁻¹)⁻¹ Λ_w; scaled, for fields are 1e-6 and rates 1e-3.
    scale = 1 / np.sqrt(np.maximum(np.diag(block), 1e-300))
    inner = block * scale * scale[:, None] + np.diag(scale**2 / sigma**2 + 1e-14)
    gain = (cross * scale) @ np.linalg.inv(inner) * scale
    return _symmetric(information - gain @ cross.T), gain


@dataclass(frozen=True, eq=False)
class ContinuedChain(FieldChain):
    """A field chain whose first window is the last one of `past`, the marginal of all before it."""

    past: Marginal | None = None
    origin: tuple[Array, Array] = field(
        init=False
    )  # the past's last direction and its tangents in this chain's frame

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.past is not None:
            self.window_scale[0] *= _UNMEASURED
            mean = self.rotation(self.past.parameters)[:, :, 0]
            solved = np.linalg.solve(mean, np.column_stack([self.past.body, self.past.tangent]))
            object.__setattr__(self, "origin", (solved[:, 0], solved[:, 1:]))

    @property
    def window_sigma(self) -> Array:
        """(n,) T, standard deviation of a window's mean, the first one's too."""
        sigma = 1 / self.window_scale
        if self.past is not None:
            sigma[0] *= _UNMEASURED
        return sigma

    def _known(self, state: ChainState, basis: Array) -> QuadraticPrior | None:
        """The past, on θ and on the first direction as this chain sees it."""
        if self.past is None:
            return None
        size = len(state.parameters)
        rows = np.r_[:size, WITH_SKEW : WITH_SKEW + 2]
        slope = self.past.gradient + self.past.information @ self._away(state)
        onto = np.eye(size + 2)
        onto[size:, size:] = self.origin[1].T @ basis[:, :, 0]
        information = self.past.information[np.ix_(rows, rows)]
        return QuadraticPrior(self.past_cost(state), _symmetric(onto.T @ information @ onto), onto.T @ slope[rows])

    def part(self, first: int, stop: int) -> ContinuedChain:
        """See `FieldChain`; what is before `first` is in none but the first part."""
        return replace(self, windows=self.windows.part(first, stop), past=None if first else self.past)

    def seen(self, parameters: Array) -> Array:
        """(3, 3, n) T, what the windows read per unit of a field fixed in the world."""
        return np.einsum("ij,jkn->ikn", iron_matrix(parameters), self.rotation(parameters))

    def past_cost(self, state: ChainState) -> float:
        """The past's share of the cost at `state`, relative to the point of its marginal."""
        if self.past is None:
            return 0.0
        away = self._away(state)
        return float(self.past.gradient @ away + 0.5 * away @ self.past.information @ away)

    def marginalise(self, state: ChainState, weights: Weights, last: int) -> Marginal:
        """The windows up to `last` (and the past) as the past of those that follow."""
        part = self.part(0, last + 1)
        state = ChainState(with_angles(state.parameters), state.direction[:, : last + 1])
        state, reduced = part.settle(state, Weights(weights.window[: last + 1], weights.link[:last]))
        # The last direction comes last in the elimination: its corner of the factor is its Schur complement.
        corner = np.array([[reduced.factor[0, -2], 0.0], [reduced.factor[1, -2], reduced.factor[0, -1]]])
        last_rows = np.concatenate([reduced.half[-2:, :WITH_SKEW], corner.T], axis=1)  # (2, 18)
        pull = reduced.half[-2:, WITH_SKEW]
        information, gradient = last_rows.T @ last_rows, last_rows.T @ pull
        information[:WITH_SKEW, :WITH_SKEW] += reduced.information
        gradient[:WITH_SKEW] += reduced.gradient
        mean = part.rotation(state.parameters)[:, :, -1]
        return Marginal(
            state.parameters, mean @ state.direction[:, -1], mean @ reduced.basis[:, :, -1], information, gradient
        )

    def _away(self, state: ChainState) -> Array:
        """x of `state` (18,), seen from the marginal's point."""
        assert self.past is not None
        direction, tangent = self.origin
        return np.concatenate(
            [with_angles(state.parameters) - self.past.parameters, tangent.T @ (state.direction[:, 0] - direction)]
        )


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)
