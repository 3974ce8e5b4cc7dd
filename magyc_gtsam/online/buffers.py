"""Buffers of the samples that are still needed, and of their windows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magyc_gtsam.estimators.smoother.preparation import added_variance
from magyc_gtsam.factors.chain.field_windows import FieldWindows, in_frame_of, joined
from magyc_gtsam.factors.chain.preintegration import Preintegration, windows_passed
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.recording.growing_rows import GrowingRows

_MARGIN = 4  # gyroscope samples beyond a window that its integration uses
_LATENESS = 0.1  # s, lag of the magnetometer allowed beyond its estimate
_STEPS = 32  # gyroscope steps from which their median is determined
_WAITING = 60.0  # s of samples of one sensor that are kept while the other is silent
_BLOCK = 64  # windows that are integrated together
_FEW = 8  # windows that are not a block of their own
_STAMPS = 2048  # gyroscope samples before a window by which its stamps and steps are judged
_POINT = 1e-3  # rad/s and s to which the bias and delay of the integration are rounded


class SampleBuffer:
    """Samples of both sensors and their windows, numbered as `Preintegration` numbers those of a whole log.

    Attributes:
        length, turn: longest duration, s, and largest turn, rad, of a window; `cut_windows` changes them.
        interval_mean: whether a rate is the mean since the previous sample.
    """

    def __init__(self, length: float, turn: float, interval_mean: bool) -> None:
        self.length, self.turn, self.interval_mean = length, turn, interval_mean
        self._magnetometer = GrowingRows(4)  # time, field
        self._gyroscope = GrowingRows(5)  # time, rate, distance (in windows, including holes) up to this sample
        self._numbers = GrowingRows(1)  # window of each magnetometer sample that the gyroscope has reached
        self._measured = 0  # gyroscope samples whose distance is known
        self._hole = np.nan  # s, gyroscope step above which the chain is interrupted
        self._overlap = False  # whether both sensors have begun

    @property
    def magnetometer(self) -> Samples:
        """All magnetometer samples kept."""
        return Samples(self._magnetometer.rows[:, 0], self._magnetometer.rows[:, 1:])

    @property
    def gyroscope(self) -> Samples:
        """All gyroscope samples kept."""
        return Samples(self._gyroscope.rows[:, 0], self._gyroscope.rows[:, 1:4])

    @property
    def numbers(self) -> Array:
        """The ascending window numbers (m,) of the first m magnetometer samples; the last window may be open."""
        return self._numbers.rows[:, 0]

    def append(self, magnetometer: Samples, gyroscope: Samples) -> None:
        """Take new samples."""
        if len(magnetometer.time):
            self._magnetometer.append(np.column_stack(magnetometer))
        if len(gyroscope.time):
            self._gyroscope.append(np.column_stack([*gyroscope, np.full(len(gyroscope.time), np.nan)]))
        if not self._overlap and not self._begin():
            return
        self._bound()
        if np.isnan(self._hole):
            if len(self._gyroscope) <= _STEPS:
                return
            step = np.diff(self._gyroscope.rows[: _STEPS + 1, 0])
            self._hole = max(10 * float(np.median(step)), 0.5)
            self._gyroscope.rows[0, 4], self._measured = 0.0, 1
        self._measure()

    def cut_windows(self, length: float, turn: float) -> None:
        """Cut and number all windows again, with other limits."""
        self.length, self.turn = length, turn
        self._measured = 1
        self._numbers.cut(len(self._numbers))
        self._measure()

    def closed(self, delay: float) -> int:
        """Return the number below which windows are complete and the gyroscope is known far enough beyond them."""
        gyro, numbers = self._gyroscope.rows, self.numbers
        if len(gyro) <= _MARGIN or not len(numbers):
            return 0
        known = gyro[-1 - _MARGIN, 0] - _LATENESS + min(delay, 0.0)
        last = int(np.searchsorted(self._magnetometer.rows[: len(numbers), 0], known, side="right")) - 1
        return int(numbers[last]) if last >= 0 else 0

    def windows(self, first: int, stop: int, delay: float) -> Preintegration:
        """Return the windows numbered from `first` up to `stop`, cut as in the whole log."""
        rows = self._rows(first, stop)
        span = self._span(rows, delay)
        before = min(_STAMPS, span.start)  # which show whether the stamps wander
        gyro = self._gyroscope.rows[span.start - before : span.stop]
        wander = added_variance(Samples(gyro[:, 0], gyro[:, 1:4]))
        gyro = gyro[before:]
        return Preintegration(
            self.magnetometer.time[rows],
            self.magnetometer.value[rows],
            gyro[:, 0],
            gyro[:, 1:4],
            interval_mean=self.interval_mean,
            length=self.length,
            turn=self.turn,
            hole=self._hole,
            begun=float(gyro[0, 4]),
            added_variance=None if wander is None else wander[before:],
        )

    def keep_from(self, number: int, delay: float) -> None:
        """Drop the samples that windows from `number` on do not need."""
        rows = self._rows(number, number + 1)
        span = self._span(rows, delay)
        self._magnetometer.cut(rows.start)
        self._numbers.cut(rows.start)
        self._gyroscope.cut(span.start)
        self._measured -= span.start

    def begin_at(self, number: int, length: float) -> None:
        """Drop everything before window `number` and number the windows from 0, as if the log began there."""
        self.keep_from(number, 0.0)
        self.length = length
        self._begin()
        self._gyroscope.rows[0, 4], self._measured = 0.0, 1
        self._numbers.cut(len(self._numbers))
        self._measure()

    def between(self, first: int | None, stop: int | None, delay: float) -> tuple[Samples, Samples]:
        """Return copies of both sensors' samples in the windows from `first` up to `stop`; None for no limit."""
        mag, gyro = self.magnetometer, self.gyroscope
        start, end = 0, len(gyro.time)
        rows = slice(0, len(mag.time))
        if first is not None:
            rows = slice(int(np.searchsorted(self.numbers, first)), rows.stop)
            start = self._span(rows, delay).start
        if stop is not None:
            rows = slice(rows.start, int(np.searchsorted(self.numbers, stop)))
            end = self._span(rows, delay).stop
        return (
            Samples(*(part[rows].copy() for part in mag)),
            Samples(*(part[start:end].copy() for part in gyro)),
        )

    def state(self) -> Mapping[str, Array]:
        """Return the state as named arrays, for `restore`."""
        return {
            "magnetometer": self._magnetometer.rows.copy(),
            "gyroscope": self._gyroscope.rows.copy(),
            "numbers": self._numbers.rows.copy(),
            "limits": np.array([self.length, self.turn, self._hole]),
            "counts": np.array([self._measured, self._overlap]),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Restore a state that `state` returned."""
        for rows, name in (
            (self._magnetometer, "magnetometer"),
            (self._gyroscope, "gyroscope"),
            (self._numbers, "numbers"),
        ):
            rows.append(state[name])
        self.length, self.turn, self._hole = (float(v) for v in state["limits"][:3])
        self._measured, self._overlap = int(state["counts"][0]), bool(state["counts"][1])

    def _begin(self) -> bool:
        """Drop the samples before both sensors have begun; return whether both have."""
        mag, gyro = self._magnetometer.rows, self._gyroscope.rows
        if not len(mag) or not len(gyro):
            for rows in (self._magnetometer, self._gyroscope):
                if len(rows):
                    rows.cut(int(np.searchsorted(rows.rows[:, 0], rows.rows[-1, 0] - _WAITING)))
            return False
        first = max(mag[0, 0], gyro[0, 0])
        self._magnetometer.cut(int(np.searchsorted(mag[:, 0], first)))
        self._gyroscope.cut(int(np.searchsorted(gyro[:, 0], first)))
        self._overlap = bool(len(self._magnetometer) and len(self._gyroscope))
        return self._overlap

    def _bound(self) -> None:
        """Keep only a minute of one sensor's samples while the other is silent, since they cannot be used."""
        mag, gyro = self._magnetometer.rows[:, 0], self._gyroscope.rows[:, 0]
        latest = mag[-1] if len(mag) else gyro[0]  # samples without rates were dropped
        if latest > gyro[-1] + 2 * _WAITING:
            # A long block may hold all that the gyroscope reaches, which is not numbered yet.
            known = max(len(self._numbers), int(np.searchsorted(mag, gyro[-1], side="right")))
            self._magnetometer.keep(known, mag[known:] >= latest - _WAITING)
        elif gyro[-1] > latest + 3 * _WAITING:
            known = int(np.searchsorted(gyro, latest + _WAITING))
            self._gyroscope.keep(known, gyro[known:] >= gyro[-1] - _WAITING)
            self._measured = min(self._measured, known)

    def _measure(self) -> None:
        """Compute distances of new gyroscope samples, and window numbers of the magnetometer samples they reach."""
        gyro, done = self._gyroscope.rows, self._measured - 1
        if done < len(gyro) - 1:
            step = np.diff(gyro[done:, 0])
            progress = windows_passed(step, gyro[done:, 1:4], self.turn, self.length)
            progress[step > self._hole] = 2.0  # starts a new window, not linked to the one before
            gyro[done:, 4] = np.cumsum(np.concatenate([gyro[done : done + 1, 4], progress]))
            self._measured = len(gyro)
        known = len(self._numbers)
        when = self._magnetometer.rows[known:, 0]
        reached = int(np.searchsorted(when, gyro[-1, 0], side="right"))
        if not reached:
            return
        first = max(int(np.searchsorted(gyro[:, 0], when[0], side="right")) - 1, 0)
        time, distance = gyro[first:, 0], gyro[first:, 4]
        after = np.minimum(np.searchsorted(time, when[:reached], side="right"), len(time) - 1)
        inside = (time[after] - time[after - 1] > self._hole) & (time[after - 1] < when[:reached])
        inside &= when[:reached] < time[after]
        if inside.any():  # samples in a hole have no known attitude
            kept = np.append(~inside, np.ones(len(when) - reached, dtype=bool))
            when = when[:reached][~inside]  # a copy, because `keep` moves the rows behind it
            reached = len(when)
            self._magnetometer.keep(known, kept)
        self._numbers.append(np.floor(np.interp(when[:reached], time, distance))[:, None])

    def _rows(self, first: int, stop: int) -> slice:
        return slice(*(int(i) for i in np.searchsorted(self.numbers, [first, stop])))

    def _span(self, rows: slice, delay: float) -> slice:
        """Return the gyroscope samples that the magnetometer samples `rows` need."""
        time, gyro = self._magnetometer.rows[:, 0], self._gyroscope.rows[:, 0]
        late, early = _LATENESS + max(delay, 0.0), _LATENESS - min(delay, 0.0)
        first = int(np.searchsorted(gyro, min(time[rows.start] - late, time[rows.start]))) - _MARGIN
        stop = int(np.searchsorted(gyro, time[rows.stop - 1] + early, side="right")) + _MARGIN
        return slice(max(first, 0), min(stop, len(gyro)))


class IntegratedWindows:
    """Integrated windows of all samples kept, computed block by block and cached.

    Reading a calibration needs the windows, not the samples. They are integrated at the rounded bias and delay of the
    last refit, which seldom change; the chain corrects for the difference. The cache follows from samples and state
    alone, so it is not part of the state file and does not depend on when it was computed.
    """

    def __init__(self) -> None:
        self._key: tuple[float, ...] = ()
        self._blocks: list[FieldWindows] = []

    def of(self, buffer: SampleBuffer, origin: Array) -> FieldWindows:
        """Return all windows of a buffer, including the open one, in one world frame.

        Args:
            buffer: the samples.
            origin: (4,) bias and delay at which the gyroscope is integrated, to be rounded.
        """
        origin = _POINT * np.round(origin / _POINT)
        bias, delay = origin[:3], float(origin[3])
        key = (*bias, delay, buffer.length, buffer.turn, float(buffer.magnetometer.time[0]))
        if key != self._key:
            self._key, self._blocks = key, []
        numbers, closed = np.unique(buffer.numbers), buffer.closed(delay)
        # Few windows at the end may hold too few samples to be integrated by themselves: they join the block before.
        starts = range(0, max(len(numbers) - _FEW, 0) + 1, _BLOCK)
        parts = self._blocks[: len(starts) - 1]
        for first, last in zip(starts[len(parts) :], [*starts[len(parts) + 1 :], len(numbers)], strict=True):
            begin = int(numbers[max(first - 1, 0)])  # blocks overlap by one window
            part = buffer.windows(begin, int(numbers[last - 1]) + 1, delay).integrate(bias, delay)
            if parts:
                part = in_frame_of(parts[-1], part)
            parts.append(part)
            whole = last == first + _BLOCK and numbers[last - 1] < closed
            if whole and first == _BLOCK * len(self._blocks):
                self._blocks.append(part)
        return joined(parts)
