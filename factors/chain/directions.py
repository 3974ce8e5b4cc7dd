"""The directions of a field chain at fixed θ: residuals, Jacobians and normal equations of their own.

See `field_chain`. A step of the directions alone costs a third of one with θ, whose border it does without.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array, tangent_basis


class LinearDirections(NamedTuple):
    """Whitened residuals and their Jacobians on the directions, linearised at some.

    basis (3, 2, n) of the tangent planes; window (3, n) and on_direction (3, 2, n); link (3, n − 1), before and
    after (3, 2, n − 1); ahead (3, n − 1): the directions turned on to the next window; square (n − 1,).
    """

    basis: Array
    window: Array
    on_direction: Array
    link: Array
    before: Array
    after: Array
    ahead: Array
    square: Array

    def normal_equations(self) -> tuple[Array, Array]:
        """The matrix in its lower band (2n, 4), diagonal first, and the gradient (n, 2)."""
        _, _, n = self.basis.shape
        on, before, after = self.on_direction, self.before, self.after
        band = np.zeros((2 * n, 4))
        own, across = np.einsum("ian,ibn->abn", on, on), np.einsum("ian,ibn->abn", before, after)
        for a in (0, 1):
            diagonal = band[a::2, 0]
            diagonal[:] = own[a, a]
            diagonal[1:] += self.square  # the tangent bases are orthonormal
            diagonal[:-1] += self.square
            band[a:-2:2, 2] = across[a, a]
        band[::2, 1] = own[0, 1]
        band[:-2:2, 3] = across[0, 1]
        band[1:-2:2, 1] = across[1, 0]
        gradient = np.einsum("ian,in->na", on, self.window)
        gradient[1:] += np.einsum("ian,in->na", after, self.link)
        gradient[:-1] += np.einsum("ian,in->na", before, self.link)
        return band, gradient


class Sight(NamedTuple):
    """What θ, the noise and the weights say of the directions.

    seen (3, 3, n): B M, whitened; field (3, n): mean(m) − h, whitened; turn (3, 3, n − 1): from one window to the
    next; link_scale (n − 1,); answer: see `FieldChain`.
    """

    seen: Array
    field: Array
    turn: Array
    link_scale: Array
    answer: Array | None

    def at(self, direction: Array) -> LinearDirections:
        """Linearised at directions (3, n)."""
        g, scale = direction, self.link_scale
        basis = tangent_basis(g)
        window = np.einsum("ijn,jn->in", self.seen, g) - self.field
        on_direction = np.einsum("ijn,jan->ian", self.seen, basis)
        if self.answer is not None:
            on_direction *= self.answer[:, None]
        # e = g' − E g.
        ahead = np.einsum("ijn,jn->in", self.turn, g[:, :-1])
        link = (g[:, 1:] - ahead) * scale
        before = -np.einsum("ijn,jan->ian", self.turn, basis[:, :, :-1]) * scale
        after = basis[:, :, 1:] * scale
        return LinearDirections(basis, window, on_direction, link, before, after, ahead, scale**2)


class QuadraticPrior(NamedTuple):
    """A quadratic cost on θ and the tangent of the first direction: value, information (15, 15), gradient (15,)."""

    cost: float
    information: Array
    gradient: Array

    def onto_first(self, band: Array, pull: Array) -> None:
        """Add what is known of the first direction to the normal equations of the directions."""
        band[0, 0] += self.information[-2, -2]
        band[0, 1] += self.information[-1, -2]
        band[1, 0] += self.information[-1, -1]
        pull[0] += self.gradient[-2:]


def stepped(direction: Array, basis: Array, tangent: Array) -> Array:
    """(3, n) directions after a step −tangent (2n,) in their tangent planes."""
    g = direction - basis[:, 0] * tangent[::2] - basis[:, 1] * tangent[1::2]
    result: Array = g / np.sqrt(np.einsum("in,in->n", g, g))
    return result
