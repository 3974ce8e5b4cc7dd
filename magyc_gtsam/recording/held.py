"""Why a magnetometer's log repeats values: it is polled faster than it measures, or its steps are coarse.

A hold repeats all axes together and is no new sample; a coarse step repeats each axis independently, and each entry is
a sample. To leave these out would keep the first of each run, and so make the magnetometer seem early: by 8 ms on a
ship, by 3 ms on a car at steps of 0.6 µT and 20 Hz.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.recording.checks import Array, Mask
from magyc_gtsam.recording.recording import Recording

HELD = 0.08  # share of entries that exactly repeat the one before, above which they may be held
_ALONE = 0.1  # share of the entries in which single axes repeat, above which the steps are coarse
_LEFT = 0.7  # share of the repeated entries that chance must not explain: axes that pause together are not held
# share of the repeated entries that chance must explain: at coarse steps it does for 0.9 to 1, beside a hold for 0.3
_BY_CHANCE = 0.5
_RANDOM = 0.5  # position between the variances of run lengths by a clock (0) and by chance (1)
LONGEST = 10  # entries in a row that repeat by chance; a sensor that is stuck has more
_LOCALLY = 3.0  # s in which the probability of a repeat hardly changes
_ROWS = 100  # fewest rows from which a share is estimated
_SLOWEST = 30.0  # s after which fewer rows must do in a stream
_LATEST = 30  # stretches of a stream that count, so that motion soon prevails over a rest before it


@dataclass(frozen=True)
class RepeatedEntries:
    """The repeated entries of a magnetometer's log.

    Attributes:
        share: share of the entries in which all axes are held, apart from chance repeats of the single axes.
        held: whether the entries are those of a sensor that is polled faster than it measures.
        by_chance: whether the entries repeat because of coarse steps: each is a sample.
    """

    share: float
    held: bool
    by_chance: bool

    @classmethod
    def of(cls, recording: Recording) -> RepeatedEntries:
        """Count the repeats of a recording; at coarse steps those of a hold must also be regular."""
        own = recording.magnetic_field_stamped
        stale = float((~recording.magnetic_field_fresh[own]).mean())
        repeats = np.diff(recording.magnetic_field[own], axis=0) == 0
        counts = _counted(recording.time[own], repeats)
        share, coarse = _share_held(counts), _coarse(counts)
        unlikely = share > max(HELD, _LEFT * stale)
        held = bool(unlikely and (not coarse or _regular(repeats.all(axis=1))))
        return cls(share, held, coarse and share < _BY_CHANCE * stale)


def with_chance_repeats(recording: Recording) -> Recording:
    """Return the recording with repeated entries as samples if they repeat because of coarse steps.

    Of a longer run, which may be that of a sensor that is stuck, only the first entries are.
    """
    fresh, stamped = recording.magnetic_field_fresh, recording.magnetic_field_stamped
    if np.array_equal(fresh, stamped) or not RepeatedEntries.of(recording).by_chance:
        return recording
    entry = np.cumsum(stamped)
    last: np.ndarray = np.maximum.accumulate(np.where(fresh, entry, 0))  # the last entry so far that was fresh
    return replace(recording, magnetic_field_fresh=stamped & (entry - last <= LONGEST))


class RepeatsSoFar:
    """The repeats among a magnetometer's entries as they arrive, counted in constant time and memory.

    Attributes:
        by_chance: as in `RepeatedEntries` for the latest stretches of entries, 1 or 0; NaN before the first is over.
    """

    def __init__(self) -> None:
        self.by_chance = np.nan
        self._counts = np.empty((0, 5))
        self._open, self._since = np.zeros(5), np.nan  # the stretch that is not over: counts, and first stamp

    def take(self, time: Array, repeats: Mask) -> Array:
        """Count entries (n,) with the axes (n, 3) that repeat; return `by_chance` at each, (n,)."""
        result = np.full(len(time), self.by_chance)
        begin = 0
        while begin < len(time):
            if not self._open[0]:
                self._since = float(time[begin])
            last = self._last(time, begin)
            part = repeats[begin : last + 1]
            self._open = self._open + [len(part), *part.sum(axis=0), part.all(axis=1).sum()]
            if last < len(time):
                self._counts = np.vstack([self._counts, self._open])[-_LATEST:]
                self._open = np.zeros(5)
                together = self._counts[:, 4].sum() / self._counts[:, 0].sum()
                self.by_chance = float(_coarse(self._counts) and _share_held(self._counts) < _BY_CHANCE * together)
                result[last:] = self.by_chance
            begin = last + 1
        return result

    def _last(self, time: Array, begin: int) -> int:
        """Return the index of the entry with which the open stretch ends; len(time) or more if it goes on."""
        enough = begin + _ROWS - 1 - int(self._open[0])
        locally, slowest = (int(np.searchsorted(time, self._since + s)) for s in (_LOCALLY, _SLOWEST))
        return max(min(max(enough, locally), slowest), begin)

    def state(self) -> Mapping[str, Array]:
        """Return the state as named arrays, for `restore`."""
        return {"counts": self._counts, "open": np.array([self.by_chance, self._since, *self._open])}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Restore a state that `state` returned."""
        self._counts = state["counts"]
        self.by_chance, self._since = (float(v) for v in state["open"][:2])
        self._open = state["open"][2:].copy()


