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
from magyc_gtsam.recording.repeats import (
    ALONE,
    LOCALLY,
    LONGEST_RUN,
    ROWS,
    Repetition,
    counted,
    due,
    histogram,
    repeat_alone,
    repeats_so_far,
    repetition_of,
    share_held,
)

HELD = 0.08  # share of entries that exactly repeat the one before, above which they may be held
_LEFT = 0.7  # share of the repeated entries that chance must not explain: axes that pause together are not held
_RANDOM = 0.5  # position between the variances of run lengths by a clock (0) and by chance (1)
_SLOWEST = 30.0  # s after which fewer rows must do in a stream
_LATEST = 30  # stretches of a stream that count, so that motion soon prevails over a rest before it


@dataclass(frozen=True)
class RepeatedEntries:
    """The repeated entries of a magnetometer's log.

    Attributes:
        share: share of the entries in which all axes are held, apart from chance repeats of the single axes.
        held: whether the entries are those of a sensor that is polled faster than it measures.
        repetition: entries to a sample, and the longest run of equal ones by chance.
    """

    share: float
    held: bool
    repetition: Repetition

    @classmethod
    def of(cls, recording: Recording) -> RepeatedEntries:
        """Count the repeats of a recording; at coarse steps those of a hold must also be regular."""
        own = recording.magnetic_field_stamped
        stale = float((~recording.magnetic_field_fresh[own]).mean())
        repeats = np.diff(recording.magnetic_field[own], axis=0) == 0
        counts = counted(recording.time[own], repeats)
        runs = np.diff(np.flatnonzero(~repeats.all(axis=1)))
        # Of all entries: a clean hold of four rows and more is no coarse sensor, though its samples may be.
        share, coarse = share_held(counts), repeat_alone(counts)[0] > ALONE
        unlikely = share > max(HELD, _LEFT * stale)
        held = bool(unlikely and (not coarse or _regular(repeats.all(axis=1))))
        return cls(share, held, repetition_of(counts, histogram(runs)))


def with_equal_samples(recording: Recording) -> Recording:
    """Return the recording with every stamped magnetometer entry as a sample, also those equal to the one before.

    `Recording.with_samples` takes such entries for repeats of a sample.
    """
    return replace(recording, magnetic_field_fresh=recording.magnetic_field_stamped)


def with_chance_repeats(recording: Recording) -> Recording:
    """Return the recording with those repeated entries as samples that repeat because of coarse steps."""
    fresh, stamped = recording.magnetic_field_fresh, recording.magnetic_field_stamped
    if np.array_equal(fresh, stamped):
        return recording
    rule = RepeatedEntries.of(recording).repetition
    if np.isinf(rule.rows):
        return recording
    samples = stamped.copy()
    samples[stamped] = are_samples(repeats_so_far(fresh[stamped]), *rule)
    return replace(recording, magnetic_field_fresh=samples)


def are_samples(repeat: np.ndarray, rows: float | Array, longest: float | Array) -> Mask:
    """Return which entries are samples, given how often each has repeated so far, and their `Repetition`.

    Of a longer run than chance explains, which may be that of a sensor that is stuck, only the first samples are.
    """
    return due(repeat, rows) & (repeat <= longest)


class RepeatsSoFar:
    """The repeats among a magnetometer's entries as they arrive, counted in constant time and memory.

    Attributes:
        repetition: of the latest stretches of entries; NaN before the first is over.
    """

    def __init__(self) -> None:
        self.repetition = Repetition(np.nan, np.nan)
        # Counts of the stretches and of the run lengths that ended in them; the same of the stretch that is not over.
        self._counts, self._open = np.empty((0, 5 + LONGEST_RUN)), np.zeros(5 + LONGEST_RUN)
        self._since, self._run = np.nan, 0  # first stamp of this stretch, and length of the run that is not over

    def take(self, time: Array, repeats: Mask) -> Array:
        """Count entries (n,) with the axes (n, 3) that repeat; return `repetition` at each, (n, 2)."""
        result: Array = np.tile(self.repetition, (len(time), 1))
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
            self._open += [len(part), *part.sum(axis=0), together.sum(), *histogram(runs)]
            if last < len(time):
                self._counts = np.vstack([self._counts, self._open])[-_LATEST:]
                self._open = np.zeros_like(self._open)
                self.repetition = repetition_of(self._counts[:, :5], self._counts[:, 5:].sum(axis=0))
                result[last:] = self.repetition
            begin = last + 1
        return result

    def _last(self, time: Array, begin: int) -> int:
        """Return the index of the entry with which the open stretch ends; len(time) or more if it goes on."""
        enough = begin + ROWS - 1 - int(self._open[0])
        locally, slowest = (int(np.searchsorted(time, self._since + s)) for s in (LOCALLY, _SLOWEST))
        return max(min(max(enough, locally), slowest), begin)

    def state(self) -> Mapping[str, Array]:
        """Return the state as named arrays, for `restore`."""
        return {"counts": self._counts, "open": np.array([*self.repetition, self._since, self._run, *self._open])}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Restore a state that `state` returned."""
        self._counts = state["counts"]
        rows, longest, self._since = (float(v) for v in state["open"][:3])
        self.repetition = Repetition(rows, longest)
        self._run, self._open = int(state["open"][3]), state["open"][4:].copy()


def _regular(repeats: Mask) -> bool:
    """Return whether repeated steps (n,) have the regular run lengths of a clock: one number of rows, or one more.

    Coarse steps repeat while the field hardly changes: their run lengths vary as by chance, or more.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], repeats.astype(int), [0]])))
    lengths = edges[1::2] - edges[::2]
    mean = float(lengths.mean())
    clock, chance = (mean % 1) * (1 - mean % 1), mean * (mean - 1)  # variances of the run length
    return bool(lengths.var() <= clock + _RANDOM * max(chance - clock, 0.0) + 1e-9)
