"""Marginalisation of the past of a chain onto θ and the direction of its last window.

A `Marginal` is a quadratic cost on θ (16, which always includes a misalignment, so that it can be estimated at any
time) and the tangent (2) of the last window's direction. The direction is stored as that window's mean field
direction in the sensor frame, M g, which does not depend on the world frame in which the gyroscope was integrated, so
that the chain can continue in another frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, begin, descend
from magyc_gtsam.estimators.smoother.noise_levels import adapt
from magyc_gtsam.estimators.smoother.skew import SkewPriorFact, with_angles
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, SKEW, WITH_SKEW, ChainState, Weights, iron_matrix
from magyc_gtsam.factors.chain.directions import QuadraticPrior
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rotations import Array, cross

_UNMEASURED = 1e-3  # factor of the first window's `window_scale`, since the marginal already contains its field
HARD_IRON = slice(6, 9)
BIAS = slice(9, 12)


class Marginal(NamedTuple):
    """The cost ½ xᵀ information x + gradientᵀ x of x = (θ − parameters, tangent of the last direction).

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
        """The θ of least cost at the present misalignment: (13,) if that is 0, otherwise (16,)."""
        rows = np.r_[:PARAMETERS, WITH_SKEW : WITH_SKEW + 2]
        information = self.information[np.ix_(rows, rows)]
        scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * scale * scale[:, None]
        away = -scale * np.linalg.solve(scaled + 1e-12 * np.eye(len(scale)), scale * self.gradient[rows])
        result = self.parameters.copy()
        result[:PARAMETERS] += away[:PARAMETERS]
        return result if result[SKEW].any() else result[:PARAMETERS]

    def forget(self, rows: slice) -> Marginal:
        """Return the marginal after these parameters are marginalised, without any information on them."""
        result = self.widen(rows, np.inf)
        kept = np.ones(len(self.gradient))
        kept[rows] = 0.0  # what rounding leaves of it would be knowledge
        return result._replace(
            information=result.information * np.outer(kept, kept), gradient=result.gradient * kept
        )

    def changed(self, columns: Array) -> Marginal:
        """Return the marginal after a change by `columns` (18, k), each of standard deviation one."""
        onto = self.information @ columns
        inside = np.eye(columns.shape[1]) + columns.T @ onto
        gain = np.linalg.solve(inside, onto.T).T
        return self._replace(
            information=_symmetric(self.information - gain @ onto.T),
            gradient=self.gradient - gain @ (columns.T @ self.gradient),
        )

    def widen(self, rows: slice, sigma: float) -> Marginal:
        """Return the marginal after a random walk of parameters by `sigma` each."""
        if sigma == 0.0:
            return self
        information, gain = widened(self.information, rows, sigma)
        return self._replace(information=information, gradient=self.gradient - gain @ self.gradient[rows])


def widened(information: Array, rows: slice, sigma: float) -> tuple[Array, Array]:
    """Return the information after a random walk of parameters by `sigma` each, and the gradient's gain.

    The gain times the gradient of these parameters is to be subtracted from the gradient.
    """
    cross, block = information[:, rows], information[rows, rows]
    # Λ' = Λ − Λ_w (Λ_ww + Q⁻¹)⁻¹ Λ_w, scaled, because fields are of order 1e-6 and rates of 1e-3.
    scale = 1 / np.sqrt(np.maximum(np.diag(block), 1e-300))
    inner = block * scale * scale[:, None] + np.diag(scale**2 / sigma**2 + 1e-14)
    gain = (cross * scale) @ np.linalg.inv(inner) * scale
    return _symmetric(information - gain @ cross.T), gain


