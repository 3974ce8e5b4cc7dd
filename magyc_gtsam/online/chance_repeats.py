"""Repeated readings of the magnetometer in a stream, of which those are samples that coarse steps explain."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.recording.held import RepeatsSoFar, are_samples


class ChanceRepeats:
    """Separates the repeats from a magnetometer's stream, and puts those back that coarse steps explain.

    The detectors of faults stand between: they need a stream without repeats, and a repeat of a faulty sample is no
    sample. What repeats are is decided from those so far. Until it is known for the first time, everything from the
    first repeat on is held back, so that an estimate does not begin with a part of the samples.
    """

    def __init__(self) -> None:
        self._so_far = RepeatsSoFar()
        self._last, self._run = np.full(4, np.nan), 0  # the last sample, time and value, and its repeats so far
        # Entries held back: time, value, repeats of the sample so far, its stamp, and the `Repetition`.
        self._held = np.empty((0, 8))
        self._back = np.empty((0, 2))  # s, repeats to be put back, and the samples that they repeat
        self._passed = np.full(4, -np.inf)  # the last sample that was passed on

    def take(self, entries: Samples) -> tuple[Samples, Array]:
        """Return the samples of the next entries, without repeats, and the stamps (n,) s of the repeats."""
        rows = np.vstack([self._held, self._compared(entries)])
        repeats, rule = rows[:, 4] > 0, rows[:, 6:]
        decided, known = len(rows), ~np.isnan(rule[:, 0])
        if repeats.any() and not known[-1]:
            decided = int(repeats.argmax())
        elif not known.all() and known.any():
            rule[~known] = rule[known][0]
        self._held = rows[decided:]
        rows, repeats = rows[:decided], repeats[:decided]
        samples = repeats & are_samples(rows[:, 4], *rows[:, 6:].T)
        self._back = np.vstack([self._back, rows[samples][:, [0, 5]]])
        return Samples(rows[~repeats, 0], rows[~repeats, 1:4]), rows[repeats, 0]

    def _compared(self, entries: Samples) -> Array:
        """Return the next entries as rows (n, 8), compared with those before and counted."""
        time, value = entries
        if not len(time):
            return np.empty((0, 8))
        same = np.diff(value, axis=0, prepend=self._last[None, 1:]) == 0
        place = np.arange(len(time))
        fresh = np.maximum.accumulate(np.where(same.all(axis=1), -1, place))  # the last entry that was no repeat
        run = np.where(fresh >= 0, place - fresh, self._run + place + 1)
        since = np.where(fresh >= 0, time[fresh], self._last[0])
        self._last, self._run = np.array([since[-1], *value[-1]]), int(run[-1])
        return np.column_stack([time, value, run, since, self._so_far.take(time, same)])

    def put_back(self, passed: Samples, pending: float) -> Samples:
        """Return the samples that passed the detectors of faults, and their repeats that are samples.

        Args:
            passed: samples of `take`.
            pending: stamp of the first sample that the detectors have not decided, s; inf if there is none.
        """
        known = np.vstack([self._passed, np.column_stack(passed)])
        self._passed = known[-1].copy()
        decided = int(np.searchsorted(self._back[:, 1], pending))
        back, self._back = self._back[:decided], self._back[decided:]
        if not len(back):
            return passed
        place = np.minimum(np.searchsorted(known[:, 0], back[:, 1]), len(known) - 1)
        good = known[place, 0] == back[:, 1]  # repeats of samples that were not left out
        rows = np.vstack([known[1:], np.column_stack([back[good, 0], known[place[good], 1:]])])
        rows = rows[np.argsort(rows[:, 0])]
        return Samples(rows[:, 0], rows[:, 1:])

    def state(self) -> Mapping[str, Array]:
        """Return the state as named arrays, for `restore`."""
        return {
            **self._so_far.state(),
            "last": np.append(self._last, self._run),
            "held": self._held,
            "back": self._back,
            "passed": self._passed,
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Restore a state that `state` returned."""
        self._so_far.restore(state)
        self._last, self._run = state["last"][:4].copy(), int(state["last"][4])
        self._held, self._back, self._passed = state["held"], state["back"], state["passed"]
