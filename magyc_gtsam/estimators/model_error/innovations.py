"""What is new to a fit in columns that its model lacks, and by how much each of them moves the parameters.

At its minimum a field chain leaves r = J δ − X β, with columns X of the reading and of the gyroscope's links that are
not in the model. The forward filter of the directions turns both into white innovations, and what is left of those
beside the parameters' own gives, as in a linear regression,

    β̂ = (W Wᵀ)⁻¹ W y,    y = −innovations of r,    and where X stays out, each unit of β moves θ by S = H⁻¹ Jᵀ X.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.factors.chain.forward_filter import ForwardFilter
from magyc_gtsam.factors.chain.rotations import Array, cross


class Columns(NamedTuple):
    """Unmodelled columns per unit: of the windows (k, 3, n) T, of the links (k, 3, n − 1) rad; None is zero."""

    window: Array | None
    link: Array | None


class New(NamedTuple):
    """Columns beside the model: rows (k, m) of innovations W, and move (P, k) S."""

    rows: Array
    move: Array


@dataclass(frozen=True, eq=False)
class Innovations:
    """The innovations of one fit at its minimum; m is 3n, and P more where something is known beside the windows."""

    fit: Fit

    @cached_property
    def residual(self) -> Array:
        """(m,) y, what the fit leaves."""
        fit = self.fit
        residuals = fit.chain.residuals(fit.state)
        innovation = -self._filtered(Columns(residuals.window[None], residuals.link[None]))[0]
        result: Array = innovation - self._basis @ (self._basis.T @ innovation)
        return result

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the residual: a window that is weighed down counts for less."""
        fit = self.fit
        weights = fit.weights.window.sum() * 3 + fit.weights.link[fit.chain.windows.linked].sum() * 2
        return float(max(weights - 2 * len(fit.chain.windows) - fit.free.sum(), 1.0))

    def of(self, columns: Columns) -> New:
        """What is new in columns."""
        rows = self._filtered(columns)
        pull = self._parameters @ rows.T
        rows -= (rows @ self._basis) @ self._basis.T
        return New(rows, self.fit.covariance @ pull)

    def _filtered(self, columns: Columns) -> Array:
        """(k, m) innovations of columns, directions eliminated."""
        window, link = columns
        n = len(self.fit.chain.windows)
        if window is None:
            assert link is not None
            window = np.zeros((len(link), 3, n))
        else:
            window = window * self._window_scale
        rows = self._filter(window, None if link is None else link * self._link_scale).reshape(len(window), -1)
        return np.concatenate([rows, np.zeros((len(rows), self._known.shape[1]))], axis=1)

    @cached_property
    def _filter(self) -> ForwardFilter:
        return ForwardFilter.of(self.fit.chain, self.fit.reduced, self.fit.weights.link)

    @cached_property
    def _window_scale(self) -> Array:
        chain = self.fit.chain
        scale = np.sqrt(self.fit.weights.window) * chain.window_scale
        return scale if chain.answer is None else chain.answer * scale

    @cached_property
    def _link_scale(self) -> Array:
        return np.sqrt(self.fit.weights.link) * self.fit.chain.link_scale

    @cached_property
    def _windows_alone(self) -> Array:
        """(P, 3n) innovations of θ's own columns."""
        fit = self.fit
        on_parameters = fit.reduced.on_parameters
        link = np.zeros((len(on_parameters), 3, len(fit.chain.windows) - 1))
        lever = -cross(fit.state.direction[:, None, :-1], fit.chain.windows.lever)
        link[9:12] = lever.swapaxes(0, 1) * self._link_scale
        return self._filter(on_parameters.copy(), link).reshape(len(on_parameters), -1)

    @cached_property
    def _known(self) -> Array:
        """(P, k) root of what is known of θ beside the windows: a prior, or a longer chain's past."""
        rows = self._windows_alone
        value, vector = np.linalg.eigh(self.fit.reduced.information - rows @ rows.T)
        kept = value > _KNOWN * max(float(value[-1]), 0.0)
        rest = value[kept].sum() > _KNOWN * np.trace(self.fit.reduced.information)
        return vector[:, kept] * np.sqrt(value[kept]) if rest else np.zeros((len(rows), 0))

    @cached_property
    def _parameters(self) -> Array:
        """(P, m) innovations of θ's columns; zero for what was not estimated."""
        return np.concatenate([self._windows_alone, self._known], axis=1) * self.fit.free[:, None]

    @cached_property
    def _basis(self) -> Array:
        """(m, free) orthonormal."""
        free = self._parameters[self.fit.free]
        free = free / np.sqrt(np.maximum(np.einsum("pm,pm->p", free, free), 1e-300))[:, None]
        for _ in range(2):  # Cholesky's orthogonalisation, and once more for what rounding left of it
            free = solve_triangular(
                np.linalg.cholesky(free @ free.T + _ROUNDING * np.eye(len(free))), free, lower=True
            )
        basis: Array = free.T
        return basis


_ROUNDING = 1e-14
_KNOWN = 1e-3  # share of the information, below which nothing is known beside the windows
