"""Inputs and results of a field chain: noise levels, states, weights, residuals and the reduced normal equations.

See `field_chain`; n is the number of windows, p the number of parameters θ.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.banded import BandFactor, backward_solved, inverse_blocks
from magyc_gtsam.factors.chain.rotations import Array, exponential_matrix
from magyc_gtsam.factors.chain.vech import unvech

PARAMETERS = 13  # vech(B) 6, h 3, b 3, τ 1
DELAY = 12
SKEW = slice(13, 16)  # ε, in a θ of `WITH_SKEW` entries
WITH_SKEW = 16


class SensorNoise(NamedTuple):
    """Standard deviations per sample and axis: magnetometer T, gyroscope rad/s."""

    magnetometer: float
    gyroscope: float


class ChainState(NamedTuple):
    """θ (p,), p = 13 or 16, and the directions g (3, n)."""

    parameters: Array
    direction: Array


class Weights(NamedTuple):
    """Robust weights in [0, 1] of the windows (n,) and of the links (n − 1,)."""

    window: Array
    link: Array


class Residuals(NamedTuple):
    """Unwhitened residuals: windows (3, n) T, links (3, n − 1) chordal."""

    window: Array
    link: Array


class Reduced(NamedTuple):
    """The normal equations after elimination, with the quantities that a step and the diagnostics need.

    cost: half the weighted sum of squares at the state; information (p, p): Schur complement on θ; gradient (p,): of
    the reduced cost; basis (3, 2, n): bases of the tangent planes; on_direction (3, 2, n) and on_parameters (p,
    3, n): whitened Jacobians of the windows; before, after (3, 2, n − 1) and on_bias (3, 3, n − 1), with the bias
    along the second axis: those of the links; band (4, 2n): the matrix of the directions, and band_factor its
    Cholesky factor L; half (2n, p + 1): L⁻¹ of its border with θ and of the directions' gradient.
    """

    cost: float
    information: Array
    gradient: Array
    basis: Array
    on_direction: Array
    before: Array
    after: Array
    on_parameters: Array
    on_bias: Array
    band: Array
    band_factor: BandFactor
    half: Array

    def absorbed(self, covariance: Array) -> float:
        """Return the expected part of the windows' squared residuals that the fit absorbs.

        It is the trace of the windows' block of the hat matrix; `covariance` (p, p) is the inverse of the information
        (zeros for fixed parameters).
        """
        if compiled.loops:
            factor = self.band_factor
            return float(
                compiled.loops.absorbed(
                    self.basis.shape[2],
                    factor.columns,
                    factor.inverse,
                    *map(compiled.given, (self.on_direction, self.on_parameters, self.half[:, :-1].T, covariance)),
                )
            )
        s00, s01, s11 = inverse_blocks(self.band, self.factor)
        j0, j1 = self.on_direction[:, 0], self.on_direction[:, 1]
        inner = np.vdot((j0 * j0).sum(axis=0), s00) + np.vdot((j1 * j1).sum(axis=0), s11)
        inner += 2 * np.vdot((j0 * j1).sum(axis=0), s01)
        across = self.on_parameters - np.einsum("ian,pan->pin", self.on_direction, self._solved)
        flat = across.reshape(len(covariance), -1)
        return float(inner + np.vdot(covariance, flat @ flat.T))

    @property
    def direction_slopes(self) -> Array:
        """dg/dθ (p, 3, n) with every direction optimal for θ: −T H⁻¹ C."""
        slopes: Array = -np.einsum("ian,pan->pin", self.basis, self._solved)
        return slopes

    @property
    def factor(self) -> Array:
        """L (4, 2n), in lower form with the diagonal first."""
        return self.band_factor.columns.T

    @property
    def _solved(self) -> Array:
        """H⁻¹ C (p, 2, n)."""
        return backward_solved(self.band_factor, self.half[:, :-1].T)


def iron_matrix(parameters: Array) -> Array:
    """Return B (3, 3) in T at θ: the reading is B u + h for the field's direction u in the gyroscope's axes."""
    soft_iron = unvech(parameters[:6])
    return soft_iron if len(parameters) == PARAMETERS else soft_iron @ skew_rotation(parameters)


def skew_rotation(parameters: Array) -> Array:
    """Return Exp(ε), from the gyroscope's axes to the magnetometer's."""
    return exponential_matrix(parameters[SKEW])
