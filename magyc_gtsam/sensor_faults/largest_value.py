"""Decide from the largest values of one side of an axis whether they are a full scale."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import betainc

from magyc_gtsam.recording import Array

_BAND = 30  # steps of the sensor below the largest value that count as near it
LEAST = 5  # samples at exactly the largest value, some of them consecutive
LEAST_STEPS = 100  # of the sensor up to a full scale: a converter of 8 bits has 127 on either side
_STEEP = 3.0  # steps of the sensor between the largest value and a neighbour; a turn that levels off is less steep
_CHANCE = 1e-7  # probability of so many samples at the largest value if all values of the band are equally likely
_EVEN = 0.9  # share of repeats from which the whole recording is taken to turn at constant rates (a simulation)
_REMEMBERED = 256  # stamps kept of samples at the largest value, before it is known to be a full scale


class SideOfBlock(NamedTuple):
    """The samples of a block near the largest value of one side of an axis.

    Attributes:
        at: (n,) bool, samples at the largest value.
        continued: (n,) bool, those of them that follow another.
        known: (n,) bool, samples since the value is known to be a full scale.
        decisive: rows at which it became known.
        stamps: s, samples at a full scale, including those of earlier blocks if it became known in this one.
    """

    at: np.ndarray
    continued: np.ndarray
    known: np.ndarray
    decisive: set[int]
    stamps: Array


class _Levels(NamedTuple):
    """The largest value so far, the level, at each of n samples.

    Attributes:
        level: (n,) the largest value so far.
        rises: (n,) bool, samples that are larger than all before.
        at: (n,) bool, samples at the level.
        was: (n,) bool, samples whose neighbour before is at the same level.
        number: (n,) how often the level has risen in this block.
        begin: (n,) the row at which the level was reached; 0 for that of the blocks before.
    """

    level: Array
    rises: np.ndarray
    at: np.ndarray
    was: np.ndarray
    number: np.ndarray
    begin: np.ndarray


class LargestValue:
    """The largest value of one side of an axis, and the statistics of the samples near it.

    Attributes:
        full_scale: the largest value known to be a full scale, rad/s; NaN without one.
    """

    def __init__(self) -> None:
        self.full_scale = np.nan
        self._level, self._at, self._known = -np.inf, False, False
        # Counts of: samples at the level, consecutive pairs of them while another axis moved, passages between the
        # level and a neighbour, steep passages, samples within the band below. Away from any level: pairs of
        # neighbours, and equal pairs.
        self._counts, self._away = np.zeros(5, dtype=int), np.zeros(2, dtype=int)
        self._near = np.empty((0, 2))  # values within the band, and their counts
        self._stamps = np.empty(0)

    def is_far(self, most: float, step: float) -> bool:
        """Return whether samples up to `most` are below the band and the last one was not at the largest value."""
        return not self._at and most < self._level - _BAND * step

    def pass_by(self, count: int, repeats: int) -> None:
        """Count samples that are far from the largest value, and how many of them repeat the one before."""
        self._away = self._away + [count, repeats]

    def observe(
        self,
        time: Array,
        x: Array,
        change: Array,
        moved: np.ndarray,
        step: Array,
        step_before: float,
        allowed: np.ndarray,
    ) -> SideOfBlock | None:
        """Take samples (n,) of this side; return None if none is near the largest value."""
        if self.is_far(float(x.max()), step_before):
            self.pass_by(len(x), int((change == 0).sum()))
            return None
        levels = self._follow(x)
        counts, away = self._count(x, change, moved, step, levels)
        possible = allowed & (levels.level >= LEAST_STEPS * step) & _may_be_full_scale(levels, counts, away)
        self._count_earlier(x, step, levels, counts, possible)
        sure = np.zeros(len(x), dtype=bool)
        # Binomial tail, with all values in the band equally likely.
        sure[possible] = betainc(counts[0, possible], counts[4, possible] + 1, 1 / (_BAND + 1)) < _CHANCE
        total = np.cumsum(sure)
        known = np.where(levels.number > 0, total - (total - sure)[levels.begin] > 0, self._known | (total > 0))
        side = self._side(time, levels, known)
        self._keep(time, x, step, levels, known)
        self._counts, self._away = counts[:, -1].copy(), away[:, -1].copy()
        return side

    def _follow(self, x: Array) -> _Levels:
        """Return the largest value so far at each sample."""
        record = np.maximum.accumulate(np.concatenate([[self._level], x]))
        level, rises = record[1:], record[1:] > record[:-1]
        at = x == level
        was = np.concatenate([[self._at], at[:-1]]) & ~rises
        begin = np.maximum.accumulate(np.where(rises, np.arange(len(x)), 0))
        return _Levels(level, rises, at, was, np.cumsum(rises), begin)

    def _count(
        self, x: Array, change: Array, moved: np.ndarray, step: Array, levels: _Levels
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return at each sample the counts (5, n) of its level and those (2, n) away from any, as in the state."""
        at, was, begin = levels.at, levels.was, levels.begin
        edge, away = at != was, ~(at | was)
        first = int(np.isnan(change[0]))  # the first sample of all has no neighbour
        edge[:first] = away[:first] = False
        near = ~at & (x > levels.level - _BAND * step)
        kinds = np.stack([at, at & was & moved, edge, edge & (change >= _STEEP * step), near])
        counts = np.cumsum(kinds, axis=1)
        counts = counts - np.where(levels.number > 0, (counts - kinds)[:, begin], -self._counts[:, None])
        return counts, self._away[:, None] + np.cumsum([away, away & (change == 0)], axis=1)

    def _count_earlier(
        self, x: Array, step: Array, levels: _Levels, counts: np.ndarray, possible: np.ndarray
    ) -> None:
        """Add to `counts` the samples near a level from before it was reached, for levels that may be a full scale."""
        rows = levels.begin[possible & (levels.number > 0)]
        for row in np.unique(np.append(rows, levels.begin[-1]) if levels.number[-1] else rows):
            low = levels.level[row] - _BAND * step[row]
            before = int(self._near[self._near[:, 0] > low, 1].sum()) + int((x[:row] > low).sum())
            counts[4, levels.begin == row] += before

    def _side(self, time: Array, levels: _Levels, known: np.ndarray) -> SideOfBlock:
        """Return the classification of the samples of a block."""
        became = known & (levels.rises | ~np.concatenate([[self._known], known[:-1]]))
        full_scale = np.isin(levels.number, levels.number[known])
        stamps = time[levels.at & full_scale]
        if full_scale[0] and not levels.number[0] and not self._known:
            stamps = np.concatenate([self._stamps, stamps])
        return SideOfBlock(levels.at, levels.at & levels.was, known, set(np.flatnonzero(became).tolist()), stamps)

    def _keep(self, time: Array, x: Array, step: Array, levels: _Levels, known: np.ndarray) -> None:
        """Keep the last level of a block, its stamps, and the values near it."""
        if known.any():
            self.full_scale = float(np.fmax(self.full_scale, levels.level[known].max()))
        last = levels.number[-1]
        stamps = self._stamps if not last else np.empty(0)
        self._stamps = np.concatenate([stamps, time[levels.at & (levels.number == last)]])[-_REMEMBERED:]
        self._level, self._at, self._known = float(levels.level[-1]), bool(levels.at[-1]), bool(known[-1])
        low = self._level - _BAND * step[-1]
        earlier, near = self._near[self._near[:, 0] > low], x[x > low]
        values, where = np.unique(np.concatenate([earlier[:, 0], near]), return_inverse=True)
        often = np.bincount(where, np.concatenate([earlier[:, 1], np.ones(len(near))]))
        self._near = np.column_stack([values, often])

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        return {
            "numbers": np.array([self.full_scale, self._level, self._at, self._known]),
            "counts": np.concatenate([self._counts, self._away]),
            "near": self._near,
            "stamps": self._stamps,
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self.full_scale, self._level = (float(v) for v in state["numbers"][:2])
        self._at, self._known = (bool(v) for v in state["numbers"][2:])
        self._counts, self._away = state["counts"][:5].copy(), state["counts"][5:].copy()
        self._near, self._stamps = state["near"], state["stamps"]


def _may_be_full_scale(levels: _Levels, counts: np.ndarray, away: np.ndarray) -> np.ndarray:
    """Return (n,) bool: samples at which the level has the form of a full scale, before the test of probability."""
    count, pairs, edges, steep, _ = counts
    others, repeats = away
    possible = (levels.at | levels.was) & (count >= LEAST) & (pairs > 0) & (edges > 0) & (2 * steep >= edges)
    return possible & ((others == 0) | (repeats < _EVEN * others))
