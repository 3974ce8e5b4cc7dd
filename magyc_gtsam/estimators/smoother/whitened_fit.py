"""A field chain at its minimum in whitened form: the residual, and the columns of its parameters and terms."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.columns import EstimatedTerms, UnmodelledColumns
from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.banded import BandFactor, backward_solved, forward_solved
from magyc_gtsam.factors.chain.chain_values import ChainState, Reduced, Residuals, Weights
from magyc_gtsam.factors.chain.directions import QuadraticPrior
from magyc_gtsam.factors.chain.facts import quadratic
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.small import inverse_root
from magyc_gtsam.factors.errors import SingularError

ROUNDING = 1e-12  # ridge added to the information, as a share of the column's squared norm; rounding is 1e-15
_BIAS = np.arange(9, 12)


@dataclass(frozen=True, eq=False)
class Minimum:
    """A chain at its minimum.

    Attributes:
        chain, state, weights, reduced: the minimum and its linearisation.
        free: (p,) bool, parameters that were estimated.
        terms: parameters beyond θ, estimated jointly with it; None if there are none.
    """

    chain: FieldChain
    state: ChainState
    weights: Weights
    reduced: Reduced
    free: np.ndarray
    terms: EstimatedTerms | None = None

    @cached_property
    def trusted_share(self) -> float:
        """The mean weight of the windows."""
        return float(self.weights.window.mean())

    @cached_property
    def residuals(self) -> Residuals:
        """The residuals of windows and links."""
        return self.chain.residuals(self.state)

    @cached_property
    def whitened(self) -> tuple[Array, Array]:
        """The whitened residuals of the windows, (3, n) in the sensor's axes and (3, n) in the world's axes."""
        whitened = self.residuals.window * (np.sqrt(self.weights.window) * self.chain.window_scale)
        return whitened, np.einsum("ijn,in->jn", self.chain.windows.rotation, whitened)


@dataclass(frozen=True, eq=False)
class Estimated:
    """The p parameters of a fit.

    Attributes:
        free: (p,) bool, parameters that were estimated; all terms are.
        window: (p, 3, n) whitened Jacobians of the windows.
        linked: (q,) indices of the parameters that the links depend on.
        link: (q, 3n − 3) whitened Jacobians of the links.
        half: (p, 2n) Zᵀ of the Jacobians, as in `ColumnProducts`.
        information: (p, p) information matrix with the directions eliminated.
        pull: (p,) gradient of the priors: facts and past of the chain, and the terms' prior.
    """

    free: np.ndarray
    window: Array
    linked: np.ndarray
    link: Array
    half: Array
    information: Array
    pull: Array

    def explained(self, products: Array) -> Array:
        """Return (free, k) the whitened components along the free parameters, given products (p, k) with all.

        Their Gram matrix is what the free parameters explain of that of the columns.
        """
        result: Array = self._inverse_root @ (self._scale[:, None] * products[self.free])
        return result

    def moved(self, explained: Array) -> Array:
        """Return (p, k) the parameter changes per unit of each column, given the result of `explained`."""
        result = np.zeros((len(self.free), explained.shape[1]))
        result[self.free] = self._scale[:, None] * (self._inverse_root.T @ explained)
        return result

    @cached_property
    def _scale(self) -> Array:
        """(free,) inverse norm of each parameter's column, with its priors."""
        square = self.information.diagonal() + np.einsum("pm,pm->p", self.half, self.half)
        result: Array = 1 / np.sqrt(np.maximum(square[self.free], 1e-300))
        return result

    @cached_property
    def _inverse_root(self) -> Array:
        """(free, free) inverse Cholesky factor of the information matrix scaled by `_scale` on both sides."""
        free, scale = self.free, self._scale
        information = self.information if free.all() else self.information[np.ix_(free, free)]
        scaled = information * scale * scale[:, None]
        scaled.flat[:: len(scale) + 1] += ROUNDING
        root = inverse_root(scaled)
        if root is None:
            raise SingularError("the inverse")
        return root


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
        fit, terms = self.fit, self.fit.terms
        rows = fit.weights.window.sum() * 3 + fit.weights.link @ fit.chain.windows.linked * 2
        rows += sum(len(fact.residual(fit.state.parameters)[0]) for fact in fit.chain.facts)
        rows += 0 if terms is None else terms.columns.size
        return float(max(rows - 2 * len(fit.chain.windows) - self.estimated.free.sum(), 1.0))

    @cached_property
    def square(self) -> float:
        """rᵀ P r, the residual sum of squares, with that of facts and of terms with a prior."""
        left, fit, terms = self.left, self.fit, self.fit.terms
        square = np.vdot(left.window, left.window) + np.vdot(left.link, left.link)
        square += 2 * quadratic(fit.chain.facts, fit.state.parameters)[0]
        square += 0.0 if terms is None else terms.precision @ terms.value**2
        return float(square - left.absorbed @ left.absorbed - left.explained @ left.explained)

    @cached_property
    def factor(self) -> BandFactor:
        """L, the factor of the directions' matrix."""
        return self.fit.reduced.band_factor

    @cached_property
    def left(self) -> WhitenedResidual:
        """The whitened residual."""
        fit = self.fit
        residuals = fit.residuals
        window = residuals.window * self._residual_scale
        link = residuals.link * self.link_scale
        border = self._border(window[None], link[None])
        if self._past is not None:
            border[0, :, 0] += self._past.gradient[-2:]
        absorbed = forward_solved(self.factor, border)[0]
        own = self.estimated
        pull = own.window.reshape(len(own.free), -1) @ window.ravel() - own.half @ absorbed
        pull[own.linked] += own.link @ link.ravel()
        pull += own.pull
        return WhitenedResidual(
            window.ravel(), link.ravel(), absorbed, self.estimated.explained(pull[:, None])[:, 0]
        )

    @cached_property
    def _past(self) -> QuadraticPrior | None:
        """The past of an online chain, which pulls at θ and at the first direction."""
        return self.fit.chain.known(self.fit.state, self.fit.reduced.basis)

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
        fit, reduced, terms = self.fit, self.fit.reduced, self.fit.terms
        size, n = len(fit.free), len(fit.chain.windows)
        on_bias = np.ascontiguousarray(reduced.on_bias.swapaxes(0, 1)).reshape(3, -1)
        half = reduced.half[:, :size].T
        pull = quadratic(fit.chain.facts, fit.state.parameters)[1]
        pull += 0.0 if self._past is None else self._past.gradient[:size]
        if terms is None:
            return Estimated(fit.free, reduced.on_parameters, _BIAS, on_bias, half, reduced.information, pull)
        count, (own_window, own_link) = terms.columns.size, terms.columns[:2]
        window = np.zeros((count, 3, n)) if own_window is None else own_window * self._residual_scale
        link = np.zeros((count, 3, n - 1)) if own_link is None else own_link * self.link_scale
        absorbed = self.absorbed(window, link)
        flat, flat_link = window.reshape(count, -1), link.reshape(count, -1)
        across = reduced.on_parameters.reshape(size, -1) @ flat.T - half @ absorbed.T
        across[_BIAS] += on_bias @ flat_link.T
        square = flat @ flat.T + flat_link @ flat_link.T - absorbed @ absorbed.T + np.diag(terms.precision)
        return Estimated(
            np.append(fit.free, np.ones(count, dtype=bool)),
            np.concatenate([reduced.on_parameters, window]),
            np.append(_BIAS, np.arange(size, size + count)),
            np.concatenate([on_bias, flat_link]),
            np.concatenate([half, absorbed]),
            np.block([[reduced.information, across], [across.T, square]]),
            np.append(pull, terms.precision * terms.value),
        )

    def whiten(self, columns: UnmodelledColumns) -> tuple[Array | None, Array | None, Array]:
        """Return columns whitened: of the windows (k, 3n) and of the links (k, 3n − 3), if any, and Zᵀ (k, 2n)."""
        columns = columns.on_all_axes
        if compiled.loops is None:
            window = None if columns.window is None else columns.window * self.window_scale
            link = None if columns.link is None else columns.link * self.link_scale
            flat = (None if part is None else part.reshape(len(part), -1) for part in (window, link))
            return *flat, self.absorbed(window, link)  # type: ignore[return-value]
        count, n = columns.size, len(self.fit.chain.windows)
        window, link = (None if part is None else np.empty((count, part[0].size)) for part in columns[:2])
        absorbed = np.empty((count, 2 * n))
        inputs = columns.window, columns.link, *self._whitening, window, link
        compiled.loops.whiten(n, *map(compiled.given, inputs), absorbed)
        return window, link, absorbed

    @cached_property
    def _whitening(self) -> tuple[Array, ...]:
        """Scales, Jacobians and factor, contiguous."""
        reduced, factor = self.fit.reduced, self.factor
        parts = (self.window_scale, self.link_scale, reduced.on_direction, reduced.before, reduced.after)
        return *map(np.ascontiguousarray, parts), factor.columns, factor.inverse

    def beside_directions(self, half: Array, window: Array, link: Array) -> tuple[Array, Array]:
        """Return whitened columns (k, 3n) of windows and (k, 3n − 3) of links less what the directions explain of them.

        `half` is their Zᵀ (k, 2n); the columns are overwritten.
        """
        reduced, n = self.fit.reduced, len(self.fit.chain.windows)
        if compiled.loops:
            _, _, *jacobians, columns, inverse = self._whitening
            compiled.loops.beside_directions(n, columns, inverse, *jacobians, half, window, link)
            return window, link
        solved = backward_solved(self.factor, half)
        window -= np.einsum("ian,kan->kin", reduced.on_direction, solved).reshape(window.shape)
        link -= np.einsum("ian,kan->kin", reduced.before, solved[:, :, :-1]).reshape(link.shape)
        link -= np.einsum("ian,kan->kin", reduced.after, solved[:, :, 1:]).reshape(link.shape)
        return window, link

    def absorbed(self, window: Array | None, link: Array | None) -> Array:
        """Return Zᵀ (k, 2n) of whitened columns (k, 3, n) of windows and (k, 3, n − 1) of links."""
        return forward_solved(self.factor, self._border(window, link))

    def _border(self, window: Array | None, link: Array | None) -> Array:
        """Return the products (k, 2, n) of the directions' Jacobian with whitened columns."""
        reduced, count = self.fit.reduced, len(link if window is None else window)  # type: ignore[arg-type]
        border = np.zeros((count, 2, reduced.basis.shape[2]))
        if window is not None:
            np.einsum("ian,kin->kan", reduced.on_direction, window, out=border)
        if link is not None:
            border[:, :, 1:] += np.einsum("ian,kin->kan", reduced.after, link)
            border[:, :, :-1] += np.einsum("ian,kin->kan", reduced.before, link)
        return border
