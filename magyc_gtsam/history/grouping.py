"""Grouping of logs by instrument, by the evidence of the parameters that an instrument keeps.

An instrument keeps its soft iron, misalignment, gyroscope scale and bias up to a scatter, that of the bias as its logs
show it, and its hard iron unless iron was moved. A log joins the group that predicts it best, or starts a new group
where "another instrument" predicts it better. Logs are removed and assigned again until nothing changes, and groups are
split where that is likelier (the moves of Neal 2000, algorithm 3, and of Jain and Neal 2004, at zero temperature).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.history.bias_scatter import log_prior
from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.gaussian import log_density
from magyc_gtsam.history.log_factor import LogFactor
from magyc_gtsam.history.log_statistics import STAYED, Evidence, Group, LogStatistics
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.recording import Array

_SWEEPS = 10  # largest number of rounds of removing and assigning all logs
_WORTH_SPLITTING = 3  # size of the smallest group that may be split
_CLEAR = 7.0  # nats (odds of 1000) by which a log clearly belongs; simulated dives of one instrument have 17


class Grouping:
    """A partition of logs into groups of one instrument each."""

    def __init__(
        self, factors: Sequence[LogFactor], model: HistoryModel, groups: Sequence[Sequence[int]] | None = None
    ) -> None:
        """Group all logs that have a calibration, or restore known groups.

        Raises:
            MagycError: `groups` are not groups of these logs.
        """
        self._model = model
        self._priors = [
            np.r_[np.full(SHAPE, shape), np.repeat([model.gyroscope_scale, model.bias, model.skew], 3)] ** -2.0
            for shape, _ in (model.raw, model.calibrated)
        ]
        self._scatters = log_prior(model)
        self._groups: list[Group] = []
        self._group_of: dict[int, Group] = {}
        self._count = len(factors)
        self._row = {i: row for row, i in enumerate(i for i, f in enumerate(factors) if f.mean is not None)}
        self._statistics = LogStatistics.of([factors[i] for i in self._row], model)
        if groups is not None:
            if sorted(i for group in groups for i in group) != list(self._row):
                raise MagycError("history: its groups are not those of its logs")
            for group in groups:
                self._groups.append(Group())
                for i in group:
                    self._put(i, self._groups[-1])
            return
        surest_first = sorted(self._row, key=lambda i: self._statistics.log_volume[self._row[i]])
        for i in surest_first:
            self._assign(i)
        self._settle(surest_first)
        for each in tuple(self._groups):
            self._split(each)

    def add(self, factors: Sequence[LogFactor]) -> None:
        """Take more logs, and reassign the logs that they may affect.

        All logs outside the largest group are reassigned. If all new logs clearly belong to the largest group, its logs
        stay; otherwise those of its logs that fit another group better are reassigned, too.
        """
        more = [self._count + k for k, factor in enumerate(factors) if factor.mean is not None]
        self._count += len(factors)
        if not more:
            return
        self._row |= {i: len(self._row) + k for k, i in enumerate(more)}
        calibrated = [factor for factor in factors if factor.mean is not None]
        self._statistics = self._statistics.with_more(LogStatistics.of(calibrated, self._model))
        for i in more:
            self._assign(i)
        largest = self._group_of[self.groups[0][0]]
        staying = {i for i in largest.logs if i not in more}
        if all(self._group_of[i] is largest and self._fit([i], largest)[0] > _CLEAR for i in more):
            self._settle([i for i in self._row if i not in staying])
            return
        logs = sorted(staying)
        here = self._fit(logs, largest)
        elsewhere = [self._fit(logs, group, inside=False) for group in self._groups if group is not largest]
        doubtful = here < np.max([np.zeros(len(logs)), *elsewhere], axis=0)
        staying -= {i for i, doubt in zip(logs, doubtful, strict=True) if doubt}
        self._settle([i for i in self._row if i not in staying])
        for group in tuple(self._groups):
            self._split(group)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The logs' indices, the largest group first, each ascending; logs without a calibration are in none."""
        return tuple(sorted((tuple(sorted(g.logs)) for g in self._groups), key=lambda group: (-len(group), group)))

    def _settle(self, logs: Sequence[int]) -> None:
        """Remove logs from their groups and assign them again until nothing changes."""
        for _ in range(_SWEEPS):
            before = self.groups
            for i in logs:
                self._take_out(i)
                self._assign(i)
            if self.groups == before:
                break

    def _split(self, group: Group) -> None:
        """Let the least fitting log of a group start another, which others may join, where that is likelier.

        This finds splits that `_settle` cannot: moved singly, a log never leaves a group that holds another log of
        its own instrument.
        """
        if len(group.logs) < _WORTH_SPLITTING:
            return
        before, evidence = [(list(g.logs), g.kept) for g in self._groups], self._evidence()
        fits = self._fit(group.logs, group)
        least = int(np.argmin(fits))
        weakest, worst = group.logs[least], float(fits[least])
        others = [i for i in group.logs if i != weakest]
        self._take_out(weakest)
        started = Group()
        self._groups.append(started)
        self._put(weakest, started)
        follow = self._fit(others, started, inside=False) - self._fit(others, group)
        if float(np.maximum(follow, 0.0).sum()) > self._model.same + worst:
            self._settle([*others, weakest])
        if len(started.logs) < 2 or self._evidence() <= evidence:
            self._groups = [Group(*each) for each in before]
            self._group_of = {i: each for each in self._groups for i in each.logs}

    def _evidence(self) -> float:
        """Return the log evidence of this grouping from the kept parameters, nats."""
        each = [self._together(g.kept) + self._model.same * (len(g.logs) - 1) for g in self._groups]
        return float(sum(each) - len(each) * self._together(Evidence.nothing()))

    def _fit(self, logs: Sequence[int], group: Group, *, inside: bool = True) -> Array:
        """Return the nats (n,) by which logs' kept parameters are likelier with a group than alone.

        With `inside`, the logs belong to the group and are compared with its other logs.
        """
        own = self._statistics.kept.of([self._row[i] for i in logs])
        others = group.kept.plus(own, -1) if inside else group.kept
        together = self._together(others.plus(own)) - self._together(others)
        fit: Array = together - (self._together(own) - self._together(Evidence.nothing()))
        return fit

    def _take_out(self, i: int) -> None:
        group = self._group_of.pop(i)
        group.change(i, self._statistics.kept.of(self._row[i]), -1)
        if not group.logs:
            self._groups.remove(group)

    def _put(self, i: int, group: Group) -> None:
        group.change(i, self._statistics.kept.of(self._row[i]), 1)
        self._group_of[i] = group

    def _assign(self, i: int) -> None:
        """Put a log into the group with the greatest evidence, or into a new one."""
        nothing = Group()
        row = self._row[i]
        alone = self._kept_given(row, nothing)
        kept = np.array([self._kept_given(row, group) + self._model.same - alone for group in self._groups])
        # Hard irons are compared only where they can change the choice.
        low, high = kept + np.log(1 - STAYED), kept + self._statistics.most_hard_iron[row]
        best = int(np.argmax(kept)) if len(kept) else -1
        if len(kept) and low[best] > max(0.0, float(np.delete(high, best).max(initial=0.0))):
            chosen = self._groups[best]
        elif not (high > 0).any():
            chosen = nothing
        else:
            gains = [one + self._iron_gain(row, group) for one, group in zip(kept, self._groups, strict=True)]
            chosen = self._groups[int(np.argmax(gains))] if max(gains) > 0 else nothing
        if chosen is nothing:
            self._groups.append(nothing)
        self._put(i, chosen)

    def _kept_given(self, row: int, group: Group) -> float:
        """Return the log density of a log's kept parameters given a group, up to a constant of the log."""
        return float(self._together(group.kept.plus(self._statistics.kept.of(row))) - self._together(group.kept))

    def _together(self, kept: Evidence) -> Array:
        """Return the log density (…) of kept parameters of one instrument.

        Their true values and the scatter of the bias are marginalised.
        """
        values = []
        for prior in self._priors:
            both = kept.information + np.diag(prior)
            mean = np.linalg.solve(both, kept.weighted[..., None])[..., 0]
            gain = (kept.weighted * mean).sum(axis=-1) - np.linalg.slogdet(both)[1] + np.log(prior).sum()
            values.append(kept.constant + 0.5 * gain + self._scatters)
        density: Array = np.logaddexp.reduce(np.concatenate(values, axis=-1), axis=-1)
        return density

    def _iron_gain(self, row: int, group: Group) -> float:
        """Return the nats by which a log's hard iron is likelier near those of a group than for an arbitrary
        instrument.
        """
        others = [self._row[i] for i in group.logs]
        iron, covariance = self._statistics.hard_iron, self._statistics.hard_iron_covariance
        both = covariance[others] + covariance[row] + np.eye(3) * self._model.hard_iron_scatter**2
        stayed = log_density(iron[others] - iron[row], both)
        nearest = float(np.logaddexp.reduce(stayed)) - np.log(len(others)) - float(self._statistics.anywhere[row])
        return float(np.logaddexp(np.log(1 - STAYED), np.log(STAYED) + nearest))
