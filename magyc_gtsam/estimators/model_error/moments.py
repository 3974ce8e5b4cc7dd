"""Second moments of the coefficients of groups of columns, and of the parameters that they move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magyc_gtsam.estimators.model_error.components import PrincipalAxes
from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array


def averaged_moments(groups: Sequence[PrincipalAxes], variance: Array, share: Array, level: Array) -> list[Array]:
    """Return E[β βᵀ] (k, k) of each of f groups, averaged over m variances.

    Args:
        groups: their principal axes.
        variance: (f, m) relative to the level φ; share: (f, m) weights of these variances.
        level: (f, m) φ under each, times its weight.
    """
    if compiled.loops:
        value, vector, pull = (np.concatenate(each, axis=None) for each in zip(*groups, strict=True))
        count, second = _counts([group.value for group in groups]), np.empty(len(vector))
        inputs = map(compiled.given, (count, value, vector, pull, variance, share, level))
        compiled.loops.average_moments(variance.shape[1], *inputs, second)
        return _squares(second, count)
    result = []
    for i, (value, vector, pull) in enumerate(groups):
        known = variance[i, :, None] / (1 + variance[i, :, None] * value)
        means = (known * pull) @ vector.T
        result.append((vector * (level[i] @ known)) @ vector.T + (means.T * share[i]) @ means)
    return result


def propagated(moves: Sequence[Array], seconds: Sequence[Array]) -> list[Array]:
    """Return for each group the (p, p) second moment of the parameters that it moves.

    Args:
        moves: (p, k) of each group, per unit of its coefficients.
        seconds: (k, k) E[β βᵀ] of each.
    """
    if not moves or compiled.loops is None:
        return [move @ second @ move.T for move, second in zip(moves, seconds, strict=True)]
    p, result = len(moves[0]), np.empty((len(moves), len(moves[0]), len(moves[0])))
    every, second = np.concatenate(moves, axis=1), np.concatenate(seconds, axis=None)
    compiled.loops.propagate(p, _counts(seconds), every, second, result)
    return list(result)


def _counts(groups: Sequence[Array]) -> np.ndarray:
    return np.array([len(group) for group in groups], dtype=np.int64)


def _squares(entries: Array, count: np.ndarray) -> list[Array]:
    """Return the matrices (k, k) whose entries follow each other, given their sizes."""
    ends = np.cumsum(count * count).tolist()
    return [entries[end - k * k : end].reshape(k, k) for end, k in zip(ends, count.tolist(), strict=True)]
