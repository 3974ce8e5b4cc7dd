"""The likelihood ratio of a step in hard iron for all times at once (see `online.change_point`)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dtbtrs

from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, ChainState, Reduced, Weights
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.online.marginal import ContinuedChain

_FINEST = 24  # parts into which a window is divided
_UNLIKELY = 20.0  # distance of λ from its maximum from which a window is not divided
_BEFORE, _AFTER = 3, 3  # fewest windows before and after the step


@dataclass(frozen=True, eq=False)
class StepProfile:
    """The linearised problem with a step Δ in all windows from n on, for n from 0 to one beyond the last.

    Directions and θ are eliminated. A step inside window n is a share of that before n and the rest of that before
    n + 1, so that its linear terms are mixed by the share and its quadratic ones by products of shares.

    Attributes:
        own: (n + 1, 3, 3) information of Δ before elimination.
        lost: (n + 1, 3, 3) information that the elimination takes.
        between: (n, 3, 3) cross term of `lost` between a step before each window and one before the next window.
        gradient: (n + 1, 3) gradient of Δ after elimination.
    """

    own: Array
    lost: Array
    between: Array
    gradient: Array

    def at_windows(self) -> tuple[Array, Array, Array]:
        """Return λ (n,) of a step before each window, the step Δ (n, 3) and its covariance (n, 3, 3)."""
        return _solved(self.own[:-1] - self.lost[:-1], self.gradient[:-1])

    def inside(self, n: Array, share: Array) -> tuple[Array, Array, Array]:
        """Return λ, Δ and its covariance for k steps inside windows n (k,), each followed by `share` (k,) of its
        samples.
        """
        after, rest = share[:, None, None], 1 - share[:, None, None]
        both = self.between[n] + self.between[n].swapaxes(1, 2)
        own = self.own[n + 1] + after**2 * (self.own[n] - self.own[n + 1])
        lost = after**2 * self.lost[n] + after * rest * both + rest**2 * self.lost[n + 1]
        gradient = share[:, None] * self.gradient[n] + (1 - share[:, None]) * self.gradient[n + 1]
        return _solved(own - lost, gradient)


def _solved(information: Array, gradient: Array) -> tuple[Array, Array, Array]:
    value, vector = np.linalg.eigh(information)
    value = np.maximum(value, 1e-9 * value[:, -1:] + 1e-300)
    covariance = (vector / value[:, None]) @ vector.swapaxes(1, 2)
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
    known = Fit(chain, state, weights, reduced, free).covariance
    # For a step before each window, and for none: Δ with the directions (n + 1, 3, 2n), times L⁻¹, and then Δ with θ.
    half = np.concatenate([half.reshape(2 * n, n, 3).transpose(1, 2, 0), np.zeros((1, 3, 2 * n))])
    cross = _from(np.einsum("pkn,kin->nip", reduced.on_parameters, column)) - half @ reduced.half[:, :-1]
    gradient = _from(np.einsum("kn,kin->ni", residual, column)) - half @ reduced.half[:, -1]
    eliminated = cross @ known
    return StepProfile(
        own=_from(np.einsum("kin,kjn->nij", column, column)),
        lost=half @ half.swapaxes(1, 2) + eliminated @ cross.swapaxes(1, 2),
        between=half[:-1] @ half[1:].swapaxes(1, 2) + eliminated[:-1] @ cross[1:].swapaxes(1, 2),
        gradient=gradient - eliminated @ reduced.gradient,
    )


@dataclass(frozen=True, eq=False)
class ChangeTime:
    """The time of a step.

    Attributes:
        window, share: most likely window of the step, and the share of its samples after the step.
        time, time_sigma: s, averaged over all likely times.
        value, covariance: (3,) T and (3, 3) of the step, averaged over all likely times.
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
    likely_windows = possible[at_edges > at_edges.max() - _UNLIKELY * colour]
    parts = np.minimum(windows.count[likely_windows], _FINEST).astype(int)
    n, parts = np.repeat(likely_windows, parts), np.repeat(parts, parts)
    number = np.arange(len(n)) - np.searchsorted(n, n)  # number of the part inside its window
    share = 1 - (number + 0.5) / parts
    ratio, step, covariance = profile.inside(n, share)
    begin, end = _edge(windows.time, windows.count, n), _edge(windows.time, windows.count, n + 1)
    time, width = end - share * (end - begin), (end - begin) / parts
    likely = np.exp(0.5 * (ratio - ratio.max()) / colour) * width
    likely /= likely.sum()
    mean, value = float(likely @ time), likely @ step
    spread = float(likely @ ((time - mean) ** 2 + width**2 / 12))
    away = step - value
    best = int(np.argmax(likely))
    return ChangeTime(
        int(n[best]),
        float(share[best]),
        mean,
        float(np.sqrt(spread)),
        value,
        np.einsum("k,kij->ij", likely, colour * covariance + away[:, :, None] * away[:, None, :]),
    )


def _edge(time: Array, count: Array, n: Array) -> Array:
    """Return the times between windows n − 1 and n, whose samples are evenly spaced."""
    edge: Array = time[n - 1] + (time[n] - time[n - 1]) * count[n - 1] / (count[n - 1] + count[n])
    return edge


def _from(values: Array) -> Array:
    """Return the sums over the first axis from each index on, and a last sum of zero."""
    return np.concatenate([np.cumsum(values[::-1], axis=0)[::-1], np.zeros((1, *values.shape[1:]))])
