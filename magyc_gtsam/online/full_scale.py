"""Turns that the gyroscope's full scale cut off, noticed while the samples come in, so that nothing is learnt across.

The criteria are those of `estimators.clipped`. What they need of the past are a few counts for either side of each
axis, about its largest value so far. Samples that repeat such a value are held back until the run of them is over (they
are passed on), or it is known that it is a full scale: they are dropped, and with them all that follow until there is a
hole as long as the batch makes it. It begins with the first sample that was cut off; the batch puts half of it before.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magyc_gtsam.estimators.clipped import BAND, Clipped, Peak, hole, steep
from magyc_gtsam.online.buffers import Rows
from magyc_gtsam.recording import Array, Samples

_STAMPS = 33  # gyroscope samples after which their median step is taken to be known; nothing is dropped before
_LEARNT = 500  # samples unlike the one before, after which the smallest change of an axis is
_MOST_HELD = 100  # samples; that a rate stands still for longer, others watch


class Side:
    """The largest value of an axis to one side, and what happens about it.

    Attributes:
        level: rad/s, largest value so far; at: whether the last sample is at it, was: the one before.
        found: whether a full scale cut it off.
    """

    def __init__(self) -> None:
        self.level = -np.inf
        self.at = self.was = self.found = False
        self._count = self._pairs = self._edges = self._steep = 0
        self._below = np.zeros(BAND, dtype=int)  # samples so many steps below it

    def take(self, value: float, change: float, step: float, moved: bool) -> None:
        """One more sample, its change (NaN: the first one), the sensor's step, and whether any axis moved."""
        self.was = self.at
        if value > self.level:
            self._rise(value, step)
        self.at = value == self.level
        self._count += self.at
        self._pairs += self.at and self.was and moved
        if self.at != self.was and not np.isnan(change):
            self._edges += 1
            self._steep += bool(change >= steep(step))
        away = self.level - value
        if 0 < away < BAND * step:
            self._below[min(max(round(away / step), 1), BAND) - 1] += 1

    def count_below(self, value: Array, step: Array) -> None:
        """Take note of samples (n,) that are all below the largest value."""
        away = self.level - value
        near = away < BAND * step
        if near.any():
            steps = np.clip(np.rint(away[near] / step[near]), 1, BAND).astype(int)
            np.add.at(self._below, steps - 1, 1)

    def _rise(self, value: float, step: float) -> None:
        away = value - self.level
        below = np.concatenate([[self._count], self._below])
        self._below = np.zeros(BAND, dtype=int)
        if away < BAND * step:
            steps = max(round(away / step), 1)
            self._below[steps - 1 :] = below[: BAND + 1 - steps]
        self.level, self.was = value, False
        self._count = self._pairs = self._edges = self._steep = 0

    def cut_off(self, others: int, repeats: int) -> bool:
        """Whether it is a full scale, at which the last sample is or the one before was."""
        if not self._pairs or not (self.at or self.was):
            return False
        near = int(self._below.sum())
        return Peak(self._count, self._pairs, self._edges, self._steep, near, others, repeats).cut_off

    def state(self) -> Array:
        """For `restore`."""
        numbers = [self.level, self.at, self.found, self._count, self._pairs, self._edges, self._steep]
        return np.concatenate([numbers, self._below])

    def restore(self, state: Array) -> None:
        """Continue from `state`."""
        self.level, self.at, self.found = float(state[0]), bool(state[1]), bool(state[2])
        self._count, self._pairs, self._edges, self._steep = (int(v) for v in state[3:7])
        self._below = state[7:].astype(int)


