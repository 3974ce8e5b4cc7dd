"""One instrument's logs solved together: labels, walk and scatter by their likelihood, then the posterior.

Labels and the two variances need each other and are found in turn until the labels stand still. The posterior is
averaged over the walk's deviation, so that a history of few logs, which hardly knows it, is as uncertain
as it should be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.history.chain import Observations, Posterior, solve
from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.labels import JUMPED, WALKED, WRONG, Labels, label_logs
from magyc_gtsam.history.log_factor import LogFactor
from magyc_gtsam.history.model import DAY, HistoryModel
from magyc_gtsam.recording import Array

_WALKS = np.geomspace(0.01, 30.0, 13)  # µT per √day, a first look
_FINE = 25  # walks in the range that the first look leaves
_SCATTERS = np.concatenate([[0.0], np.geomspace(5e-4, 0.05, 13)])  # relative
_BETTER = 3.3  # nats, half of χ² of one degree of freedom at 99 %, from which a scatter is believed
_ROUNDS = 8
_NEGLIGIBLE = 1e-3  # weight of a walk that is left out of the average
_OBSERVED = SHAPE + 3
_LEAST_ELAPSED = 1e-3  # days between neighbours, so that two logs of one minute are not one


@dataclass(frozen=True, eq=False)
class Instrument:
    """The solution of one instrument's logs, in the order of time.

    Attributes:
        order: indices of the logs in the history.
        labels: of each log (`labels`).
        posterior: averaged over the walk.
        walk: µT per √day, its posterior median.
        ahead: (3, 3) µT², variance of the walk up to the next log after a median interval.
        scatter: relative, by which soft irons differ from log to log beyond their sigmas.
    """

    order: tuple[int, ...]
    labels: Labels
    posterior: Posterior
    walk: float
    ahead: Array
    scatter: float


def solve_instrument(factors: Sequence[LogFactor], order: Sequence[int], model: HistoryModel) -> Instrument:
    """Solve the logs `order` of `factors`; at least one has a calibration."""
    logs = [factors[i] for i in order]
    elapsed = _elapsed(logs)
    scatter = model.scatter if len(logs) > 2 else 0.0
    walk = model.walk
    plain = _observations(logs, elapsed, 0.0)
    shape, shape_covariance = _central(plain), np.zeros((SHAPE, SHAPE))
    labels: Labels | None = None
    for _ in range(_ROUNDS):
        observed = _observations(logs, elapsed, scatter)
        found = label_logs(observed, shape, shape_covariance, walk**2, model)
        if labels is not None and np.array_equal(found.label, labels.label):
            break
        labels = found
        scatter = _likeliest_scatter(logs, elapsed, labels, walk, model)
        observed = _with_labels(_observations(logs, elapsed, scatter), labels)
        walks, weights = _walk_posterior(observed, labels, model, fine=False)
        walk = float(walks[np.searchsorted(np.cumsum(weights), 0.5)])
        posterior = solve(observed, _steps(observed, labels, walk, model), marginals=False)
        shape, shape_covariance = posterior.shape, posterior.shape_covariance
    assert labels is not None
    observed = _with_labels(_observations(logs, elapsed, scatter), labels)
    walks, weights = _walk_posterior(observed, labels, model)
    used = np.flatnonzero(weights > _NEGLIGIBLE * weights.max())
    share = weights[used] / weights[used].sum()
    each = [solve(observed, _steps(observed, labels, float(walks[i]), model)) for i in used]
    interval = float(np.median(elapsed)) if len(elapsed) else 1.0
    ahead = np.eye(3) * float(share @ walks[used] ** 2) * interval
    return Instrument(tuple(order), labels, _averaged(each, share), walk, ahead, scatter)


def _elapsed(logs: Sequence[LogFactor]) -> Array:
    """(k − 1,) days between neighbours, or 1 each."""
    times = [log.time for log in logs]
    if any(time is None for time in times):
        return np.ones(len(logs) - 1)
    return np.maximum(np.diff(np.array(times, dtype=np.float64)) / DAY, _LEAST_ELAPSED)


def _observations(logs: Sequence[LogFactor], elapsed: Array, scatter: float) -> Observations:
    """(s, h) of each log, their biases marginalised out, the scatter added."""
    mean, information = np.zeros((len(logs), _OBSERVED)), np.zeros((len(logs), _OBSERVED, _OBSERVED))
    says = np.array([log.mean is not None for log in logs])
    mean[says] = np.array([log.mean[:_OBSERVED] for log in logs if log.mean is not None])
    own = [log.covariance[:_OBSERVED, :_OBSERVED] for log in logs if log.covariance is not None]
    added = np.diag(np.r_[np.full(SHAPE, scatter**2), np.zeros(3)])
    information[says] = np.linalg.inv(np.array(own) + added)
    return Observations(mean, information, elapsed)


def _with_labels(observed: Observations, labels: Labels) -> Observations:
    """Wrong logs say nothing."""
    kept = labels.label != WRONG
    return Observations(observed.mean, observed.information * kept[:, None, None], observed.elapsed)


def _steps(observed: Observations, labels: Labels, walk: float, model: HistoryModel) -> Array:
    """(k − 1,) µT² of each step."""
    result: Array = walk**2 * observed.elapsed + model.jump**2 * (labels.label[1:] == JUMPED)
    return result


def _central(observed: Observations) -> Array:
    """The log's shape that most others agree with: the least sum of squared distances, each counting up to a limit."""
    says = np.flatnonzero(observed.information[:, 0, 0] > 0)
    mean = observed.mean[says, :SHAPE]
    variance = np.linalg.inv(observed.information[says])[:, range(SHAPE), range(SHAPE)] + _SCATTERS[-5] ** 2
    best, chosen = np.inf, mean[0]
    for candidate, own in zip(mean, variance, strict=True):
        squared = np.sum((mean - candidate) ** 2 / (variance + own), axis=1)
        total = float(np.minimum(squared, 20.0).sum() + np.log(own).sum())
        if total < best:
            best, chosen = total, candidate
    return chosen


