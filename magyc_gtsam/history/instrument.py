"""Solve one instrument's logs: the forward pass (`forward`) labels them, then all logs are smoothed together.

The posterior is averaged over the walk's deviation, so that its covariance includes the uncertainty of the walk, which
is large in a history of few logs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magyc_gtsam.history.chain import HistoryPosterior, Observations, solve
from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.forward import (
    JUMPED,
    SCATTER_OF_CELL,
    SCATTERS,
    WALK_OF_CELL,
    WALKS,
    WRONG,
    Bank,
    empty_bank,
    stepped,
)
from magyc_gtsam.history.log_factor import OBSERVED, LogFactor
from magyc_gtsam.history.model import DAY, HistoryModel
from magyc_gtsam.recording import Array

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
        """Return the indices of the logs in the history."""
        return self.bank.order

    @property
    def label(self) -> np.ndarray:
        """Return the likeliest label (k,) of each log: WALKED, JUMPED (before it) or WRONG."""
        return np.asarray(self.bank.label[0])

    @property
    def walk(self) -> float:
        """Return the posterior median of the walk, µT per √day."""
        share = self.bank.share.sum(axis=0).reshape(len(WALKS), len(SCATTERS)).sum(axis=1)
        return float(WALKS[np.searchsorted(np.cumsum(share), 0.5)])

    @property
    def scatter(self) -> float:
        """Return the likeliest relative scatter of soft irons between logs beyond their sigmas."""
        share = self.bank.share.sum(axis=0).reshape(len(WALKS), len(SCATTERS)).sum(axis=0)
        return float(SCATTERS[np.argmax(share)])

    @cached_property
    def ahead(self) -> tuple[Array, Array]:
        """Return mean (8,) and covariance (8, 8) of s and h, µT, a median interval after the last log, without jump."""
        elapsed = elapsed_of(self.logs, self.bank.dated)
        interval = float(np.median(elapsed)) if len(elapsed) else 1.0
        share = self.bank.share
        mean: Array = np.einsum("kc,kci->i", share, self.bank.mean)
        off = self.bank.mean - mean
        covariance = np.einsum("kc,kcij->ij", share, self.bank.covariance)
        covariance += np.einsum("kc,kci,kcj->ij", share, off, off)
        of_cell = share.sum(axis=0)
        covariance[range(SHAPE), range(SHAPE)] += of_cell @ SCATTER_OF_CELL**2
        covariance[range(SHAPE, OBSERVED), range(SHAPE, OBSERVED)] += interval * (of_cell @ WALK_OF_CELL**2)
        return mean, covariance

    @cached_property
    def posterior(self) -> HistoryPosterior:
        """Return the posterior from all logs at the likeliest labelling and scatter, averaged over the walk."""
        elapsed = elapsed_of(self.logs, self.bank.dated)
        observed = _observations(self.logs, elapsed, self.scatter, self.label != WRONG)
        weight = self.bank.weight[0][self.scatter == SCATTER_OF_CELL]
        share = np.exp(weight - weight.max())
        used = np.flatnonzero(share > _NEGLIGIBLE)
        jumped = self.model.jump**2 * (self.label[1:] == JUMPED)
        each = [solve(observed, WALKS[i] ** 2 * observed.elapsed + jumped) for i in used]
        return _averaged(each, share[used] / share[used].sum())


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
    bank = max(fitting, key=lambda each: len(each.order), default=empty_bank(dated, model))
    for k in range(len(bank.order), len(order)):
        elapsed = float(elapsed_of([factors[i] for i in order[k - 1 : k + 1]], dated)[0]) if k else 0.0
        bank = stepped(bank, order[k], factors[order[k]], elapsed, model)
    return Instrument(tuple(factors[i] for i in order), bank, model)


def elapsed_of(logs: Sequence[LogFactor], dated: bool) -> Array:
    """Return the days (k − 1,) between neighbours, or 1 each without dates."""
    if not dated:
        return np.ones(len(logs) - 1)
    return np.maximum(np.diff(np.array([log.time for log in logs], dtype=np.float64)) / DAY, _LEAST_ELAPSED)


def _observations(logs: Sequence[LogFactor], elapsed: Array, scatter: float, kept: np.ndarray) -> Observations:
    """Return (s, h) of each log with biases marginalised and the scatter added; logs not kept have no information."""
    mean, information = np.zeros((len(logs), OBSERVED)), np.zeros((len(logs), OBSERVED, OBSERVED))
    informative = np.array([log.mean is not None for log in logs]) & kept
    used = [log for log, is_used in zip(logs, informative, strict=True) if is_used]
    mean[informative] = np.array([log.mean[:OBSERVED] for log in used if log.mean is not None])
    covariances = [log.covariance[:OBSERVED, :OBSERVED] for log in used if log.covariance is not None]
    added = np.diag(np.r_[np.full(SHAPE, scatter**2), np.zeros(3)])
    information[informative] = np.linalg.inv(np.array(covariances) + added)
    return Observations(mean, information, elapsed)


def _averaged(each: Sequence[HistoryPosterior], share: Array) -> HistoryPosterior:
    """Return mean and covariance of the mixture of posteriors."""
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

    return HistoryPosterior(
        shape,
        mean([p.shape_covariance for p in each], off_shape, off_shape),
        hard_iron,
        mean([p.covariance for p in each], off, off),
        mean([p.cross for p in each], off, np.broadcast_to(off_shape[:, None], (*off.shape[:2], SHAPE))),
        mean([p.change for p in each], off_change, off_change),
        float(share @ [p.log_likelihood for p in each]),
    )
