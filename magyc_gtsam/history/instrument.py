"""One instrument's logs solved together: the forward pass (`forward`) says what happened, then all logs what was when.

The posterior is averaged over the walk's deviation, so that a history of few logs, which hardly knows it, is as
uncertain as it should be.
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

_NEGLIGIBLE = 1e-3  # weight of a walk that is left out of the average
_LEAST_ELAPSED = 1e-3  # days between neighbours, so that two logs of one minute are not one


@dataclass(frozen=True, eq=False)
class Instrument:
    """The solution of one instrument's logs.

    Attributes:
        logs: in the order of time.
        bank: the filters after the last of them.
        model: what is assumed between the logs.
    """

    logs: tuple[LogFactor, ...]
    bank: Bank
    model: HistoryModel

    @property
    def order(self) -> tuple[int, ...]:
        """Indices of the logs in the history."""
        return self.bank.order

    @property
    def label(self) -> np.ndarray:
        """(k,) of each log: WALKED, JUMPED (before it) or WRONG, by the likeliest labelling."""
        return np.asarray(self.bank.label[0])

    @property
    def walk(self) -> float:
        """µT per √day, the posterior's median."""
        share = self.bank.share.sum(axis=0).reshape(len(WALKS), len(SCATTERS)).sum(axis=1)
        return float(WALKS[np.searchsorted(np.cumsum(share), 0.5)])

    @property
    def scatter(self) -> float:
        """Relative, by which soft irons differ from log to log beyond their sigmas; the likeliest."""
        share = self.bank.share.sum(axis=0).reshape(len(WALKS), len(SCATTERS)).sum(axis=0)
        return float(SCATTERS[np.argmax(share)])

    @cached_property
    def ahead(self) -> tuple[Array, Array]:
        """Mean (8,) and covariance (8, 8) of s and h µT at the log to come, after a median interval without a jump."""
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
        """By all logs, at the likeliest labelling and scatter, averaged over the walk."""
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
    """Solve the logs `order` of `factors`, which are in the order of time.

    Args:
        factors: of the history.
        order: at least one of them has a calibration.
        model: what is assumed.
        dated: whether all logs of the history know their date.
        known: filters of earlier times, of which the one that saw the most of these logs goes on.
    """
    order = tuple(order)
    fitting = [bank for bank in known if bank.dated == dated and bank.order == order[: len(bank.order)]]
    bank = max(fitting, key=lambda each: len(each.order), default=empty_bank(dated, model))
    for k in range(len(bank.order), len(order)):
        elapsed = float(elapsed_of([factors[i] for i in order[k - 1 : k + 1]], dated)[0]) if k else 0.0
        bank = stepped(bank, order[k], factors[order[k]], elapsed, model)
    return Instrument(tuple(factors[i] for i in order), bank, model)


def elapsed_of(logs: Sequence[LogFactor], dated: bool) -> Array:
    """(k − 1,) days between neighbours, or 1 each."""
    if not dated:
        return np.ones(len(logs) - 1)
    return np.maximum(np.diff(np.array([log.time for log in logs], dtype=np.float64)) / DAY, _LEAST_ELAPSED)


def _observations(logs: Sequence[LogFactor], elapsed: Array, scatter: float, kept: np.ndarray) -> Observations:
    """(s, h) of each log, their biases marginalised out, the scatter added; logs that are not kept say nothing."""
    mean, information = np.zeros((len(logs), OBSERVED)), np.zeros((len(logs), OBSERVED, OBSERVED))
    says = np.array([log.mean is not None for log in logs]) & kept
    used = [log for log, said in zip(logs, says, strict=True) if said]
    mean[says] = np.array([log.mean[:OBSERVED] for log in used if log.mean is not None])
    own = [log.covariance[:OBSERVED, :OBSERVED] for log in used if log.covariance is not None]
    added = np.diag(np.r_[np.full(SHAPE, scatter**2), np.zeros(3)])
    information[says] = np.linalg.inv(np.array(own) + added)
    return Observations(mean, information, elapsed)


def _averaged(each: Sequence[HistoryPosterior], share: Array) -> HistoryPosterior:
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

    return HistoryPosterior(
        shape,
        mean([p.shape_covariance for p in each], off_shape, off_shape),
        hard_iron,
        mean([p.covariance for p in each], off, off),
        mean([p.cross for p in each], off, np.broadcast_to(off_shape[:, None], (*off.shape[:2], SHAPE))),
        mean([p.change for p in each], off_change, off_change),
        float(share @ [p.log_likelihood for p in each]),
    )
