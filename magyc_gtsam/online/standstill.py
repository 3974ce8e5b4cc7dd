"""Axes that stand still, noticed while the samples come in, so that nothing is learnt from them.

The criteria are those of `estimators.stuck`. What they need are 100 samples, and by then most of a false axis would be
learnt; so from a few equal values in a row on samples are held back, until the axis moves (they are passed on), or it
is known that it is stuck (they are dropped, and all that follow until it moves). A magnetometer that repeats on all
axes brings no samples (`online.intake`); that it stands still is said if the gyroscope turned meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from magyc_gtsam.estimators.stuck import LEAST_DURATION, LEAST_SAMPLES, NOISY, white_noise
from magyc_gtsam.online.buffers import Rows
from magyc_gtsam.recording import Array, Samples

_SUSPECT = 6  # equal values in a row from which samples are held back
_AT_ONCE = 512  # samples looked at together
_LONGEST = 30.0  # s, for which a gyroscope that stands still on all axes is held back until the field has turned

Turned = Callable[[Array], bool | None]


class AxisWatch:
    """The watch over the axes of one sensor; what it does depends on the samples, not on how they are cut into calls.

    Attributes:
        stuck: (3,) bool, axes known to stand still.
        begun: (3,) s, since when each axis has its value; last: (4,) the sample last seen, time and value.
        dropped: samples that were dropped.
    """

    def __init__(self) -> None:
        self.stuck = np.zeros(3, dtype=bool)
        self.begun = np.full(3, np.nan)
        self.last = np.full(4, np.nan)
        self.dropped = 0
        self._run = np.zeros(3, dtype=int)  # equal values in a row
        self._step = np.inf  # smallest change of any axis
        self._held = Rows(4)
        self._examined = 0  # of the samples held
        self._waiting = Rows(4)  # samples that come after an examination that waits for the other sensor

    def take(self, new: Samples, turned: Turned, ended: Callable[[], None]) -> Samples:
        """What of the new samples, and of those held back, may be learnt from.

        Args:
            turned: whether the field turned while all axes stood still as in rows (n, 4); None while unknown. For
                a magnetometer: never.
            ended: called before an axis that was stuck moves again.
        """
        rows, passed = np.column_stack(new), []
        if not len(self._waiting) and not self._due() and len(rows) <= _AT_ONCE:
            count = self._harmless(rows)
            if count == len(rows):
                return new
            passed, rows = [rows[:count]], rows[count:]
        self._waiting.append(rows)
        while not self._due() or self._examine(passed, turned):
            count = self._harmless(self._waiting.rows[:_AT_ONCE])
            if count:
                passed.append(self._waiting.rows[:count].copy())
            elif len(self._waiting):
                count = 1
                self._next(self._waiting.rows[0].copy(), passed, ended)
            else:
                break
            self._waiting.cut(count)
        rows = np.vstack([np.empty((0, 4)), *passed])
        return Samples(rows[:, 0], rows[:, 1:])

    @property
    def until(self) -> float:
        """s, up to which the other sensor's samples are of no more interest; NaN before the first sample."""
        return float(self._held.rows[0, 0] if len(self._held) else self.last[0])

    def _harmless(self, rows: Array) -> int:
        """How many of the rows, from the first on, nobody need look at; they are taken note of."""
        if not len(rows) or len(self._held) or self.stuck.any():
            return 0
        change = np.abs(np.diff(rows[:, 1:], axis=0, prepend=self.last[None, 1:]))
        place = np.arange(len(rows))[:, None]
        moved = np.maximum.accumulate(np.where(change != 0, place, -1), axis=0)
        run = np.where(moved >= 0, place - moved + 1, self._run + place + 1)
        suspect = (run >= _SUSPECT).any(axis=1)
        count = int(suspect.argmax()) if suspect.any() else len(rows)
        if count:
            last = moved[count - 1]
            self.begun = np.where(last >= 0, rows[last, 0], self.begun)
            self._run, self.last = run[count - 1], rows[count - 1].copy()
            self._step = float(change[:count][change[:count] > 0].min(initial=self._step))
        return count

    def _next(self, row: Array, passed: list[Array], ended: Callable[[], None]) -> None:
        """One more sample, pass it, hold it back or drop it."""
        change = np.abs(row[1:] - self.last[1:])
        same = change == 0
        if (self.stuck & ~same).any():
            ended()
            self.stuck &= same
        self._step = float(change[change > 0].min(initial=self._step))
        self._run, self.begun = np.where(same, self._run + 1, 1), np.where(same, self.begun, row[0])
        self.last = row
        if self.stuck.any():
            self.dropped += 1
        elif (self._run >= _SUSPECT).any():
            self._held.append(row[None])
        else:
            self._release(passed)
            passed.append(row[None])

    def _due(self) -> bool:
        """Whether enough is held back to say more."""
        if len(self._held) - self._examined < LEAST_SAMPLES:
            return False
        time = self._held.rows[:, 0]
        return bool(time[-1] - time[0] >= LEAST_DURATION)

    def _examine(self, passed: list[Array], turned: Turned) -> bool:
        """Drop what is held back if an axis is stuck, else pass it on; False where it is too early to say."""
        rows = self._held.rows
        still = self._run >= len(rows)
        if still.all():
            answer = turned(rows)
            if answer is None:
                return False
            self.stuck = np.full(3, answer)
            if not answer and rows[-1, 0] - rows[0, 0] < _LONGEST:
                self._examined = len(rows)
                return True
        else:
            value = rows[1:, 1:][(np.diff(rows[:, 1:], axis=0) != 0).any(axis=1)]  # a held sensor repeats its rows
            for axis in np.flatnonzero(still):
                self.stuck[axis] = white_noise(np.delete(value, axis, axis=1)) >= NOISY * self._step
        if self.stuck.any():
            self.dropped += len(rows)
            self._held.cut(len(rows))
        self._release(passed)
        return True

    def _release(self, passed: list[Array]) -> None:
        passed.append(self._held.rows.copy())
        self._held.cut(len(self._held))
        self._examined = 0

    def state(self) -> Mapping[str, Array]:
        """For `restore`."""
        return {
            "axes": np.array([self.stuck, self.begun, self._run], dtype=float),
            "last": self.last,
            "counts": np.array([self.dropped, self._examined]),
            "step": np.array(self._step),
            "held": self._held.rows.copy(),
            "waiting": self._waiting.rows.copy(),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        stuck, self.begun, run = (row.copy() for row in state["axes"])
        self.stuck, self._run, self.last = stuck.astype(bool), run.astype(int), state["last"].copy()
        self.dropped, self._examined = (int(v) for v in state["counts"])
        self._step = float(state["step"])
        self._held.append(state["held"])
        self._waiting.append(state["waiting"])
