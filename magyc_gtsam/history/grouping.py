"""Which logs can be of one instrument: clustering by the evidence of what an instrument keeps.

An instrument keeps its soft iron, skew and gyroscope bias up to a scatter, and its hard iron unless something was
moved. A log joins the group that predicts it best, or begins one where "another instrument" predicts it better; logs
are taken out and assigned again until nothing changes, and groups are split where that is likelier (the moves of Neal
2000, algorithm 3, and of Jain and Neal 2004, at zero temperature).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.log_factor import GYRO_BIAS, HARD_IRON, MILLIRADIAN, SIZE, LogFactor
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.recording import Array

_SWEEPS = 10
_KEPT = np.r_[0:SHAPE, GYRO_BIAS]  # what stays
_WORTH_SPLITTING = 3  # logs
_CLEAR = (
    7.0  # nats, odds of a thousand, of a log that clearly belongs; simulated dives of one instrument: 17 and more
)
_STAYED = 0.8  # share of logs of an instrument whose hard iron is that of another of its logs


class Grouping:
    """Logs in groups, with what each group says of its instrument."""

    def __init__(
        self, factors: Sequence[LogFactor], model: HistoryModel, groups: Sequence[Sequence[int]] | None = None
    ) -> None:
        """Group all logs that have a calibration, or put them into groups that are known.

        Raises:
            MagycError: `groups` are not of these logs.
        """
        self._model = model
        self._priors = [
            np.r_[np.full(SHAPE, shape**-2), np.full(3, model.bias**-2), np.full(3, model.skew**-2)]
            for shape, _ in (model.raw, model.calibrated)
        ]
        self._groups: list[_Group] = []
        self._group_of: dict[int, _Group] = {}
        self._seen = len(factors)
        self._row = {i: row for row, i in enumerate(i for i, f in enumerate(factors) if f.mean is not None)}
        self._logs = _Logs.of([factors[i] for i in self._row], model)
        if groups is not None:
            if sorted(i for group in groups for i in group) != list(self._row):
                raise MagycError("history: its groups are not those of its logs")
            for group in groups:
                self._groups.append(_Group(SHAPE + 6))
                for i in group:
                    self._put(i, self._groups[-1])
            return
        surest_first = sorted(self._row, key=lambda i: self._logs.log_volume[self._row[i]])
        for i in surest_first:
            self._assign(i)
        self._settle(surest_first)
        for found in tuple(self._groups):
            self._split(found)

    def add(self, factors: Sequence[LogFactor]) -> None:
        """Take more logs, and assign again what they may have moved.

        That is all logs but those of the largest group; of these, too, those that another group suits better, where
        one of the new logs does not clearly belong to the group: one that does says nothing against the others.
        """
        more = [self._seen + k for k, factor in enumerate(factors) if factor.mean is not None]
        self._seen += len(factors)
        if not more:
            return
        self._row |= {i: len(self._row) + k for k, i in enumerate(more)}
        self._logs = self._logs.with_more(_Logs.of([f for f in factors if f.mean is not None], self._model))
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
        for found in tuple(self._groups):
            self._split(found)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Indices, the largest group first, each ascending; logs without a calibration are in none."""
        return tuple(sorted((tuple(sorted(g.logs)) for g in self._groups), key=lambda group: (-len(group), group)))

    def _settle(self, logs: Sequence[int]) -> None:
        """Take logs out and assign them again until nothing changes."""
        for _ in range(_SWEEPS):
            before = self.groups
            for i in logs:
                self._take_out(i)
                self._assign(i)
            if self.groups == before:
                break

    def _split(self, group: _Group) -> None:
        """Let the least fitting log of a group begin another, which others may join, where that is likelier.

        One log at a time never leaves a group in which a second one of its own instrument is.
        """
        if len(group.logs) < _WORTH_SPLITTING:
            return
        before, evidence = [(list(g.logs), g.information, g.weighted) for g in self._groups], self._evidence()
        fits = self._fit(group.logs, group)
        least = int(np.argmin(fits))
        weakest, worst = group.logs[least], float(fits[least])
        others = [i for i in group.logs if i != weakest]
        self._take_out(weakest)
        begun = _Group(SHAPE + 6)
        self._groups.append(begun)
        self._put(weakest, begun)
        follow = self._fit(others, begun, inside=False) - self._fit(others, group)
        if float(np.maximum(follow, 0.0).sum()) > self._model.same + worst:
            self._settle([*others, weakest])
        if len(begun.logs) < 2 or self._evidence() <= evidence:
            self._groups = [_Group(SHAPE + 6, *each) for each in before]
            self._group_of = {i: each for each in self._groups for i in each.logs}

    def _evidence(self) -> float:
        """Nats of this grouping by what stays."""
        each = [
            self._together(g.information, g.weighted) + self._model.same * (len(g.logs) - 1) for g in self._groups
        ]
        empty = _Group(SHAPE + 6)
        return float(sum(each) - len(each) * self._together(empty.information, empty.weighted))

    def _fit(self, logs: Sequence[int], group: _Group, *, inside: bool = True) -> Array:
        """(n,) by how much logs' soft iron and bias are likelier with a group, in which they are or not, than alone."""
        rows = [self._row[i] for i in logs]
        information, weighted = self._logs.information[rows], self._logs.weighted[rows]
        others, of_others = group.information, group.weighted
        if inside:
            others, of_others = others - information, of_others - weighted
        together = self._together(others + information, of_others + weighted) - self._together(others, of_others)
        nothing = _Group(SHAPE + 6)
        alone = self._together(information, weighted) - self._together(nothing.information, nothing.weighted)
        fit: Array = together - alone
        return fit

    def _take_out(self, i: int) -> None:
        own = self._group_of.pop(i)
        own.change(i, self._logs.information[self._row[i]], self._logs.weighted[self._row[i]], -1)
        if not own.logs:
            self._groups.remove(own)

    def _put(self, i: int, group: _Group) -> None:
        row = self._row[i]
        group.change(i, self._logs.information[row], self._logs.weighted[row], 1)
        self._group_of[i] = group

    def _assign(self, i: int) -> None:
        """Put a log where its evidence is greatest."""
        nothing = _Group(SHAPE + 6)
        row = self._row[i]
        alone = self._kept_given(row, nothing)
        kept = np.array([self._kept_given(row, group) + self._model.same - alone for group in self._groups])
        # The hard iron need not be compared where it cannot change the choice.
        low, high = kept + np.log(1 - _STAYED), kept + self._logs.most_iron[row]
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

    def _kept_given(self, row: int, group: _Group) -> float:
        """Log density of a log's soft iron and bias given its instrument's others, but for a constant of the log."""
        information, weighted = self._logs.information[row], self._logs.weighted[row]
        with_it = self._together(group.information + information, group.weighted + weighted)
        return float(with_it - self._together(group.information, group.weighted))

    def _together(self, information: Array, weighted: Array) -> Array:
        """Log density of soft irons and biases of one instrument, whose own are integrated out over both priors.

        Of (…, k, k) information and (…, k) information times mean: (…).
        """
        values = []
        for prior in self._priors:
            both = information + np.diag(prior)
            mean = np.linalg.solve(both, weighted[..., None])[..., 0]
            gain = (weighted * mean).sum(axis=-1) - np.linalg.slogdet(both)[1] + np.log(prior).sum()
            values.append(0.5 * gain)
        density: Array = np.logaddexp(*values)
        return density

    def _iron_gain(self, row: int, group: _Group) -> float:
        """By how much a log's hard iron is likelier with others of its instrument than anywhere."""
        others = [self._row[i] for i in group.logs]
        iron, spread = self._logs.iron, self._logs.iron_spread
        both = spread[others] + spread[row] + np.eye(3) * self._model.hard_iron_scatter**2
        stayed = _log_density(iron[others] - iron[row], both)
        nearest = float(np.logaddexp.reduce(stayed)) - np.log(len(others)) - float(self._logs.anywhere[row])
        return float(np.logaddexp(np.log(1 - _STAYED), np.log(_STAYED) + nearest))