class FullScaleWatch:
    """The watch over the gyroscope's largest values; what it does depends on the samples, not on how they are cut into
    calls.

    Attributes:
        dropped: samples that were dropped.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._taken = 0
        self._last = np.full(4, np.nan)  # time and value
        self._stamps = np.empty(0)  # s, the first ones
        self._step, self._moved = np.inf, 0  # smallest change of any axis, and of how many samples
        self._repeats = np.zeros(
            (2, 3), dtype=int
        )  # neighbours among these of which none is at a largest value; equal
        self._sides = tuple(Side() for _ in range(6))  # x, y, z and −x, −y, −z
        self._near = self._band()
        self._held = Rows(4)  # a run at a largest value, of which more must be known
        self._run = 0  # samples of the run
        self._until = -np.inf  # s, end of the hole
        self._count, self._first = 0, np.nan  # samples that were cut off, and the first's stamp

    def take(self, new: Samples) -> Samples:
        """What of the new samples, and of those held back, may be learnt from."""
        time, value = new
        if not len(time):
            return new
        low, high = self._near
        far = self._moved >= _LEARNT and (value > low).all() and (value < high).all()
        if far and self._quiet(time[0]):
            self._note(time, value)
            return new
        self._stamps = np.append(self._stamps, time[: _STAMPS - len(self._stamps)])
        return self._examined(np.column_stack(new))

    @property
    def clipped(self) -> Clipped | None:
        """What was cut off so far."""
        found = [side.found for side in self._sides]
        if not any(found):
            return None
        axes = "".join(axis for axis, *was in zip("xyz", found[:3], found[3:], strict=True) if any(was))
        level = max(side.level for side in self._sides if side.found)
        return Clipped(axes, level, self._count, self._first, self.dropped / self._taken)

    @property
    def now(self) -> bool:
        """Whether the last sample was left out."""
        return bool(self._last[0] <= self._until)

    @property
    def _level(self) -> Array:
        return np.array([side.level for side in self._sides])

    def _band(self) -> tuple[Array, Array]:
        """(3,) twice, rad/s, between which no sample is near a largest value of its axis."""
        near = self._level - BAND * self._step
        return -near[3:], near[:3]

    def _quiet(self, since: float) -> bool:
        """Whether what comes from `since` s on passes as long as it stays below the largest values."""
        x, y, z, minus_x, minus_y, minus_z = self._sides
        at = x.at or y.at or z.at or minus_x.at or minus_y.at or minus_z.at
        return since > self._until and not at

    def _note(self, time: Array, value: Array) -> None:
        self._taken += len(time)
        self._last[0], self._last[1:] = time[-1], value[-1]

    def _examined(self, rows: Array) -> Samples:
        """What may be learnt from of samples of which some come near a largest value, or of the first ones."""
        time, value = rows[:, 0], rows[:, 1:]
        sides = np.hstack([value, -value])
        change = np.abs(np.diff(value, axis=0, prepend=self._last[None, 1:]))
        moved = np.asarray((change > 0).any(axis=1))
        learn = self._moved + np.cumsum(moved) - moved < _LEARNT
        smallest = np.where((change > 0) & learn[:, None], change, np.inf).min(axis=1)
        step = np.minimum(np.minimum.accumulate(smallest), self._step)
        self._moved += int((moved & learn).sum())
        passed, i = [np.empty((0, 4))], 0
        while i < len(rows):
            if self._quiet(time[i]):
                top = (sides[i:] >= self._level).any(axis=1)
                end = i + int(top.argmax()) if top.any() else len(rows)
                if end > i:
                    for side, values in zip(self._sides, sides[i:end].T, strict=True):
                        side.count_below(values, step[i:end])
                    learnt = change[i:end][learn[i:end]]
                    self._repeats += np.array([np.full(3, len(learnt)), (learnt == 0).sum(axis=0)])
                    self._note(time[i:end], value[i:end])
                    passed.append(rows[i:end])
                    i = end
                    continue
            before = float(self._last[0])
            for side, one, by in zip(self._sides, sides[i].tolist(), 2 * change[i].tolist(), strict=True):
                side.take(one, by, float(step[i]), bool(moved[i]))
            if learn[i]:
                self._count_repeat(change[i].tolist())
            self._note(time[i : i + 1], value[i : i + 1])
            self._decide(rows[i], before, passed)
            i += 1
        self._step = float(step[-1])
        self._near = self._band()
        result = np.vstack(passed)
        return Samples(result[:, 0], result[:, 1:])

    def _count_repeat(self, change: list[float]) -> None:
        """Take note of one change (3,), of axes that neither are at a largest value nor were."""
        for axis, by in enumerate(change):
            up, down = self._sides[axis], self._sides[axis + 3]
            if not (up.at or up.was or down.at or down.was):
                self._repeats[0, axis] += 1
                self._repeats[1, axis] += by == 0

    def _decide(self, row: Array, before: float, passed: list[Array]) -> None:
        """Pass, hold back or drop a sample at a largest value or in a hole, or the first one after; the one before has
        its stamp at `before` s."""
        known: list[Side] = []
        if self._taken >= _STAMPS:
            repeats = 2 * self._repeats.T.tolist()
            known = [side for side, of in zip(self._sides, repeats, strict=True) if side.cut_off(*of)]
        at, continues = any(s.at for s in self._sides), any(s.at and s.was for s in self._sides)
        if any(s.at for s in known):
            self._drop(known, np.vstack([self._held.rows, row]), float(row[0]))
        elif known and len(self._held):
            self._drop(known, self._held.rows.copy(), before)
            self.dropped += 1
        elif row[0] <= self._until:
            self.dropped += 1
        else:
            if len(self._held) and (not continues or self._run >= _MOST_HELD):
                passed.append(self._held.rows.copy())
                self._held.cut(len(self._held))
            if at and self._run < _MOST_HELD:
                self._held.append(row[None])
            else:
                passed.append(row[None])
            self._run = self._run + 1 if continues else int(at)

    def _drop(self, known: list[Side], rows: Array, last: float) -> None:
        """Leave out rows that were cut off, and what follows the `last` of them until the hole is long enough."""
        for side in known:
            side.found = True
        self._first = float(np.fmin(self._first, rows[0, 0]))
        self._count += len(rows)
        self.dropped += len(rows)
        self._held.cut(len(self._held))
        self._run = 0
        self._until = last + hole(float(np.median(np.diff(self._stamps))))

    def state(self) -> Mapping[str, Array]:
        """For `restore`."""
        return {
            "last": self._last.copy(),
            "stamps": self._stamps,
            "sides": np.array([side.state() for side in self._sides]),
            "repeats": self._repeats.copy(),
            "held": self._held.rows.copy(),
            "counts": np.array([self.dropped, self._taken, self._run, self._count, self._moved]),
            "levels": np.array([self._step, self._until, self._first]),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._last, self._stamps, self._repeats = (state[name].copy() for name in ("last", "stamps", "repeats"))
        for side, row in zip(self._sides, state["sides"], strict=True):
            side.restore(row)
        self._held.append(state["held"])
        counts = (int(v) for v in state["counts"])
        self.dropped, self._taken, self._run, self._count, self._moved = counts
        self._step, self._until, self._first = (float(v) for v in state["levels"])
        self._near = self._band()
