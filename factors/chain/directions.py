"""The directions of a field chain at fixed θ: their residuals, Jacobians and normal equations.

See `field_chain`. A step of the directions alone needs no border with θ and costs a third of a step with it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array, tangent_frame


class DirectionEquations(NamedTuple):
    """Newton's equations of the directions at a point, which a step −x solves: band · x = gradient.

    basis (3, 2, n): bases of the tangent planes; band (2n, 4): the matrix in its lower band, diagonal first; gradient
    (2, n).
    """

    basis: Array
    band: Array
    gradient: Array

    def stepped(self, direction: Array) -> tuple[Array, float, int]:
        """Return the directions (3, n) after the step, its largest squared entry, and the row that has no factor.

        The row is 0 if all have one.
        """
        n = direction.shape[1]
        if compiled.loops:
            moved = np.empty((3, n))
            most = compiled.loops.step(n, self.band, self.gradient, self.basis, compiled.given(direction), moved)
            return moved, most, int(-most) if most < 0 else 0
        factor, failed = dpbtrf(self.band.T, lower=1)
        if failed:
            return direction, np.inf, int(failed)
        tangent, _ = dpbtrs(factor, self.gradient.T.ravel(), lower=1)
        moved = stepped(direction, self.basis, tangent)
        return moved, float(np.square(moved - direction).max()), 0


class LinearDirections(NamedTuple):
    """Whitened residuals and their Jacobians on the directions, at a linearisation point.

    frame (3, 3, n): the directions and their tangent bases; body (3, n): M g, whitened; window (3, 3, n): the
    windows' residual, then its Jacobian on the two tangents; turned (3, 3, n − 1): the frame rotated to the next
    window, whitened; link (3, 3, n − 1): the links' residual, then its Jacobian on the tangents of the following
    window; square (n − 1,): squared scale of the links.
    """

    frame: Array
    body: Array
    window: Array
    turned: Array
    link: Array
    square: Array

    @property
    def basis(self) -> Array:
        """Bases of the tangent planes (3, 2, n)."""
        return self.frame[:, 1:]

    @property
    def on_direction(self) -> Array:
        """Jacobians (3, 2, n) of the windows' residuals."""
        return self.window[:, 1:]

    @property
    def after(self) -> Array:
        """Jacobians (3, 2, n − 1) of the links' residuals on the following direction."""
        return self.link[:, 1:]

    def normal_equations(self) -> tuple[Array, Array]:
        """Return the matrix in its lower band (2n, 4), diagonal first, and the gradient (2, n)."""
        n = self.frame.shape[2]
        band = np.zeros((2 * n, 4))
        own = np.einsum("ian,ibn->abn", self.on_direction, self.window)
        # Jacobian on the preceding direction, except for its sign.
        across = np.einsum("ian,ibn->abn", self.turned[:, 1:], self.link)
        for a in (0, 1):
            diagonal = band[a::2, 0]
            diagonal[:] = own[a, 1 + a]
            diagonal[1:] += self.square  # the tangent bases are orthonormal
            diagonal[:-1] += self.square
            np.negative(across[a, 1 + a], out=band[a:-2:2, 2])
        band[::2, 1] = own[0, 2]
        np.negative(across[0, 2], out=band[:-2:2, 3])
        np.negative(across[1, 1], out=band[1:-2:2, 1])
        gradient = own[:, 0]
        gradient[:, 1:] += np.einsum("ian,in->an", self.after, self.link[:, 0])
        gradient[:, :-1] -= across[:, 0]
        return band, gradient

    def curvature(self, field: Array) -> Array:
        """Return what the sphere adds to the windows' second derivatives (n,), −(B M g) · r of whitened vectors.

        Gauss–Newton leaves it out, and converges slowly or swings where a reading is far from the model. It is at
        least minus half the smaller eigenvalue of the Gauss–Newton matrix, which so remains positive.

        Args:
            field: (3, n), of the `DirectionModel`.
        """
        first, second, residual = self.window[:, 1], self.window[:, 2], self.window[:, 0]
        one, other, mixed = (
            np.einsum("in,in->n", a, b) for a, b in ((first, first), (second, second), (first, second))
        )
        smaller = 0.5 * (one + other) - np.hypot(0.5 * (one - other), mixed)
        return np.maximum(-np.einsum("in,in->n", residual + field, residual), -0.5 * smaller)


class LinearisedSensor(NamedTuple):
    """A non-linear sensor, linearised: reads `at` + answer (F − `at`) plus a constant in the data, for F = B u + h.

    answer (3, n): ratio of a change of the reading to a change of the field, 0 where it clips; at (3, n): T.
    """

    answer: Array
    at: Array


class DirectionModel(NamedTuple):
    """The linear model of the directions for given θ, noise and weights.

    matrix (3, 3): B; rotation (3, 3, n): M; scale (n,): whitening scale of the windows; field (3, n): mean(m) − h,
    whitened; turn (3, 3, n − 1): rotation from one window to the next; link_scale (n − 1,); answer (3, n): see
    `LinearisedSensor`, None for a linear sensor.
    """

    matrix: Array
    rotation: Array
    scale: Array
    field: Array
    turn: Array
    link_scale: Array
    answer: Array | None

    def equations(self, direction: Array) -> DirectionEquations:
        """Return the equations of the directions at directions (3, n)."""
        if compiled.loops:
            n = direction.shape[1]
            result = DirectionEquations(np.empty((3, 2, n)), np.empty((2 * n, 4)), np.empty((2, n)))
            scale, field, turn, link_scale = self.scale, self.field, self.turn, self.link_scale
            inputs = (self.matrix, self.rotation, scale, field, turn, link_scale, self.answer, direction)
            compiled.loops.directions(n, *map(compiled.given, inputs), *result)
            return result
        linear = self.at(direction)
        band, gradient = linear.normal_equations()
        curvature = linear.curvature(self.field)
        band[::2, 0] += curvature
        band[1::2, 0] += curvature
        return DirectionEquations(linear.basis, band, gradient)

    def at(self, direction: Array) -> LinearDirections:
        """Linearise at directions (3, n)."""
        frame, scale = tangent_frame(direction), self.link_scale
        body = np.einsum("ijn,jkn->ikn", self.rotation, frame)
        body *= self.scale
        window = (self.matrix @ body.reshape(3, -1)).reshape(body.shape)
        if self.answer is not None:
            window *= self.answer[:, None]
        window[:, 0] -= self.field
        # e = g' − E g.
        turned = np.einsum("ijn,jkn->ikn", self.turn, frame[:, :, :-1])
        turned *= scale
        link = frame[:, :, 1:] * scale
        link[:, 0] -= turned[:, 0]
        return LinearDirections(frame, body[:, 0], window, turned, link, scale**2)


class QuadraticPrior(NamedTuple):
    """A quadratic cost on θ and the tangent of the first direction: value, information (15, 15), gradient (15,)."""

    cost: float
    information: Array
    gradient: Array

    def onto_first(self, band: Array, pull: Array) -> None:
        """Add the prior on the first direction to the normal equations of the directions."""
        band[0, 0] += self.information[-2, -2]
        band[0, 1] += self.information[-1, -2]
        band[1, 0] += self.information[-1, -1]
        pull[:, 0] += self.gradient[-2:]


def stepped(direction: Array, basis: Array, tangent: Array) -> Array:
    """Return the directions (3, n) after a step −tangent (2n,) in their tangent planes."""
    g: Array = direction - np.einsum("ian,an->in", basis, np.ascontiguousarray(tangent.reshape(-1, 2).T))
    g /= np.sqrt(np.einsum("in,in->n", g, g))
    return g