@dataclass(frozen=True, eq=False)
class _Logs:
    """What the comparison needs of each log, one row each.

    Attributes:
        information, weighted: on what stays, and information times mean.
        iron, iron_spread: µT, hard iron and covariance; anywhere: its log density among all instruments.
        most_iron: nats, the most that a comparison of hard irons can give.
        log_volume: of the covariance, smaller is surer.
    """

    information: Array
    weighted: Array
    iron: Array
    iron_spread: Array
    anywhere: Array
    most_iron: Array
    log_volume: Array

    @classmethod
    def of(cls, factors: Sequence[LogFactor], model: HistoryModel) -> _Logs:
        """Of logs that have a calibration."""
        mean = np.array([factor.mean for factor in factors]).reshape(-1, SIZE)
        covariance = np.array([factor.covariance for factor in factors]).reshape(-1, SIZE, SIZE)
        scatter = np.diag(np.r_[np.full(SHAPE, model.scatter**2), np.full(3, model.bias_scatter**2)])
        skew, known = _skews(factors, model)
        information = np.zeros((len(factors), SHAPE + 6, SHAPE + 6))
        information[:, : SHAPE + 3, : SHAPE + 3] = np.linalg.inv(covariance[:, _KEPT[:, None], _KEPT] + scatter)
        information[:, SHAPE + 3 :, SHAPE + 3 :] = known
        iron, spread = mean[:, HARD_IRON], covariance[:, HARD_IRON, HARD_IRON]
        wide = [_log_density(iron, spread + np.eye(3) * h**2) for _, h in (model.raw, model.calibrated)]
        anywhere = np.logaddexp(*wide) + np.log(0.5)
        peak = _log_density(np.zeros(3), spread + np.eye(3) * model.hard_iron_scatter**2)
        return cls(
            information,
            np.einsum("kij,kj->ki", information, np.hstack([mean[:, _KEPT], skew])),
            iron,
            spread,
            anywhere,
            np.logaddexp(np.log(1 - _STAYED), np.log(_STAYED) + peak - anywhere),
            np.linalg.slogdet(covariance)[1],
        )

    def with_more(self, others: _Logs) -> _Logs:
        """These and the others."""
        return _Logs(
            *(np.concatenate([getattr(self, field.name), getattr(others, field.name)]) for field in fields(self))
        )


class _Group:
    """Logs of one instrument, and the sums of what they say of it."""

    def __init__(
        self, size: int, logs: Sequence[int] = (), information: Array | None = None, weighted: Array | None = None
    ) -> None:
        self.logs = list(logs)
        self.information = np.zeros((size, size)) if information is None else information
        self.weighted = np.zeros(size) if weighted is None else weighted

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
