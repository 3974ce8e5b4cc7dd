"""Detect stuck axes: readings that remain constant when those of a working sensor would not.

Causes are a broken chip, a frozen bus or a column that was never filled in. A repeated value alone is not a fault: a
coarse sensor at rest repeats for minutes, and a simulation without noise may turn about one axis only. An axis counts
as stuck if another axis of the same sensor shows noise of 1.5 steps or more meanwhile. A whole gyroscope counts as
stuck if the field turned meanwhile, unless it reads a constant nonzero rate and the magnetometer shows no noise either,
as in a simulated turn at constant rate. A magnetometer that repeats on all axes is found by `repeats`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.sensor_faults.noise import white_noise

LEAST_SAMPLES = 100  # consecutive; with noise of half a step a working axis repeats this often once in 10¹⁵
LEAST_DURATION = 2.0  # s
_SUSPECT = 6  # consecutive equal values from which samples are held back
_LONGEST = 30.0  # s, longest time that a gyroscope stuck on all axes is held back while the field does not turn
_NOISY = 1.5  # steps of noise on one axis from which a working axis must show noise, too
_TURNED = 0.2  # sweep of the field over its median strength that excludes rest
_REMEMBERED = 50  # latest stretches kept

Turned = Callable[[Array], bool | None]


class Stretch(NamedTuple):
    """Axes (3,) bool that were stuck at `value` (3,) from `start` to `end`, s.

    `held` is the stamp, s, of the first sample that could still be held back from an estimator.
    """

    axes: tuple[bool, ...]
    value: tuple[float, ...]
    start: float
    end: float
    held: float


class _Compared(NamedTuple):
    """Samples compared with those before.

    Attributes:
        rows: (n, 4) time and value.
        same: (n, 3) bool, axes that repeat their value.
        run: (n, 3) consecutive equal values up to here.
        begun: (n, 3) s, stamp from which each axis has its value.
        step: (n,) smallest change of any axis so far.
    """

    rows: Array
    same: np.ndarray
    run: np.ndarray
    begun: Array
    step: Array


class StuckAxes:
    """Find the stuck axes of one sensor; a `gate.Detector`.

    From six consecutive equal values on, samples are undecided until the axis moves or until a hundred of them show
    that it is stuck. A stuck axis is rejected until it moves.

    Args:
        turned: called with the rows (n, 4) of time and value during which all axes were constant; returns whether the
            field turned meanwhile, or None while that is not known. Not called for a magnetometer.
        longest: time after which a constant gyroscope counts as at rest if the field does not turn, s.
        remembered: number of the latest stretches that are kept; None keeps all.
    """

    def __init__(
        self, turned: Turned = lambda rows: False, longest: float = _LONGEST, remembered: int | None = _REMEMBERED
    ) -> None:
        self.pending = np.inf
        self._turned, self._longest = turned, longest
        self._kept = slice(None if remembered is None else -remembered, None)
        self._stuck = np.zeros(3, dtype=bool)
        self._begun = np.full(3, np.nan)  # s, stamp from which each axis has its value
        self._run = np.zeros(3, dtype=int)  # consecutive equal values
        self._last = np.full(4, np.nan)  # time and value
        self._step = np.inf  # smallest change of any axis
        self._held = np.empty((0, 4))
        self._examined = 0  # number of held samples that were examined
        self._waiting = np.empty((0, 4))  # samples after an examination that waits for the other sensor
        self._stretches: list[Stretch] = []  # the last one is still open while an axis is stuck

    def observe(self, block: Samples) -> None:
        """Take the next samples."""
        rows = np.vstack([self._waiting, np.column_stack(block)])
        self._waiting = rows[:0]
        if self._due() and not self._examine():
            self._waiting = rows
        elif len(rows):
            self._take(rows)
        self.pending = min([part[0, 0] for part in (self._held, self._waiting) if len(part)], default=np.inf)

    def conclude(self) -> None:
        """Decide about the held samples; called after the last sample."""
        if len(self._held) >= LEAST_SAMPLES and self._held[-1, 0] - self._held[0, 0] >= LEAST_DURATION:
            self._examine()

    def _take(self, rows: Array) -> None:
        """Take samples (n, 4) of time and value until one waits for the other sensor."""
        block, n = self._compared(rows), len(rows)
        suspect = np.any(block.run >= _SUSPECT, axis=1)
        if not len(self._held) and not self._stuck.any() and not suspect.any():
            self._note(block, n - 1)
            return
        asked = self._suspects(suspect)
        i = 0
        while i < n:
            if self._stuck.any():
                i = self._follow(block, i)
                continue
            following = asked[asked[:, 1] > i]
            first, end = following[0].tolist() if len(following) else (n, n)
            if first > i:
                self._held, self._examined = self._held[:0], 0
                i = first
                continue
            i = self._hold(block, i, end)
            if self._due() and not self._examine():
                self._waiting = rows[i:].copy()
                return
            if i == end < n and not self._stuck.any():
                self._held, self._examined = self._held[:0], 0
        self._note(block, n - 1)

    def _compared(self, rows: Array) -> _Compared:
        """Compare samples with those before."""
        change = np.abs(np.diff(rows[:, 1:], axis=0, prepend=self._last[None, 1:]))
        same, place = change == 0, np.arange(len(rows))[:, None]
        moved = np.maximum.accumulate(np.where(same, -1, place), axis=0)  # row from which an axis has its value
        run = np.where(moved >= 0, place - moved + 1, self._run + place + 1)
        begun = np.where(moved >= 0, rows[moved, 0], self._begun)
        smallest = np.where(change > 0, change, np.inf).min(axis=1)
        return _Compared(rows, same, run, begun, np.minimum(np.minimum.accumulate(smallest), self._step))

    def _note(self, block: _Compared, row: int) -> None:
        """Keep what is known at a row as the state."""
        self._run, self._begun = block.run[row], block.begun[row]
        self._last, self._step = block.rows[row].copy(), float(block.step[row])

    def _suspects(self, suspect: np.ndarray) -> np.ndarray:
        """Return the stretches (k, 2) of suspects, first row and end, that may be stuck.

        A short stretch that begins and ends in this block can be ignored.
        """
        edges = np.flatnonzero(np.diff(suspect.astype(int), prepend=0, append=0)).reshape(-1, 2)
        size = edges[:, 1] - edges[:, 0]
        carried = (edges[:, 0] == 0) & (len(self._held) > 0)
        return edges[carried | (size >= LEAST_SAMPLES) | (edges[:, 1] == len(suspect))]

    def _follow(self, block: _Compared, i: int) -> int:
        """Extend the open stretch from row `i` on until a stuck axis moves; return that row."""
        moving = np.any(~block.same[i:, self._stuck], axis=1)
        stop = i + int(moving.argmax()) if moving.any() else len(moving) + i
        if stop > i:
            self._note(block, stop - 1)
            self._stretches[-1] = self._stretches[-1]._replace(end=float(block.rows[stop - 1, 0]))
        if stop < len(block.rows):
            self._stuck = self._stuck & block.same[stop]
            if self._stuck.any():
                self._note(block, stop)
                self._open(float(block.rows[stop, 0]))
        return stop

    def _hold(self, block: _Compared, i: int, end: int) -> int:
        """Hold suspects from row `i` on until the next examination or `end`; return the row after them."""
        # At least one more, since rounding may make two seconds slightly less than two.
        need = max(max(LEAST_SAMPLES, 2 * self._examined) - len(self._held), 1)
        time = block.rows[:, 0]
        since = self._held[0, 0] if len(self._held) else time[i]
        stop = min(max(i + need, int(np.searchsorted(time, since + LEAST_DURATION)) + 1), end)
        self._held = np.vstack([self._held, block.rows[i:stop]])
        self._note(block, stop - 1)
        return stop

    def _due(self) -> bool:
        """Return whether enough samples are held for the next examination."""
        if len(self._held) < max(LEAST_SAMPLES, 2 * self._examined):
            return False
        return bool(self._held[-1, 0] - self._held[0, 0] >= LEAST_DURATION)

    def _examine(self) -> bool:
        """Decide about the held samples or hold them longer; return False while the other sensor's are missing."""
        rows, still = self._held, self._run >= len(self._held)
        if still.all():
            answer = self._turned(rows)
            if answer is None:
                return False
            if not answer and rows[-1, 0] - rows[0, 0] < self._longest:
                self._examined = len(rows)
                return True
            self._stuck = np.full(3, answer)
        else:
            value = rows[1:, 1:][
                (np.diff(rows[:, 1:], axis=0) != 0).any(axis=1)
            ]  # without repeated rows, which are no samples
            noisy = [white_noise(np.delete(value, axis, axis=1)) >= _NOISY * self._step for axis in range(3)]
            self._stuck = still & noisy
        if self._stuck.any():
            self._open(float(rows[0, 0]))
        self._held, self._examined = rows[:0], 0
        return True

    def _open(self, held: float) -> None:
        """Begin a stretch of the axes that are stuck now."""
        axes, value = tuple(self._stuck.tolist()), tuple(self._last[1:].tolist())
        start, end = float(self._begun[self._stuck].min()), float(self._last[0])
        self._stretches = [*self._stretches, Stretch(axes, value, start, end, held)][self._kept]

    def rejects(self, time: Array) -> np.ndarray:
        """Return (n,) bool: the samples at which an axis was known to be stuck."""
        result = np.zeros(len(time), dtype=bool)
        for stretch in self._stretches:
            if len(time) and stretch.end >= time[0]:
                result |= (time >= stretch.held) & (time <= stretch.end)
        return result

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """The stretches in which axes were stuck."""
        return tuple(self._stretches)

    @property
    def now(self) -> tuple[Stretch, ...]:
        """The stretch that is not over, if there is one."""
        return tuple(self._stretches[-1:]) if self._stuck.any() else ()

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        return {
            "axes": np.array([self._stuck, self._begun, self._run], dtype=float),
            "last": self._last,
            "numbers": np.array([self.pending, self._step, self._examined]),
            "held": self._held,
            "waiting": self._waiting,
            "stretches": np.array([[*s.axes, *s.value, *s[2:]] for s in self._stretches]).reshape(-1, 9),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        stuck, self._begun, run = (row.copy() for row in state["axes"])
        self._stuck, self._run = stuck.astype(bool), run.astype(int)
        self.pending, self._step = (float(v) for v in state["numbers"][:2])
        self._examined = int(state["numbers"][2])
        self._last, self._held, self._waiting = state["last"], state["held"], state["waiting"]
        self._stretches = [
            Stretch(tuple(bool(v) for v in row[:3]), tuple(row[3:6]), *row[6:])
            for row in state["stretches"].tolist()
        ]


def field_turned(field: Array, rate: Array) -> bool:
    """Return whether a field (n, 3) turned more than a gyroscope that reads a constant `rate` (3,) allows."""
    if len(field) < 3:
        return False
    low, high = np.percentile(field, (5, 95), axis=0)
    strength = float(np.median(np.linalg.norm(field, axis=1)))
    turned = float(np.linalg.norm(high - low)) > _TURNED * strength
    return turned and (not rate.any() or white_noise(field) > 0)
