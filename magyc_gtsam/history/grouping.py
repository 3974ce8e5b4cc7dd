"""Which logs can be of one instrument: clustering by the evidence of what an instrument keeps.

An instrument keeps its soft iron, skew and gyroscope bias up to a scatter, and its hard iron unless something was
moved. A log joins the group that predicts it best, or begins one where "another instrument" predicts it better; logs
are taken out and assigned again until nothing changes (the moves of Neal 2000, algorithm 3, at zero temperature).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.log_factor import GYRO_BIAS, HARD_IRON, MILLIRADIAN, LogFactor
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.recording import Array

_SWEEPS = 10
_KEPT = np.r_[0:SHAPE, GYRO_BIAS]  # what stays
_STAYED = 0.8  # share of logs of an instrument whose hard iron is that of another of its logs


def group_logs(factors: Sequence[LogFactor], model: HistoryModel) -> tuple[tuple[int, ...], ...]:
    """Groups of indices, the largest first, each ascending; logs without a calibration are in none."""
    logs = [i for i, factor in enumerate(factors) if factor.mean is not None]
    if not logs:
        return ()
    clusters = _Clusters([factors[i] for i in logs], model)
    for i in clusters.surest_first:
        clusters.assign(i)
    for _ in range(_SWEEPS):
        before = clusters.partition()
        for i in clusters.surest_first:
            clusters.take_out(i)
            clusters.assign(i)
        if clusters.partition() == before:
            break
    groups = [tuple(logs[i] for i in group) for group in clusters.partition()]
    return tuple(sorted(groups, key=lambda group: (-len(group), group)))


class _Clusters:
    """Logs in groups, with what each group says of its instrument."""

    def __init__(self, factors: Sequence[LogFactor], model: HistoryModel) -> None:
        self._model = model
        mean = np.array([factor.mean for factor in factors])
        covariance = np.array([factor.covariance for factor in factors])
        scatter = np.diag(np.r_[np.full(SHAPE, model.scatter**2), np.full(3, model.bias_scatter**2)])
        kept = mean[:, _KEPT]
        information = np.linalg.inv(covariance[:, _KEPT[:, None], _KEPT] + scatter)
        skew, known = _skews(factors, model)
        self._information = np.array([block_diag(*both) for both in zip(information, known, strict=True)])
        self._weighted = np.einsum("kij,kj->ki", self._information, np.hstack([kept, skew]))
        self._priors = [
            np.r_[np.full(SHAPE, shape**-2), np.full(3, model.bias**-2), np.full(3, model.skew**-2)]
            for shape, _ in (model.raw, model.calibrated)
        ]
        self._iron, self._iron_spread = mean[:, HARD_IRON], covariance[:, HARD_IRON, HARD_IRON]
        self._anywhere = np.logaddexp(
            *(
                _log_density(self._iron, self._iron_spread + np.eye(3) * h**2)
                for _, h in (model.raw, model.calibrated)
            )
        ) + np.log(0.5)
        peak = _log_density(np.zeros(3), self._iron_spread + np.eye(3) * model.hard_iron_scatter**2)
        self._most_iron = np.logaddexp(np.log(1 - _STAYED), np.log(_STAYED) + peak - self._anywhere)
        self.surest_first = [int(i) for i in np.argsort(np.linalg.slogdet(covariance)[1])]
        self._groups: list[_Group] = []
        self._group_of: dict[int, _Group] = {}

    def partition(self) -> list[list[int]]:
        """The groups, in an order of their own."""
        return sorted(sorted(group.logs) for group in self._groups)

    def take_out(self, i: int) -> None:
        """Remove a log from its group."""
        own = self._group_of.pop(i)
        own.change(i, self._information[i], self._weighted[i], -1)
        if not own.logs:
            self._groups.remove(own)

    def assign(self, i: int) -> None:
        """Put a log where its evidence is greatest."""
        nothing = _Group(SHAPE + 6)
        alone = self._kept_given(i, nothing)
        kept = np.array([self._kept_given(i, group) + self._model.same - alone for group in self._groups])
        # The hard iron need not be compared where it cannot change the choice.
        low, high = kept + np.log(1 - _STAYED), kept + self._most_iron[i]
        best = int(np.argmax(kept)) if len(kept) else -1
        if len(kept) and low[best] > max(0.0, float(np.delete(high, best).max(initial=0.0))):
            chosen = self._groups[best]
        elif not (high > 0).any():
            chosen = nothing
        else:
            gains = [one + self._iron_gain(i, group.logs) for one, group in zip(kept, self._groups, strict=True)]
            chosen = self._groups[int(np.argmax(gains))] if max(gains) > 0 else nothing
        if chosen is nothing:
            self._groups.append(nothing)
        chosen.change(i, self._information[i], self._weighted[i], 1)
        self._group_of[i] = chosen

    def _kept_given(self, i: int, group: _Group) -> float:
        """Log density of a log's soft iron and bias given its instrument's others, but for a constant of the log."""
        with_it = self._together(group.information + self._information[i], group.weighted + self._weighted[i])
        return with_it - self._together(group.information, group.weighted)

    def _together(self, information: Array, weighted: Array) -> float:
        """Log density of soft irons and biases of one instrument, whose own are integrated out over both priors."""
        values = []
        for prior in self._priors:
            both = information + np.diag(prior)
            gain = weighted @ np.linalg.solve(both, weighted) - np.linalg.slogdet(both)[1] + np.log(prior).sum()
            values.append(0.5 * gain)
        return float(np.logaddexp(*values))

    def _iron_gain(self, i: int, others: list[int]) -> float:
        """By how much a log's hard iron is likelier with others of its instrument than anywhere."""
        both = self._iron_spread[others] + self._iron_spread[i] + np.eye(3) * self._model.hard_iron_scatter**2
        stayed = _log_density(self._iron[others] - self._iron[i], both)
        nearest = float(np.logaddexp.reduce(stayed)) - np.log(len(others)) - float(self._anywhere[i])
        return float(np.logaddexp(np.log(1 - _STAYED), np.log(_STAYED) + nearest))


class _Group:
    """Logs of one instrument, and the sums of what they say of it."""

    def __init__(self, size: int) -> None:
        self.logs: list[int] = []
        self.information, self.weighted = np.zeros((size, size)), np.zeros(size)

    def change(self, i: int, information: Array, weighted: Array, sign: int) -> None:
        """Take a log in (1) or out (−1)."""
        self.information = self.information + sign * information
        self.weighted = self.weighted + sign * weighted
        if sign > 0:
            self.logs.append(i)
        else:
            self.logs.remove(i)


def _skews(factors: Sequence[LogFactor], model: HistoryModel) -> tuple[Array, Array]:
    """(k, 3) mrad skews and their information (k, 3, 3); none where a log did not show one."""
    skew, information = np.zeros((len(factors), 3)), np.zeros((len(factors), 3, 3))
    for k, factor in enumerate(factors):
        if factor.misalignment is not None and factor.misalignment_covariance is not None:
            skew[k] = factor.misalignment / MILLIRADIAN
            spread = factor.misalignment_covariance / MILLIRADIAN**2 + np.eye(3) * model.skew_scatter**2
            information[k] = np.linalg.inv(spread)
    return skew, information


def _log_density(off: Array, covariance: Array) -> Array:
    """Of N(0, covariance) at `off`, stacked."""
    squared = np.einsum("...i,...i->...", off, np.linalg.solve(covariance, off[..., None])[..., 0])
    result: Array = -0.5 * (squared + np.linalg.slogdet(2 * np.pi * covariance)[1])
    return result
