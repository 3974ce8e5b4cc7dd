"""The estimated parameters of a fit, θ and the terms of its model, as whitened columns with directions eliminated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dtrtri

from magyc_gtsam.estimators.smoother.minimum import Minimum
from magyc_gtsam.factors.chain.rotations import Array

ROUNDING = 1e-12  # ridge added to the information, as a share of the column's squared norm; rounding is 1e-15
_BIAS = np.arange(9, 12)

Absorb = Callable[[int, Array, Array], Array]


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
        pull: (p,) gradient of the terms' prior.
    """

    free: np.ndarray
    window: Array
    linked: np.ndarray
    link: Array
    half: Array
    information: Array
    pull: Array

    @classmethod
    def of(cls, fit: Minimum, window_scale: Array, link_scale: Array, absorb: Absorb) -> Estimated:
        """Return the parameters of a fit.

        Args:
            fit: at its minimum.
            window_scale, link_scale: 1/T and 1/rad, the factors that whiten the residuals.
            absorb: returns Zᵀ (k, 2n), given k and whitened columns (k, 3, n) and (k, 3, n − 1).
        """
        reduced, size, terms = fit.reduced, len(fit.free), fit.terms
        on_bias = np.ascontiguousarray(reduced.on_bias.swapaxes(0, 1)).reshape(3, -1)
        half = reduced.half[:, :size].T
        if terms is None:
            return cls(fit.free, reduced.on_parameters, _BIAS, on_bias, half, reduced.information, np.zeros(size))
        count, (own_window, own_link), n = terms.columns.size, terms.columns, len(fit.chain.windows)
        window = np.zeros((count, 3, n)) if own_window is None else own_window * window_scale
        link = np.zeros((count, 3, n - 1)) if own_link is None else own_link * link_scale
        absorbed = absorb(count, window, link)
        flat, flat_link = window.reshape(count, -1), link.reshape(count, -1)
        across = reduced.on_parameters.reshape(size, -1) @ flat.T - half @ absorbed.T
        across[_BIAS] += on_bias @ flat_link.T
        square = flat @ flat.T + flat_link @ flat_link.T - absorbed @ absorbed.T + np.diag(terms.precision)
        return cls(
            np.append(fit.free, np.ones(count, dtype=bool)),
            np.concatenate([reduced.on_parameters, window]),
            np.append(_BIAS, np.arange(size, size + count)),
            np.concatenate([on_bias, flat_link]),
            np.concatenate([half, absorbed]),
            np.block([[reduced.information, across], [across.T, square]]),
            np.append(np.zeros(size), terms.precision * terms.value),
        )

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
        """(free,) inverse norm of each parameter's column."""
        square = np.maximum(np.einsum("pin,pin->p", self.window, self.window), np.diag(self.information))
        square[self.linked] += np.einsum("km,km->k", self.link, self.link)
        result: Array = 1 / np.sqrt(np.maximum(square[self.free], 1e-300))
        return result

    @cached_property
    def _inverse_root(self) -> Array:
        """(free, free) inverse Cholesky factor of the information matrix scaled by `_scale` on both sides."""
        free, scale = self.free, self._scale
        information = self.information[np.ix_(free, free)] * scale * scale[:, None]
        root = np.linalg.cholesky(information + ROUNDING * np.eye(len(scale)))
        result: Array = dtrtri(root, lower=1)[0]
        return result
