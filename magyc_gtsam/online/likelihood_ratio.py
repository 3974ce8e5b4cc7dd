"""Compute the likelihood ratio of a step in hard iron for all times at once (see `online.change_point`)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dtbtrs

from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.factors.chain.chain_values import ChainState, Reduced, Weights
from magyc_gtsam.factors.chain.field_chain import PARAMETERS
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.online.marginal import ContinuedChain

_FINEST = 24  # parts into which a window is divided
_UNLIKELY = 20.0  # λ below the largest from which a window is not divided
_BEFORE, _AFTER = 3, 3  # least windows before and after the step


@dataclass(frozen=True, eq=False)
class StepProfile:
    """The linearised problem with a step Δ in all windows from n on, for n from 0 to one beyond the last.

    Attributes:
        own: (n + 1, 3, 3) information of Δ before elimination.
        cross: (n + 1, p, 3) information of Δ with θ.
        border: (n + 1, 2n, 3) information of Δ with the directions, times L⁻¹.
        gradient: (n + 1, 3) gradient of Δ; like `cross` and `border` it is linear in what Δ adds to each window.
        reduced: the linearisation after elimination of the directions.
        known: (p, p) covariance of θ from it.
    """

    own: Array
    cross: Array
    border: Array
    gradient: Array
    reduced: Reduced
    known: Array

    def at_windows(self) -> tuple[Array, Array, Array]:
        """Return λ (n,) of a step before each window, the step Δ (n, 3) and its covariance (n, 3, 3)."""
        return self._solved(self.own[:-1], self.cross[:-1], self.border[:-1], self.gradient[:-1])

    def inside(self, n: int, share: Array) -> tuple[Array, Array, Array]:
        """Return the same for steps inside window n with a `share` (k,) of its samples after them."""

        def mixed(values: Array, part: Array) -> Array:
            return values[n + 1] + part.reshape(-1, *[1] * (values.ndim - 1)) * (values[n] - values[n + 1])

        return self._solved(
            mixed(self.own, share**2),
            mixed(self.cross, share),
            mixed(self.border, share),
            mixed(self.gradient, share),
        )

    def _solved(self, own: Array, cross: Array, border: Array, gradient: Array) -> tuple[Array, Array, Array]:
        # Eliminate the directions, then θ.
        half, pull = self.reduced.half[:, :-1], self.reduced.half[:, -1]
        information = own - np.einsum("nri,nrj->nij", border, border)
        cross = cross - np.einsum("nri,rp->npi", border, half)
        gradient = gradient - np.einsum("nri,r->ni", border, pull)
        information = information - np.einsum("npi,pq,nqj->nij", cross, self.known, cross)
        gradient = gradient - np.einsum("npi,pq,q->ni", cross, self.known, self.reduced.gradient)
        value, vector = np.linalg.eigh(information)
        value = np.maximum(value, 1e-9 * value[:, -1:] + 1e-300)
        covariance = np.einsum("nik,nk,njk->nij", vector, 1 / value, vector)
        step = -np.einsum("nij,nj->ni", covariance, gradient)
        return -np.einsum("ni,ni->n", step, gradient), step, covariance


def step_profile(
    chain: ContinuedChain, state: ChainState, weights: Weights, reduced: Reduced, column: Array
) -> StepProfile:
    """Return the profile of a linearised chain.

    Args:
        chain, state, weights, reduced: the chain's linearisation at `state`, which need not be a minimum.
        column: (3, 3, n) derivative of each window's field by Δ.
    """
    n = len(chain.windows)
    scale = chain.window_scale * np.sqrt(weights.window)
    column = column * scale
    residual = chain.residuals(state).window * scale
    # Border of Δ with the directions per window, times L⁻¹; a step before n applies to n and all windows after.
    border = np.zeros((n, 2, n, 3))
    every = np.arange(n)
    border[every, :, every] = np.einsum("kan,kin->nai", reduced.on_direction, column)
    border = np.cumsum(border[:, :, ::-1], axis=2)[:, :, ::-1]
    half, _ = dtbtrs(reduced.factor, border.reshape(2 * n, 3 * n), uplo="L")
    free = np.diag(reduced.information) > 0
    free[PARAMETERS:] = False  # the misalignment is held
    return StepProfile(
        own=_from(np.einsum("kin,kjn->nij", column, column)),
        cross=_from(np.einsum("pkn,kin->npi", reduced.on_parameters, column)),
        border=np.concatenate([half.reshape(2 * n, n, 3).swapaxes(0, 1), np.zeros((1, 2 * n, 3))]),
        gradient=_from(np.einsum("kn,kin->ni", residual, column)),
        reduced=reduced,
        known=Fit(chain, state, weights, reduced, free).covariance,
    )


@dataclass(frozen=True, eq=False)
class ChangeTime:
    """The time of a step.

    Attributes:
        window, share: most likely window of the step, and the share of its samples after the step.
        time, time_sigma: s, averaged over all likely times.
        value, covariance: (3,) T and (3, 3) of the step, averaged likewise.
    """

    window: int
    share: float
    time: float
    time_sigma: float
    value: Array
    covariance: Array

    def removed_from(self, chain: ContinuedChain) -> ContinuedChain:
        """Return the chain with the step subtracted from its windows."""
        field = chain.windows.field.copy()
        field[:, self.window] -= self.share * self.value
        field[:, self.window + 1 :] -= self.value[:, None]
        return replace(chain, windows=replace(chain.windows, field=field))


def change_time(chain: ContinuedChain, profile: StepProfile, colour: float) -> ChangeTime:
    """Return the time of a step, to a part of a window, from all windows that can contain it."""
    windows, coarse = chain.windows, profile.at_windows()[0]
    possible = np.arange(_BEFORE, len(windows) - _AFTER)
    at_edges = np.maximum(coarse[possible], coarse[possible + 1])
    ratios, times, steps, covariances, widths, where = [], [], [], [], [], []
    for n in possible[at_edges > at_edges.max() - _UNLIKELY * colour]:
        parts = int(min(windows.count[n], _FINEST))
        share = 1 - (np.arange(parts) + 0.5) / parts
        ratio, step, covariance = profile.inside(n, share)
        begin, end = _edge(windows.time, windows.count, n), _edge(windows.time, windows.count, n + 1)
        ratios.append(ratio)
        times.append(end - share * (end - begin))
        steps.append(step)
        covariances.append(covariance)
        widths.append(np.full(parts, (end - begin) / parts))
        where.append(np.column_stack([np.full(parts, n), share]))
    ratio, time, step, covariance, width, place = (
        np.concatenate(part) for part in (ratios, times, steps, covariances, widths, where)
    )
    likely = np.exp(0.5 * (ratio - ratio.max()) / colour) * width
    likely /= likely.sum()
    mean, value = float(likely @ time), likely @ step
    spread = float(likely @ ((time - mean) ** 2 + width**2 / 12))
    away = step - value
    best = int(np.argmax(likely))
    return ChangeTime(
        int(place[best, 0]),
        float(place[best, 1]),
        mean,
        float(np.sqrt(spread)),
        value,
        np.einsum("k,kij->ij", likely, colour * covariance + away[:, :, None] * away[:, None, :]),
    )


def _edge(time: Array, count: Array, n: int) -> float:
    """Return the time between windows n − 1 and n, whose samples are evenly spaced."""
    return float(time[n - 1] + (time[n] - time[n - 1]) * count[n - 1] / (count[n - 1] + count[n]))


def _from(values: Array) -> Array:
    """Return the sums over the first axis from each index on, and a last sum of zero."""
    return np.concatenate([np.cumsum(values[::-1], axis=0)[::-1], np.zeros((1, *values.shape[1:]))])