@dataclass(frozen=True, eq=False)
class ContinuedChain(FieldChain):
    """A field chain whose first window is the last one of `past`, the marginal of all windows before."""

    past: Marginal | None = None
    origin: tuple[Array, Array] = field(
        init=False
    )  # the past's last direction and its tangents, in this chain's frame

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.past is not None:
            self.window_scale[0] *= _UNMEASURED
            mean = self.rotation(self.past.parameters)[:, :, 0]
            solved = np.linalg.solve(mean, np.column_stack([self.past.body, self.past.tangent]))
            object.__setattr__(self, "origin", (solved[:, 0], solved[:, 1:]))

    @property
    def window_sigma(self) -> Array:
        """The standard deviation (n,) T of each window's mean field, including the first."""
        sigma = 1 / self.window_scale
        if self.past is not None:
            sigma[0] *= _UNMEASURED
        return sigma

    def known(self, state: ChainState, basis: Array) -> QuadraticPrior | None:
        """Return the past as a prior on θ and on the first direction of this chain."""
        if self.past is None:
            return None
        size = len(state.parameters)
        rows = np.r_[:size, WITH_SKEW : WITH_SKEW + 2]
        slope = self.past.gradient + self.past.information @ self.away(state)
        onto = np.eye(size + 2)
        onto[size:, size:] = self.origin[1].T @ basis[:, :, 0]
        information = self.past.information[np.ix_(rows, rows)]
        return QuadraticPrior(self.past_cost(state), _symmetric(onto.T @ information @ onto), onto.T @ slope[rows])

    def part(self, first: int, stop: int) -> ContinuedChain:
        """See `FieldChain.part`; only a part from the first window has the past."""
        return replace(self, windows=self.windows.part(first, stop), past=None if first else self.past)

    def seen(self, parameters: Array) -> Array:
        """Return the reading (3, 3, n) T of each window per unit of a field fixed in the world."""
        return np.einsum("ij,jkn->ikn", iron_matrix(parameters), self.rotation(parameters))

    def turned(self, state: ChainState) -> Array:
        """Return the change (3, 3, n) T of each window per rad of a rotation of the magnetometer about each axis."""
        field = np.einsum("ijn,jn->in", self.rotation(state.parameters), state.direction)
        across = cross(np.eye(3)[:, :, None], field[:, None])
        return np.einsum("ij,jkn->ikn", iron_matrix(state.parameters), across)

    def past_cost(self, state: ChainState) -> float:
        """Return the cost of the past at `state`, relative to the point of its marginal."""
        if self.past is None:
            return 0.0
        away = self.away(state)
        return float(self.past.gradient @ away + 0.5 * away @ self.past.information @ away)

    def marginalise(self, state: ChainState, weights: Weights, last: int) -> Marginal:
        """Return the marginal of the windows up to `last` (and the past) for a chain of the following windows."""
        part = self.part(0, last + 1)
        state = ChainState(with_angles(state.parameters), state.direction[:, : last + 1])
        state, reduced = part.settle(state, Weights(weights.window[: last + 1], weights.link[:last]))
        # The last direction is eliminated last, so its corner of the factor is its Schur complement.
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

    def away(self, state: ChainState) -> Array:
        """Return x (18,) of `state`, relative to the marginal's point."""
        assert self.past is not None
        direction, tangent = self.origin
        return np.concatenate(
            [with_angles(state.parameters) - self.past.parameters, tangent.T @ (state.direction[:, 0] - direction)]
        )


def continued(fit: Fit) -> ContinuedChain:
    """Return the chain of a fit as a `ContinuedChain`, without the prior of a misalignment, which is not a fact."""
    chain = fit.chain
    facts = tuple(fact for fact in chain.facts if not isinstance(fact, SkewPriorFact))
    if isinstance(chain, ContinuedChain):
        return replace(chain, facts=facts)
    return ContinuedChain(chain.windows, chain.noise, facts=facts)


def fitted(chain: FieldChain, parameters: Array, free: np.ndarray, reject: bool = True) -> Fit:
    """Return the fit of a chain from θ (p,), of which `free` (p,) are estimated, at the chain's noise levels.

    With `reject` windows and links that do not fit are down-weighted.
    """
    return adapt(descend(begin(chain, parameters, free), NEAR), reject, None)


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)
