"""Joint solution of all logs of one instrument, given which logs are wrong and where the hard iron jumped.

The shape of the soft iron, and the gyroscope's scale where it is estimated, are shared (s, p numbers), each log has
its hard iron h_k, and neighbours are linked by a random walk:

    (s, h_k) ~ N(log k),   h_{k+1} − h_k ~ N(0, q Δt_k I), or with a jump N(0, (q Δt_k + jump²) I).

The information matrix is block tridiagonal with a border for s. Cost and memory are linear in the number of logs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from magyc_gtsam.recording import Array

_BAND = 6  # rows of the band: two neighbouring blocks of three


@dataclass(frozen=True, eq=False)
class Observations:
    """The logs' observations of (s, h), in the order of time.

    Attributes:
        mean: (k, p + 3) s and h, µT.
        information: (k, p + 3, p + 3); zeros for a log without information.
        elapsed: (k − 1,) days between neighbours, or 1 each if the logs have no dates.
    """

    mean: Array
    information: Array
    elapsed: Array

    def __len__(self) -> int:
        return len(self.mean)

    @property
    def shared(self) -> int:
        """Number p of the parameters that all logs share."""
        return self.mean.shape[1] - 3


@dataclass(frozen=True, eq=False)
class HistoryPosterior:
    """The joint posterior of s and all h.

    Attributes:
        shared, shared_covariance: (p,) and (p, p) of s.
        hard_iron, covariance: (k, 3) µT and (k, 3, 3) of each h_k.
        cross: (k, 3, p) covariance of h_k with s.
        change: (k − 1, 3, 3) covariance of h_{k+1} − h_k.
    """

    shared: Array
    shared_covariance: Array
    hard_iron: Array
    covariance: Array
    cross: Array
    change: Array


def _assembled(observed: Observations, step_variance: Array) -> tuple[Array, Array, Array, Array]:
    """Return the normal equations: lower band (6, 3k), border (3k, p), corner (p, p), right-hand side (3k + p,)."""
    k, p = len(observed), observed.shared
    information, mean = observed.information, observed.mean
    ties = 1 / step_variance
    blocks = information[:, p:, p:].copy()
    both = np.zeros(k)
    both[:-1] += ties
    both[1:] += ties
    blocks += both[:, None, None] * np.eye(3)
    band = np.zeros((_BAND, 3 * k))
    for offset in range(3):
        for column in range(3 - offset):
            band[offset, column::3] = blocks[:, column + offset, column]
    band[3, : 3 * (k - 1)] = -np.repeat(ties, 3)
    border = information[:, p:, :p].reshape(3 * k, p)
    corner = information[:, :p, :p].sum(axis=0)
    weighted = np.einsum("kij,kj->ki", information, mean)
    right = np.concatenate([weighted[:, p:].ravel(), weighted[:, :p].sum(axis=0)])
    return band, border, corner, right


def solve(observed: Observations, step_variance: Array) -> HistoryPosterior:
    """Return the posterior at given variances of the steps.

    Args:
        observed: the observations, at least one with information.
        step_variance: (k − 1,) µT², variance of each step on each axis.
    """
    k, p = len(observed), observed.shared
    band, border, corner, right = _assembled(observed, step_variance)
    factor = cholesky_banded(band, lower=True)
    solved = cho_solve_banded((factor, True), np.column_stack([border, right[: 3 * k]]))
    schur = corner - border.T @ solved[:, :p]
    schur = 0.5 * (schur + schur.T)
    shared = np.linalg.solve(schur, right[3 * k :] - border.T @ solved[:, p])
    hard_iron = (solved[:, p] - solved[:, :p] @ shared).reshape(k, 3)

    shared_covariance = np.linalg.inv(schur)
    given_shared, change = _marginals(band, 1 / step_variance)
    on_shared = solved[:, :p].reshape(k, 3, p)
    spread = np.einsum("kia,ab,kjb->kij", on_shared, shared_covariance, on_shared)
    moved = np.diff(on_shared, axis=0)
    change = change + np.einsum("kia,ab,kjb->kij", moved, shared_covariance, moved)
    cross = -np.einsum("kia,ab->kib", on_shared, shared_covariance)
    return HistoryPosterior(shared, shared_covariance, hard_iron, given_shared + spread, cross, change)


def _marginals(band: Array, ties: Array) -> tuple[Array, Array]:
    """Return the covariances of each h (k, 3, 3) at given s, and of the neighbours' differences (k − 1, 3, 3).

    Forward elimination D_i = A_i − t²_{i−1} D⁻¹_{i−1}, then backward: Σ_i = D_i⁻¹ + G_i Σ_{i+1} G_iᵀ with
    G_i = t_i D_i⁻¹, which is also the covariance of h_i with h_{i+1} over Σ_{i+1}.
    """
    k = band.shape[1] // 3
    blocks = np.zeros((k, 3, 3))
    for offset in range(3):
        for column in range(3 - offset):
            blocks[:, column + offset, column] = blocks[:, column, column + offset] = band[offset, column::3]
    inverse = np.zeros((k, 3, 3))
    inverse[0] = np.linalg.inv(blocks[0])
    for i in range(1, k):
        inverse[i] = np.linalg.inv(blocks[i] - ties[i - 1] ** 2 * inverse[i - 1])
    covariance, change = inverse.copy(), np.zeros((max(k - 1, 0), 3, 3))
    for i in range(k - 2, -1, -1):
        gain = ties[i] * inverse[i]
        covariance[i] = inverse[i] + gain @ covariance[i + 1] @ gain.T
        joint = gain @ covariance[i + 1]
        change[i] = covariance[i] + covariance[i + 1] - joint - joint.T
    return covariance, change