def _walk_posterior(
    observed: Observations, labels: Labels, model: HistoryModel, fine: bool = True
) -> tuple[Array, Array]:
    """Deviations of the walk on a grid that is fine where the posterior is, and their weights, sum 1."""

    def weights_of(walks: Array) -> Array:
        value = -0.5 * (np.log(walks / model.walk) / model.walk_spread) ** 2
        if len(observed) > 1:
            value += [
                solve(observed, _steps(observed, labels, float(walk), model), marginals=False).log_likelihood
                for walk in walks
            ]
        weights: Array = np.exp(value - value.max())
        return weights

    first = weights_of(_WALKS)
    if not fine:
        return _WALKS, first / first.sum()
    left = np.flatnonzero(first > _NEGLIGIBLE)
    low, high = max(left[0] - 1, 0), min(left[-1] + 1, len(_WALKS) - 1)
    walks = np.geomspace(_WALKS[low], _WALKS[high], _FINE)
    weights = weights_of(walks)
    return walks, weights / weights.sum()


def _likeliest_scatter(
    logs: Sequence[LogFactor], elapsed: Array, labels: Labels, walk: float, model: HistoryModel
) -> float:
    """0 unless a scatter is believed."""
    kept = labels.label != WRONG
    if np.sum([log.mean is not None for log in logs] & kept) < 3:
        return 0.0
    values = []
    for scatter in _SCATTERS:
        observed = _with_labels(_observations(logs, elapsed, float(scatter)), labels)
        says = observed.information[:, 0, 0] > 0
        likelihood = solve(observed, _steps(observed, labels, walk, model), marginals=False).log_likelihood
        values.append(likelihood + 0.5 * float(np.linalg.slogdet(observed.information[says])[1].sum()))
    best = int(np.argmax(values))
    return float(_SCATTERS[best]) if values[best] > values[0] + _BETTER else 0.0


def _averaged(each: Sequence[Posterior], share: Array) -> Posterior:
    """The mixture's mean and covariance."""
    shape = np.einsum("n,ni->i", share, [p.shape for p in each])
    hard_iron = np.einsum("n,nki->ki", share, [p.hard_iron for p in each])
    off_shape = np.array([p.shape for p in each]) - shape
    off = np.array([p.hard_iron for p in each]) - hard_iron
    off_change = np.diff(off, axis=1)

    def mean(values: Sequence[Array], one: Array, other: Array) -> Array:
        result: Array = np.einsum("n,n...->...", share, values) + np.einsum(
            "n,n...i,n...j->...ij", share, one, other
        )
        return result

    return Posterior(
        shape,
        mean([p.shape_covariance for p in each], off_shape, off_shape),
        hard_iron,
        mean([p.covariance for p in each], off, off),
        mean([p.cross for p in each], off, np.broadcast_to(off_shape[:, None], (*off.shape[:2], SHAPE))),
        mean([p.change for p in each], off_change, off_change),
        float(share @ [p.log_likelihood for p in each]),
    )


__all__ = ["JUMPED", "WALKED", "WRONG", "Instrument", "solve_instrument"]
