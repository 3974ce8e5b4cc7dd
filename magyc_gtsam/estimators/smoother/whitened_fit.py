"""The whitened quantities of a fit at its minimum: factor of the directions, estimated columns and residual."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.estimated import Estimated
from magyc_gtsam.estimators.smoother.minimum import Minimum
from magyc_gtsam.factors.chain.banded import UnitFactor, forward_solved
from magyc_gtsam.factors.chain.rotations import Array


class WhitenedResidual(NamedTuple):
    """The whitened residual, laid out as a column of `ColumnScore`.

    Shapes: window (3n,), link (3n − 3,), absorbed (2n,), explained (free,).
    """

    window: Array
    link: Array
    absorbed: Array
    explained: Array


@dataclass(frozen=True, eq=False)
class WhitenedFit:
    """The whitened quantities of a fit at its minimum; see `ColumnProducts`."""

    fit: Minimum

    @cached_property
    def freedom(self) -> float:
        """Degrees of freedom of the residual; windows and links count by their robust weights."""
        fit = self.fit
        weights = fit.weights.window.sum() * 3 + fit.weights.link[fit.chain.windows.linked].sum() * 2
        return float(max(weights - 2 * len(fit.chain.windows) - self.estimated.free.sum(), 1.0))

    @cached_property
    def square(self) -> float:
        """rᵀ P r, the residual sum of squares; the values of terms with a prior are residuals, too."""
        left, terms = self.left, self.fit.terms
        square = np.vdot(left.window, left.window) + np.vdot(left.link, left.link)
        square += 0.0 if terms is None else terms.precision @ terms.value**2
        return float(square - left.absorbed @ left.absorbed - left.explained @ left.explained)

    @cached_property
    def factor(self) -> UnitFactor:
        """L, the factor of the directions' matrix."""
        return UnitFactor.of(self.fit.reduced.factor)

    @cached_property
    def left(self) -> WhitenedResidual:
        """The whitened residual."""
        fit = self.fit
        residuals = fit.residuals
        window = residuals.window * self._residual_scale
        link = residuals.link * self.link_scale
        absorbed = forward_solved(self.factor, self.border(1, window[None], link[None]))[0]
        own = self.estimated
        pull = own.window.reshape(len(own.free), -1) @ window.ravel() - own.half @ absorbed
        pull[own.linked] += own.link @ link.ravel()
        pull += own.pull
        return WhitenedResidual(
            window.ravel(), link.ravel(), absorbed, self.estimated.explained(pull[:, None])[:, 0]
        )

    @cached_property
    def window_scale(self) -> Array:
        """(n,) or (3, n) 1/T, the factor that whitens columns of the windows."""
        bend = self.fit.chain.bend
        return self._residual_scale if bend is None else bend.answer * self._residual_scale

    @cached_property
    def _residual_scale(self) -> Array:
        """(n,) 1/T, the factor that whitens residuals of the windows."""
        result: Array = np.sqrt(self.fit.weights.window) * self.fit.chain.window_scale
        return result

    @cached_property
    def link_scale(self) -> Array:
        """(n − 1,) 1/rad, the factor that whitens columns and residuals of the links."""
        return np.sqrt(self.fit.weights.link) * self.fit.chain.link_scale

    @cached_property
    def estimated(self) -> Estimated:
        """The columns of θ and of the terms of the model."""

        def absorb(count: int, window: Array, link: Array) -> Array:
            return forward_solved(self.factor, self.border(count, window, link))

        return Estimated.of(self.fit, self._residual_scale, self.link_scale, absorb)

    def border(self, count: int, window: Array | None, link: Array | None) -> Array:
        """Return the products (k, 2, n) of the directions' Jacobian with whitened columns."""
        reduced = self.fit.reduced
        border = np.zeros((count, 2, reduced.basis.shape[2]))
        if window is not None:
            np.einsum("ian,kin->kan", reduced.on_direction, window, out=border)
        if link is not None:
            border[:, :, 1:] += np.einsum("ian,kin->kan", reduced.after, link)
            border[:, :, :-1] += np.einsum("ian,kin->kan", reduced.before, link)
        return border
