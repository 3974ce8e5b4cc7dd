"""Amplitudes of groups of columns by restricted maximum likelihood (Patterson and Thompson 1971).

Each group f has coefficients β_f ~ N(0, φ v_f I) beside white innovations of variance φ. With G, s and
yᵀy = rᵀ P r of `beside`, ν degrees of freedom, φ profiled out and V = diag(v), twice the log-likelihood is

    −ν ln(yᵀy − sᵀ (G + V⁻¹)⁻¹ s) − ln det(I + V G).

For one group with the others held fixed, it is a function of one variance and the group's eigenvalues. A direction of a
group that coincides with the model has eigenvalue zero: the data do not inform on it, and it takes the variance
estimated from the group's other directions. An effect with the shape of the iron on this motion therefore widens the
iron's covariance. How large these directions may be is as uncertain as the variance, which a few directions hardly
determine: of one seen scale of three its own square is the likeliest value. They therefore take the mean of the
variance over its posterior, with equal prior probability for each octave up to the largest usual amplitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dsyevd

from magyc_gtsam.estimators.model_error.held_columns import ROUNDING, HeldColumns
from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError

_ONE = np.ones((1, 1))
_ONE.flags.writeable = False


class PrincipalAxes(NamedTuple):
    """The eigendecomposition of G (k, k): non-negative eigenvalues (k,), eigenvectors (k, k), and s along them (k,)."""

    value: Array
    vector: Array
    pull: Array


def principal(normal: Array, score: Array) -> PrincipalAxes:
    """Return the principal axes of a group with G (k, k) and s (k,).

    Raises:
        MagycError: the products are not finite.
    """
    if len(score) > 1:
        value, vector, failed = dsyevd(normal, lower=1)
        if failed:
            raise MagycError("model error: the products of a group of columns are not finite")
    else:
        value, vector = normal[0], _ONE
    if value[0] < 0:  # the least one
        value = np.maximum(value, 0.0)
    return PrincipalAxes(value, vector, score @ vector)


_VARIANCE_GRID = np.geomspace(1e-8, 1, 48)  # variances on the search grid, relative to the largest
_SWEEPS = 3  # most sweeps over the groups
_CONVERGED = 0.1  # relative change of a variance below which it has converged
_LEAST_GAIN = 3.0  # gain in log-likelihood that a group must have beside the others


class VarianceEstimate(NamedTuple):
    """The likeliest variance v, its gain in log-likelihood over v = 0, and the posterior mean of v up to a largest."""

    variance: float
    gain: float
    mean: float


def likeliest(
    normal: Array, score: Array, square: float, freedom: float, most: float, usual: float | None = None
) -> VarianceEstimate:
    """Return the likeliest variance up to `most` of a group with G (k, k) and s (k,); `square` is yᵀy.

    `usual` bounds the mean of the variance, unless a larger one is the likeliest; it is `most` by default.
    """
    (variance,), (gain,) = _on_grid([principal(normal, score)], square, freedom, np.array([most]))
    best = int(gain.argmax())
    top, rise = float(variance[best]), float(gain[best])
    if not rise > 0:
        return VarianceEstimate(0.0, 0.0, 0.0)
    share = np.exp(gain - rise) * (variance <= max(top, most if usual is None else usual))
    return VarianceEstimate(top, rise, max(top, float(share @ variance / share.sum())))  # what is seen stays


def likeliest_of_each(
    groups: Sequence[PrincipalAxes], square: float, freedom: float, most: Sequence[float]
) -> list[tuple[float, float]]:
    """Return the likeliest variance of each group by itself, up to its entry of `most`, and its gain over v = 0."""
    if not groups:
        return []
    largest = np.array(most)
    _, gain = _on_grid(groups, square, freedom, largest)
    top = largest * _VARIANCE_GRID[gain.argmax(axis=1)]
    found = zip(top.tolist(), gain.max(axis=1).tolist(), strict=True)
    return [each if each[1] > 0 else (0.0, 0.0) for each in found]


def _on_grid(groups: Sequence[PrincipalAxes], square: float, freedom: float, most: Array) -> tuple[Array, Array]:
    """Return variances (f, m) of f groups, each up to its entry of `most` (f,), and the gain of each by itself."""
    variance = most[:, None] * _VARIANCE_GRID
    return variance, log_likelihoods(groups, square, freedom, variance)[0]


def log_likelihoods(
    groups: Sequence[PrincipalAxes], square: float, freedom: float, variance: Array
) -> tuple[Array, Array]:
    """Return (f, m) the log-likelihoods of f groups, each by itself, at its m variances (f, m), over those of v = 0.

    The second result, of the same shape, is what yᵀy (`square`) is left by the group.
    """
    sizes = [len(group.value) for group in groups]
    value, pull = (np.concatenate(each) for each in ([g.value for g in groups], [g.pull for g in groups]))
    if compiled.loops:
        result = np.empty(variance.shape), np.empty(variance.shape)
        count, rules = np.array(sizes, dtype=np.int64), np.array([square, freedom, ROUNDING * square])
        inputs = map(compiled.given, (count, value, pull, variance, rules))
        compiled.loops.log_likelihoods(variance.shape[1], *inputs, *result)
        return result
    first = np.cumsum([0, *sizes[:-1]])
    spread = 1 + np.repeat(variance, sizes, axis=0) * value[:, None]  # every axis of every group, (K, m)
    explained = np.add.reduceat(pull[:, None] ** 2 / spread, first)
    left = np.maximum(square - variance * explained, ROUNDING * square)
    return -0.5 * (np.add.reduceat(np.log(spread), first) + freedom * np.log(left / square)), left


class Components(NamedTuple):
    """The jointly fitted groups.

    Attributes:
        amplitude: (f,) in the columns' units.
        level: φ.
        second: (K, K) E[β βᵀ] of all columns, with the posterior means of v.
        mean: (K,) E[β].
        variance: (K,) v, the likeliest.
    """

    amplitude: Array
    level: float
    second: Array
    mean: Array
    variance: Array


def fit_components(
    normal: Array,
    score: Array,
    square: float,
    groups: Sequence[slice],
    most: Sequence[float],
    freedom: float,
    usual: Sequence[float] | None = None,
) -> Components:
    """Fit the amplitudes of all groups by coordinate ascent, in the order given, and return the posterior of β.

    Args:
        normal, score, square: G (K, K), s (K,) and yᵀy of all columns.
        groups: the columns of each group; most: the largest amplitude of each, in its columns' unit.
        freedom: ν.
        usual: the largest usual amplitude of each; `most` by default.
    """
    usual, possible = most if usual is None else usual, np.zeros(len(score))
    variance, level, held = np.zeros(len(groups)), square / freedom, HeldColumns(normal, score, square)
    for _ in range(_SWEEPS):
        before = variance.copy()
        for i, own in enumerate(groups):
            bounds = most[i] ** 2 / level, usual[i] ** 2 / level
            found = likeliest(*held.of(own), freedom, *bounds)
            variance[i], possible[own] = (found.variance, found.mean) if found.gain > _LEAST_GAIN else (0.0, 0.0)
            held.hold(own, variance[i])
        level = held.left / freedom
        if np.allclose(before, variance, rtol=_CONVERGED, atol=0.0):
            break
    prior = np.zeros(len(score))
    for own, likely in zip(groups, variance, strict=True):
        prior[own] = likely
    _, level, mean = _posterior(normal, score, prior, square, freedom)
    second = _posterior(normal, score, possible, square, freedom)[0]
    return Components(np.sqrt(variance * level), level, second, mean, prior)


def _posterior(
    normal: Array, score: Array, prior: Array, square: float, freedom: float
) -> tuple[Array, float, Array]:
    """Return E[β βᵀ] (K, K), φ, and E[β] (K,); moments are zero for columns without a variance."""
    active = prior > 0
    second, mean = np.zeros((len(prior), len(prior))), np.zeros(len(prior))
    if not active.any():
        return second, square / freedom, mean
    kept = np.ix_(active, active)
    covariance = np.linalg.inv(normal[kept] + np.diag(1 / prior[active]))
    mean[active] = covariance @ score[active]
    level = max(square - float(score[active] @ mean[active]), ROUNDING * square) / freedom
    second[kept] = level * covariance + np.outer(mean[active], mean[active])
    return second, level, mean
