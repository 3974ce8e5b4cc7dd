"""The linearisation of a field chain: whitened Jacobians on θ and on the directions, and the directions' equations.

See `field_chain` for the residuals. It is compiled where there was a compiler (`compiled`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpbtrf

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.banded import BandFactor, forward_solved
from magyc_gtsam.factors.chain.chain_values import (
    DELAY,
    PARAMETERS,
    SKEW,
    WITH_SKEW,
    ChainState,
    iron_matrix,
    skew_rotation,
)
from magyc_gtsam.factors.chain.directions import DirectionModel
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.rotations import Array, cross, right_jacobian, skew

_BIAS = slice(9, 12)
_ALIGNED = np.eye(3)
_ALIGNED.flags.writeable = False


class Linearised(NamedTuple):
    """A field chain linearised at a state.

    basis (3, 2, n): bases of the tangent planes; on_direction (3, 2, n): whitened Jacobians of the windows on their
    directions; before, after (3, 2, n − 1): those of the links on the directions that they join; columns (p + 1, 3, n):
    those of the windows on θ, and the residual; links (4, 3, n − 1): those of the links on the bias, and the residual;
    band (2n, 4): the matrix of the directions by lower diagonals; border (p + 1, 2, n): its border with θ, and the
    directions' gradient.
    """

    basis: Array
    on_direction: Array
    before: Array
    after: Array
    columns: Array
    links: Array
    band: Array
    border: Array

    @classmethod
    def of(cls, windows: FieldWindows, state: ChainState, sight: DirectionModel) -> Linearised:
        """Linearise at a state, given the model of the directions there."""
        return _compiled(windows, state, sight) if compiled.loops else _in_numpy(windows, state, sight)

    def eliminated(self) -> Eliminated:
        """Return what remains when the directions are eliminated."""
        size, _, n = self.columns.shape
        if compiled.loops:
            factor, inverse, absorbed = np.empty((2 * n, 4)), np.empty(2 * n), np.empty((size, 2 * n))
            products = np.zeros((size, size))
            square = compiled.loops.eliminate(
                n, self.band, self.border, self.columns, self.links, factor, inverse, absorbed, products
            )
            failed = int(-square) if square < 0 else 0
            return Eliminated(products, 0.5 * square, BandFactor(factor, inverse), absorbed, failed)
        flat, links = self.columns.reshape(size, -1), self.links.reshape(4, -1)
        products = flat @ flat.T
        rows = [9, 10, 11, size - 1]  # of the bias and of the residual
        products[np.ix_(rows, rows)] += links @ links.T
        cost = 0.5 * float(products[-1, -1])
        lower, failed = dpbtrf(self.band.T, lower=1)
        if failed:
            unknown = BandFactor(lower.T, np.empty(2 * n))
            return Eliminated(products, cost, unknown, np.empty((size, 2 * n)), int(failed))
        whole = BandFactor.of(lower)
        absorbed = forward_solved(whole, self.border)
        return Eliminated(products - absorbed @ absorbed.T, cost, whole, absorbed, 0)


class Eliminated(NamedTuple):
    """The normal equations of a linearisation after the directions are eliminated.

    products (p + 1, p + 1): those of the columns on θ and of the residual; cost: half the squared norm of the residual;
    factor: L of the band; absorbed (p + 1, 2n): L⁻¹ of the border, transposed; failed: the number of the row at which
    the band has no factor, 0 if it has one.
    """

    products: Array
    cost: float
    factor: BandFactor
    absorbed: Array
    failed: int


def _compiled(windows: FieldWindows, state: ChainState, sight: DirectionModel) -> Linearised:
    parameters, g = state
    p, n = len(parameters), g.shape[1]
    swing, axes = (_ALIGNED, None) if p == PARAMETERS else (skew_rotation(parameters), _on_skew(parameters))
    inputs = (
        sight.matrix,
        swing,
        axes,
        sight.rotation,
        sight.turn,
        windows.rotation_bias,
        windows.rotation_rate,
        windows.lever,
        sight.scale,
        sight.field,
        sight.link_scale,
        sight.answer,
        g,
    )
    shapes = (
        (3, 2, n),
        (3, 2, n),
        (3, 2, n - 1),
        (3, 2, n - 1),
        (p + 1, 3, n),
        (4, 3, n - 1),
        (2 * n, 4),
        (p + 1, 2, n),
    )
    result = Linearised(*(np.empty(shape) for shape in shapes))
    compiled.loops.linearise(n, *map(compiled.given, inputs), *result)
    return result


def _in_numpy(windows: FieldWindows, state: ChainState, sight: DirectionModel) -> Linearised:
    parameters, g = state
    p, n = len(parameters), g.shape[1]
    linear = sight.at(g)
    columns = _on_parameters(windows, state, sight, linear.body)
    columns[p] = linear.window[:, 0]
    # Links: e = g' − E g, E = Exp(−ΔK δ); −∂(E g)/∂b = [E g]× ΔK, column by column.
    links = np.empty((4, 3, n - 1))
    cross(windows.lever, linear.turned[:, 0, None], out=links[:3].swapaxes(0, 1))
    links[3] = linear.link[:, 0]
    border = np.empty((p + 1, 2, n))
    band, border[p] = linear.normal_equations()
    np.einsum("ian,pin->pan", linear.on_direction, columns[:p], out=border[:p])
    border[_BIAS, :, 1:] += np.einsum("ian,pin->pan", linear.after, links[:3])
    border[_BIAS, :, :-1] -= np.einsum("ian,pin->pan", linear.turned[:, 1:], links[:3])
    before = -linear.turned[:, 1:]
    return Linearised(linear.basis, linear.on_direction, before, linear.after, columns, links, band, border)


def _on_parameters(windows: FieldWindows, state: ChainState, sight: DirectionModel, body: Array) -> Array:
    """Return the windows' whitened Jacobian (p + 1, 3, n) on θ, r = S Exp(ε) M g + h − m, with room for r.

    `body` is M g, whitened.
    """
    parameters, g = state
    p, n = len(parameters), g.shape[1]
    matrix, whitened = iron_matrix(parameters), g * sight.scale
    x, y, z = body if p == PARAMETERS else skew_rotation(parameters) @ body
    result = np.zeros((p + 1, 3, n))
    result[0, 0] = result[1, 1] = result[2, 2] = x
    result[1, 0] = result[3, 1] = result[4, 2] = y
    result[2, 0] = result[4, 1] = result[5, 2] = z
    result[6, 0] = result[7, 1] = result[8, 2] = sight.scale
    swung = np.einsum("ijkn,jn->ikn", windows.rotation_bias, whitened)
    result[_BIAS] = (matrix @ swung.reshape(3, -1)).reshape(3, 3, n).swapaxes(0, 1)
    result[DELAY] = matrix @ np.einsum("ijn,jn->in", windows.rotation_rate, whitened)
    if p == WITH_SKEW:
        result[SKEW] = (_on_skew(parameters).reshape(9, 3) @ body).reshape(3, 3, n)
    if sight.answer is not None:
        result *= sight.answer
    return result


def _on_skew(parameters: Array) -> Array:
    """Return B [J]× (3, 3, 3), one for each entry of ε: Exp(ε + δ) v = Exp(ε) (v + J δ × v), J the right Jacobian."""
    result: Array = iron_matrix(parameters) @ skew(right_jacobian(parameters[SKEW]).T)
    return result