def _regular(repeats: Mask) -> bool:
    """Return whether repeated steps (n,) have the regular run lengths of a clock: one number of rows, or one more.

    Coarse steps repeat while the field hardly changes: their run lengths vary as by chance, or more.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], repeats.astype(int), [0]])))
    lengths = edges[1::2] - edges[::2]
    mean = float(lengths.mean())
    clock, chance = (mean % 1) * (1 - mean % 1), mean * (mean - 1)  # variances of the run length
    return bool(lengths.var() <= clock + _RANDOM * max(chance - clock, 0.0) + 1e-9)


def _counted(time: Array, repeats: Mask) -> Array:
    """Return the counts (k, 5) in each stretch: steps (n, 3), and those at which each axis and all axes repeat."""
    length = max(_LOCALLY, _ROWS * float(np.median(np.diff(time))))
    stretch = np.floor((time[1:] - time[0]) / length).astype(int)
    _, starts, steps = np.unique(stretch, return_index=True, return_counts=True)
    each = np.add.reduceat(repeats, starts, axis=0, dtype=float)
    return np.column_stack([steps, each, np.add.reduceat(repeats.all(axis=1), starts, dtype=float)])


def _coarse(counts: Array) -> bool:
    """Return whether the single axes repeat so often that the steps are coarse."""
    steps, *each, together = counts.sum(axis=0)
    return bool(sum(each) / (3 * steps) - together / steps > _ALONE)


def _share_held(counts: Array) -> float:
    """Return the share h of the steps at which all axes are held, apart from repeats of single axes.

    With q_i the probability of a repeat of axis i without a hold, an axis repeats with p_i = h + (1 − h) q_i and all
    three with h + (1 − h) q_x q_y q_z. This is solved for h in each stretch of `_counted` by bisection. The median
    over the stretches is returned: a hold is present all the time, a pause is not.
    """
    steps = counts[:, 0].astype(int)
    each, together = counts[:, 1:4] / steps[:, None], counts[:, 4] / steps
    low, high = np.zeros(len(counts)), each.min(axis=1)
    for _ in range(30):
        h = 0.5 * (low + high)
        free = np.maximum(1 - h, 1e-9)
        more = h + np.prod(np.maximum(each - h[:, None], 0.0) / free[:, None], axis=1) * free < together
        low, high = np.where(more, h, low), np.where(more, high, h)
    return float(np.median(np.repeat(0.5 * (low + high), steps)))
