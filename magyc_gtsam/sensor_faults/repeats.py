"""Detect a magnetometer that is stuck on all axes while the vehicle turns: its rows repeat one sample."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magyc_gtsam.factors.chain.gyroscope_track import summed_rate
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.recording.growing_rows import GrowingRows
from magyc_gtsam.sensor_faults.stuck import LEAST_DURATION, LEAST_SAMPLES, Stretch

_LONGER = 10.0  # mean sampling intervals; a sensor polled faster than it measures repeats for less
_TURNED = 0.3  # rad of rotation relative to the median rate; more than the drift of a gyroscope at rest
_LATEST = 120.0  # s of gyroscope samples that are examined
_REMEMBERED = 50  # latest stretches kept


class Repeats:
    """Find the stretches in which the magnetometer repeats one sample while the gyroscope turns.

    Args:
        remembered: number of the latest stretches that are kept; None keeps all.
    """

    def __init__(self, remembered: int | None = _REMEMBERED) -> None:
        self._kept = slice(None if remembered is None else -remembered, None)
        self._last = np.full(4, np.nan)  # the repeated sample, time and value
        self._until, self._count = np.nan, 0  # stamp of the last repeat, and number of repeats
        self._samples, self._first = 0, np.nan  # number of samples, and stamp of the first
        self._gyroscope = GrowingRows(4)
        self._over = np.empty((0, 5))  # from, to, value: stretches that the gyroscope has not confirmed yet
        self._found = np.empty((0, 5))

    def observe(self, magnetometer: Samples, repeated: Array, gyroscope: Samples) -> None:
        """Take the next samples of both; `repeated` (n,) s are stamps at which the magnetometer repeated its last."""
        if len(gyroscope.time):
            self._gyroscope.append(np.column_stack(gyroscope))
        if len(magnetometer.time) or len(repeated):
            self._count_repeats(magnetometer, repeated)
        if not len(self._gyroscope):
            return
        time = self._gyroscope.rows[:, 0]
        asked = self._over[:, 1] <= time[-1]
        turned = [self._turned(row[0], row[1]) for row in self._over[asked]]
        self._found = np.vstack([self._found, self._over[asked][np.array(turned, dtype=bool)]])[self._kept]
        self._over = self._over[~asked]
        since = np.fmin(self._over[:, 0].min(initial=np.inf), self._last[0])
        self._gyroscope.cut(int(np.searchsorted(time, np.fmax(since, time[-1] - _LATEST))))

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """The stretches in which the magnetometer was stuck, including `now`."""
        return (*(_stretch(row) for row in self._found), *self.now)

    @property
    def now(self) -> tuple[Stretch, ...]:
        """The stretch that is not over, if there is one."""
        since, until = float(self._last[0]), self._until
        if not self._long(since, until, self._count, self._samples) or not self._turned(since, until):
            return ()
        return (_stretch(np.concatenate([[since, until], self._last[1:]])),)

    def _count_repeats(self, magnetometer: Samples, repeated: Array) -> None:
        stamps = magnetometer.time
        rows = np.vstack([self._last, np.column_stack(magnetometer)])
        place = np.searchsorted(stamps, repeated)
        count = np.bincount(place, minlength=len(rows))
        count[0] += self._count
        until = np.append(self._until, np.full(len(stamps), np.nan))
        until[place] = repeated  # among repeats of one sample the last stamp is kept
        if len(stamps) and np.isnan(self._first):
            self._first = float(stamps[0])
        for i in np.flatnonzero(count[:-1] >= LEAST_SAMPLES):
            if self._long(rows[i, 0], until[i], int(count[i]), self._samples + int(i)):
                self._over = np.vstack([self._over, [rows[i, 0], until[i], *rows[i, 1:]]])
        self._last, self._until, self._count = rows[-1].copy(), float(until[-1]), int(count[-1])
        self._samples += len(stamps)

    def _long(self, since: float, until: float, count: int, samples: int) -> bool:
        """Return whether `count` repeats of the last of `samples` samples are too many for a sensor polled too fast."""
        if count < LEAST_SAMPLES or not until - since >= LEAST_DURATION:
            return False
        return bool((until - since) * max(samples - 1, 1) > _LONGER * (since - self._first))

    def _turned(self, since: float, until: float) -> bool:
        rows = self._gyroscope.rows
        time, rate = rows[:, 0], rows[:, 1:]
        inside = slice(*np.searchsorted(time, [max(since, until - _LATEST), until]))
        if inside.stop - inside.start < LEAST_SAMPLES // 2:
            return False
        rate = rate[inside] - np.median(rate[inside], axis=0)
        angle = summed_rate(time[inside], rate)
        return bool(np.ptp(angle, axis=0).max() > _TURNED)

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        return {
            "last": self._last,
            "counts": np.array([self._until, self._count, self._samples, self._first]),
            "gyroscope": self._gyroscope.rows.copy(),
            "over": self._over,
            "found": self._found,
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._last, self._over, self._found = state["last"], state["over"], state["found"]
        self._until, count, samples, self._first = (float(v) for v in state["counts"])
        self._count, self._samples = int(count), int(samples)
        self._gyroscope.append(state["gyroscope"])


def _stretch(row: Array) -> Stretch:
    since, until, *value = row.tolist()
    return Stretch((True, True, True), tuple(value), since, until, since)
