"""Solution of one instrument's logs: the forward pass (`forward`) labels them, then all logs are smoothed together.

The posterior is averaged over the deviation of the walk, so that its covariance includes the uncertainty of the walk,
which is large in a history of few logs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.history.chain import HistoryPosterior, Observations, solve
from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.forward import (
    JUMPED,
    REFITTED,
    SCATTER_OF_CELL,
    SCATTERS,
    SHARED_OF_CELL,
    WALK_OF_CELL,
    WALKS,
    WRONG,
    Bank,
    empty_bank,
    observed_covariance,
    stepped,
)
from magyc_gtsam.history.log_factor import OBSERVED, SCALE, SHARED, LogFactor
from magyc_gtsam.history.model import DAY, HistoryModel
from magyc_gtsam.recording import Array

_INTERVALS = 0.9  # quantile of the intervals between logs for which the next log is predicted
_NEGLIGIBLE = 1e-3  # weight below which a walk is left out of the average
_LEAST_ELAPSED = 1e-3  # days between neighbours, so that logs of the same minute may still differ


@dataclass(frozen=True, eq=False)
class Instrument:
    """The solution of one instrument's logs.

    Attributes:
        logs: the logs in the order of time.
        bank: the filters after the last log.
        model: assumptions about the instrument between the logs.
    """

    logs: tuple[LogFactor, ...]
    bank: Bank
    model: HistoryModel

    @property
    def order(self) -> tuple[int, ...]:
        """The indices of the logs in the history."""
        return self.bank.order

    @property
    def label(self) -> np.ndarray:
        """The likeliest label (k,) of each log: WALKED, JUMPED or REFITTED (before it) or WRONG."""
        return np.asarray(self.bank.label[0])

    @property
    def walk(self) -> float:
        """The posterior median of the walk, µT per √day."""
        return self._walk_at(0.5)

    @property
    def walk_interval(self) -> tuple[float, float]:
        """The interval that holds 68 % of the posterior of the walk, µT per √day."""
        return self._walk_at(0.16), self._walk_at(0.84)

    def _walk_at(self, quantile: float) -> float:
        """Return a quantile of the walk, whose logarithm is uniform between the middles of neighbours on the grid."""
        share = self.bank.share.sum(axis=0).reshape(len(WALKS), len(SCATTERS)).sum(axis=1)
        middle = 0.5 * (np.log(WALKS[1:]) + np.log(WALKS[:-1]))
        edges = np.r_[np.log(WALKS[0]), middle, np.log(WALKS[-1])]
        return float(np.exp(np.interp(quantile, np.r_[0.0, np.cumsum(share)], edges)))

    @property
    def scatter(self) -> float:
        """The likeliest relative scatter of soft irons between logs beyond their sigmas."""
        return float(SCATTERS[self._scattered, 1])

    @property
    def _scattered(self) -> int:
        """The likeliest of `SCATTERS`."""
        return int(np.argmax(self.bank.share.sum(axis=0).reshape(len(WALKS), len(SCATTERS)).sum(axis=0)))

    @cached_property
    def shared_error(self) -> Array:
        """The covariance (p + 3, p + 3) of the error of s, g and h that all logs share.

        It does not average out: the model errors M_k, as far as the logs share them, add like numbers. With the weights
        W_k of the mean, C = ρ L Lᵀ, L = Σ W_k √M_k; ρ is the posterior mean of the share.
        """
        good = self.label != WRONG
        used = [log for log, is_good in zip(self.logs, good, strict=True) if log.mean is not None and is_good]
        size = self.bank.mean.shape[-1]
        if not used:
            return np.zeros((size, size))
        share = float(self.bank.share.sum(axis=0) @ SHARED_OF_CELL)
        weights = np.linalg.inv([observed_covariance(log, share, self.model) for log in used])
        value, vector = np.linalg.eigh([log.model_error[OBSERVED, OBSERVED] for log in used])
        roots = np.einsum("kij,kj,klj->kil", vector, np.sqrt(np.maximum(value, 0.0)), vector)
        together = np.linalg.solve(weights.sum(axis=0), np.einsum("kij,kjl->il", weights, roots))
        return share * together @ together.T

    @property
    def horizon(self) -> float:
        """The days after the last log for which the next one is predicted: all but the longest tenth of the intervals.

        The logs of one trip follow each other in hours, and the next trip begins after a month.
        """
        elapsed = elapsed_of([log for log in self.logs if log.mean is not None], self.bank.dated)
        return float(np.quantile(elapsed, _INTERVALS, method="nearest")) if len(elapsed) else 1.0

    @cached_property
    def ahead(self) -> tuple[Array, Array]:
        """Mean (p + 3,) and covariance of the shared parameters and h, µT, at the `horizon` without a jump."""
        # A labelling that uses no log gives no prediction.
        calibrated = np.array([log.mean is not None for log in self.logs])
        used = ((self.bank.label != WRONG) & calibrated).any(axis=1)
        share = self.bank.share * used[:, None]
        share = share / share.sum()
        mean: Array = np.einsum("kc,kci->i", share, self.bank.mean)
        off = self.bank.mean - mean
        covariance = np.einsum("kc,kcij->ij", share, self.bank.covariance)
        covariance += np.einsum("kc,kci,kcj->ij", share, off, off)
        of_cell = share.sum(axis=0)
        covariance[range(SHAPE), range(SHAPE)] += of_cell @ SCATTER_OF_CELL**2
        iron = range(len(mean) - 3, len(mean))
        covariance[iron, iron] += self.horizon * (of_cell @ WALK_OF_CELL**2)
        scale = range(SHAPE, len(mean) - 3)
        covariance[scale, scale] += self.model.gyroscope_scale_scatter**2
        return mean, covariance + self.shared_error

    @cached_property
    def _first(self) -> list[int]:
        """The first log of each part within which the soft iron is the same."""
        used = np.array([log.mean is not None for log in self.logs]) & (self.label != WRONG)
        return [0, *(int(k) for k in np.flatnonzero(self.label == REFITTED) if used[:k].any())]

    @cached_property
    def posteriors(self) -> tuple[HistoryPosterior, ...]:
        """The posterior from all logs of each such part, at the likeliest labelling and scatter, averaged over the
        walk.
        """
        stops = [*self._first[1:], len(self.logs)]
        return tuple(self._posterior(first, stop) for first, stop in zip(self._first, stops, strict=True))

    def _posterior(self, first: int, stop: int) -> HistoryPosterior:
        logs, label = self.logs[first:stop], self.label[first:stop]
        elapsed = elapsed_of(logs, self.bank.dated)
        observed = _observations(logs, elapsed, SCATTERS[self._scattered], label != WRONG, self.model)
        weight = self.bank.weight[0].reshape(len(WALKS), len(SCATTERS))[:, self._scattered]
        share = np.exp(weight - weight.max())
        used = np.flatnonzero(share > _NEGLIGIBLE)
        jumped = self.model.jump**2 * ((label[1:] == JUMPED) | (label[1:] == REFITTED))
        each = [solve(observed, WALKS[i] ** 2 * observed.elapsed + jumped) for i in used]
        found, error = _averaged(each, share[used] / share[used].sum()), self.shared_error
        return replace(
            found,
            shared_covariance=found.shared_covariance + error[:-3, :-3],
            covariance=found.covariance + error[-3:, -3:],
            cross=found.cross + error[-3:, :-3],
        )

    def at(self, k: int) -> tuple[HistoryPosterior, int]:
        """Return the posterior that contains the k-th log, and the place of the log in it."""
        part = int(np.searchsorted(self._first, k, side="right")) - 1
        return self.posteriors[part], k - self._first[part]

    @cached_property
    def hard_iron(self) -> Array:
        """The hard iron (k, 3) of each log, µT."""
        return np.concatenate([each.hard_iron for each in self.posteriors])

    @cached_property
    def hard_iron_covariance(self) -> Array:
        """Its covariance (k, 3, 3)."""
        return np.concatenate([each.covariance for each in self.posteriors])

    def change(self, k: int) -> Array:
        """Return the covariance (3, 3) of the change of the hard iron before the k-th log, µT²."""
        posterior, place = self.at(k)
        if place:
            return np.asarray(posterior.change[place - 1])
        return np.asarray(self.hard_iron_covariance[k - 1] + self.hard_iron_covariance[k])


def solve_instrument(
    factors: Sequence[LogFactor],
    order: Sequence[int],
    model: HistoryModel,
    *,
    dated: bool,
    known: Sequence[Bank] = (),
) -> Instrument:
    """Solve the logs `order` of `factors`.

    Args:
        factors: the factors of the history.
        order: indices of the logs in the order of time, at least one with a calibration.
        model: assumptions about the instrument between the logs.
        dated: whether all logs of the history have a date.
        known: earlier filters; the one that has filtered the most of these logs is continued.
    """
    order = tuple(order)
    fitting = [bank for bank in known if bank.dated == dated and bank.order == order[: len(bank.order)]]
    bank = max(fitting, key=lambda each: len(each.order), default=None)
    if bank is None:
        bank = empty_bank(dated, _shared(factors[i] for i in order), model)
    for k in range(len(bank.order), len(order)):
        elapsed = float(elapsed_of([factors[i] for i in order[k - 1 : k + 1]], dated)[0]) if k else 0.0
        bank = stepped(bank, order[k], factors[order[k]], elapsed, model)
    return Instrument(tuple(factors[i] for i in order), bank, model)


def elapsed_of(logs: Sequence[LogFactor], dated: bool) -> Array:
    """Return the days (k − 1,) between neighbours; without dates 1 before each log that counts as one."""
    if not dated:
        return np.array([1.0 if log.counts else _LEAST_ELAPSED for log in logs[1:]])
    return np.maximum(np.diff(np.array([log.time for log in logs], dtype=np.float64)) / DAY, _LEAST_ELAPSED)


def _shared(logs: Iterable[LogFactor]) -> int:
    """Return the number of parameters shared by logs, at least one of which has a calibration."""
    return next(len(log.mean[SHARED]) for log in logs if log.mean is not None)


def _observations(
    logs: Sequence[LogFactor], elapsed: Array, scattered: Array, kept: np.ndarray, model: HistoryModel
) -> Observations:
    """Return (s, g, h) of each log with biases marginalised and one of `SCATTERS`; logs not kept have no information.

    The first log that is kept has the prior of g.
    """
    common, scatter = scattered
    shared = _shared(logs)
    mean, information = np.zeros((len(logs), shared + 3)), np.zeros((len(logs), shared + 3, shared + 3))
    informative = np.array([log.mean is not None for log in logs]) & kept
    used = [log for log, is_used in zip(logs, informative, strict=True) if is_used]
    mean[informative] = np.array([log.mean[OBSERVED] for log in used if log.mean is not None])
    covariances = [observed_covariance(log, common, model) for log in used]
    added = np.diag(np.where(np.arange(shared + 3) < SHAPE, scatter**2, 0.0))
    information[informative] = np.linalg.inv(np.array(covariances) + added)
    if shared > SHAPE and informative.any():
        first = int(np.argmax(informative))
        weighted = information[first] @ mean[first]
        information[first, SCALE, SCALE] += np.eye(3) / model.gyroscope_scale**2
        mean[first] = np.linalg.solve(information[first], weighted)
    return Observations(mean, information, elapsed)


def _averaged(each: Sequence[HistoryPosterior], share: Array) -> HistoryPosterior:
    """Return mean and covariance of the mixture of posteriors."""
    shared = np.einsum("n,ni->i", share, [p.shared for p in each])
    hard_iron = np.einsum("n,nki->ki", share, [p.hard_iron for p in each])
    off_shared = np.array([p.shared for p in each]) - shared
    off = np.array([p.hard_iron for p in each]) - hard_iron
    off_change = np.diff(off, axis=1)

    def mean(values: Sequence[Array], one: Array, other: Array) -> Array:
        result: Array = np.einsum("n,n...->...", share, values) + np.einsum(
            "n,n...i,n...j->...ij", share, one, other
        )
        return result

    return HistoryPosterior(
        shared,
        mean([p.shared_covariance for p in each], off_shared, off_shared),
        hard_iron,
        mean([p.covariance for p in each], off, off),
        mean([p.cross for p in each], off, np.broadcast_to(off_shared[:, None], (*off.shape[:2], len(shared)))),
        mean([p.change for p in each], off_change, off_change),
    )
