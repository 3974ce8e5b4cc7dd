"""Why a magnetometer's log repeats values: it is polled faster than it measures, or its steps are coarse.

A hold repeats all axes together and is no new sample; a coarse step repeats each axis independently, and each entry is
a sample. To leave these out would keep the first of each run, and so make the magnetometer seem early: by 8 ms on a
ship, by 3 ms on a car at steps of 0.6 µT and 20 Hz. Where both happen, every so many entries are a sample, whether it
equals the one before or not.
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
_WHOLE = 0.05  # distance of the entries to a sample from a whole number, within which it is that number
_LONGEST_RUN = 40  # entries; longer runs are counted as this
_RANDOM = 0.5  # position between the variances of run lengths by a clock (0) and by chance (1)
LONGEST = 10  # samples in a row that repeat by chance; a sensor that is stuck has more
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
        rows: entries to a sample: more than 1 if samples that may equal each other are held, 1 if entries repeat
            because of coarse steps only, inf if equal entries are one sample.
    """

    share: float
    held: bool
    rows: float

    @classmethod
    def of(cls, recording: Recording) -> RepeatedEntries:
        """Count the repeats of a recording; at coarse steps those of a hold must also be regular."""
        own = recording.magnetic_field_stamped
        stale = float((~recording.magnetic_field_fresh[own]).mean())
        repeats = np.diff(recording.magnetic_field[own], axis=0) == 0
        counts = _counted(recording.time[own], repeats)
        share, coarse = _share_held(counts), _repeat_alone(counts)[0] > _ALONE
        runs = np.diff(np.flatnonzero(recording.magnetic_field_fresh[own]))
        unlikely = share > max(HELD, _LEFT * stale)
        held = bool(unlikely and (not coarse or _regular(repeats.all(axis=1))))
        return cls(share, held, _rows(counts, _histogram(runs)))


def with_chance_repeats(recording: Recording) -> Recording:
    """Return the recording with those repeated entries as samples that repeat because of coarse steps."""
    fresh, stamped = recording.magnetic_field_fresh, recording.magnetic_field_stamped
    rows = np.inf if np.array_equal(fresh, stamped) else RepeatedEntries.of(recording).rows
    if np.isinf(rows):
        return recording
    entry = np.cumsum(stamped)
    last: np.ndarray = np.maximum.accumulate(np.where(fresh, entry, 0))  # the last entry so far that was fresh
    return replace(recording, magnetic_field_fresh=stamped & are_samples(entry - last, rows))


def are_samples(repeat: np.ndarray, rows: float | Array) -> Mask:
    """Return which entries are samples, given how often each has repeated so far and the entries to a sample.

    Of a longer run, which may be that of a sensor that is stuck, only the first `LONGEST` samples are.
    """
    begun = np.floor(repeat / rows) > np.floor((repeat - 1) / rows)
    result: Mask = (repeat == 0) | (begun & (repeat <= LONGEST * rows))
    return result


class RepeatsSoFar:
    """The repeats among a magnetometer's entries as they arrive, counted in constant time and memory.

    Attributes:
        rows: as in `RepeatedEntries` for the latest stretches of entries; NaN before the first is over.
    """

    def __init__(self) -> None:
        self.rows = np.nan
        # Counts of the stretches and of the run lengths that ended in them; the same of the stretch that is not over.
        self._counts, self._open = np.empty((0, 5 + _LONGEST_RUN)), np.zeros(5 + _LONGEST_RUN)
        self._since, self._run = np.nan, 0  # first stamp of this stretch, and length of the run that is not over

    def take(self, time: Array, repeats: Mask) -> Array:
        """Count entries (n,) with the axes (n, 3) that repeat; return `rows` at each, (n,)."""
        result = np.full(len(time), self.rows)
        begin = 0
        while begin < len(time):
            if not self._open[0]:
                self._since = float(time[begin])
            last = self._last(time, begin)
            part = repeats[begin : last + 1]
            together = part.all(axis=1)
            fresh = np.flatnonzero(~together)
            runs = np.diff(fresh, prepend=-self._run) if self._run else np.diff(fresh)
            self._run = len(part) - int(fresh[-1]) if len(fresh) else self._run + len(part)
            self._open += [len(part), *part.sum(axis=0), together.sum(), *_histogram(runs)]
            if last < len(time):
                self._counts = np.vstack([self._counts, self._open])[-_LATEST:]
                self._open = np.zeros_like(self._open)
                self.rows = _rows(self._counts[:, :5], self._counts[:, 5:].sum(axis=0))
                result[last:] = self.rows
            begin = last + 1
        return result

    def _last(self, time: Array, begin: int) -> int:
        """Return the index of the entry with which the open stretch ends; len(time) or more if it goes on."""
        enough = begin + _ROWS - 1 - int(self._open[0])
        locally, slowest = (int(np.searchsorted(time, self._since + s)) for s in (_LOCALLY, _SLOWEST))
        return max(min(max(enough, locally), slowest), begin)

    def state(self) -> Mapping[str, Array]:
        """Return the state as named arrays, for `restore`."""
        return {"counts": self._counts, "open": np.array([self.rows, self._since, self._run, *self._open])}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Restore a state that `state` returned."""
        self._counts = state["counts"]
        self.rows, self._since = (float(v) for v in state["open"][:2])
        self._run, self._open = int(state["open"][2]), state["open"][3:].copy()


def _rows(counts: Array, runs: Array) -> float:
    """Return the entries to a sample, from the counts (k, 5) of stretches and the numbers (L,) of run lengths.

    The share that is held says roughly how many; runs up to that length are of one sample, and their mean is exact.
    """
    if _repeat_alone(counts)[1] <= _ALONE:
        return np.inf
    held = _share_held(counts)
    if held < _BY_CHANCE * counts[:, 4].sum() / counts[:, 0].sum():
        return 1.0
    of_one: np.ndarray = runs[: int(np.ceil(1 / (1 - held)))]
    rows = float(of_one @ np.arange(1, len(of_one) + 1) / max(of_one.sum(), 1.0))
    return round(rows) if rows > 1.5 and abs(rows - round(rows)) < _WHOLE * rows else rows


def _histogram(runs: np.ndarray) -> Array:
    """Return the numbers (L,) of runs of each length from 1 on."""
    return np.bincount(np.minimum(runs, _LONGEST_RUN), minlength=_LONGEST_RUN + 1)[1:].astype(float)


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


def _repeat_alone(counts: Array) -> tuple[float, float]:
    """Return the share of the steps at which single axes repeat, of all steps and of those that are no hold."""
    steps, *each, together = counts.sum(axis=0)
    alone = sum(each) / 3 - together
    return float(alone / steps), float(alone / max(steps - together, 1.0))


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
