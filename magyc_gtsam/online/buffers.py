"""The samples that are still needed, and their windows; both grow at one end and are cut at the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.preintegration import FieldWindows, Preintegration, windows_passed
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.recording.growing_rows import GrowingRows

_MARGIN = 4  # gyroscope samples beyond a window's own that its integration looks at
_LATENESS = 0.1  # s by which a magnetometer may lag, beyond the estimate
_STEPS = 32  # gyroscope steps after which their median is taken to be known
_WAITING = 60.0  # s, samples of one sensor kept while the other is silent
_BLOCK = 64  # windows
_POINT = 1e-3  # rad/s and s to which the point of integration is rounded


class SampleBuffer:
    """Samples of both sensors and their windows, numbered as `Preintegration` numbers those of the whole log.

    Attributes:
        length, turn: s and rad, the longest window; `cut_windows` changes them.
        interval_mean: the rate is the mean since the previous sample.
    """

    def __init__(self, length: float, turn: float, interval_mean: bool) -> None:
        self.length, self.turn, self.interval_mean = length, turn, interval_mean
        self._magnetometer = GrowingRows(4)  # time, field
        self._gyroscope = GrowingRows(5)  # time, rate, distance (in windows, holes counted) up to this sample
        self._numbers = GrowingRows(1)  # window of each magnetometer sample, as far as the gyroscope reaches
        self._measured = 0  # gyroscope samples whose distance is known
        self._hole = np.nan  # s, a longer gyroscope step parts the chain
        self._overlap = False  # both sensors have begun

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
        """(m,) ascending window numbers of the first m magnetometer samples; the last window may be open."""
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
        """Number all windows afresh, with other limits."""
        self.length, self.turn = length, turn
        self._measured = 1
        self._numbers.cut(len(self._numbers))
        self._measure()

    def closed(self, delay: float) -> int:
        """Number below which windows are complete, and the gyroscope known far enough beyond them."""
        gyro, numbers = self._gyroscope.rows, self.numbers
        if len(gyro) <= _MARGIN or not len(numbers):
            return 0
        known = gyro[-1 - _MARGIN, 0] - _LATENESS + min(delay, 0.0)
        last = int(np.searchsorted(self._magnetometer.rows[: len(numbers), 0], known, side="right")) - 1
        return int(numbers[last]) if last >= 0 else 0

    def windows(self, first: int, stop: int, delay: float) -> Preintegration:
        """The windows numbered from `first` up to `stop`, cut as they are cut in the whole log."""
        rows = self._rows(first, stop)
        span = self._span(rows, delay)
        gyro = self._gyroscope.rows[span]
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
        )

    def keep_from(self, number: int, delay: float) -> None:
        """Drop what windows from `number` on do not need."""
        rows = self._rows(number, number + 1)
        span = self._span(rows, delay)
        self._magnetometer.cut(rows.start)
        self._numbers.cut(rows.start)
        self._gyroscope.cut(span.start)
        self._measured -= span.start

    def begin_at(self, number: int, length: float) -> None:
        """As if the log began with window `number`: what is before goes, windows are numbered from 0."""
        self.keep_from(number, 0.0)
        self.length = length
        self._begin()
        self._gyroscope.rows[0, 4], self._measured = 0.0, 1
        self._numbers.cut(len(self._numbers))
        self._measure()

    def between(self, first: int | None, stop: int | None, delay: float) -> tuple[Samples, Samples]:
        """Copies of the samples, magnetometer and gyroscope, of the windows from `first` up to `stop`; None: of all."""
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
        """For `restore`."""
        return {
            "magnetometer": self._magnetometer.rows.copy(),
            "gyroscope": self._gyroscope.rows.copy(),
            "numbers": self._numbers.rows.copy(),
            "limits": np.array([self.length, self.turn, self._hole]),
            "counts": np.array([self._measured, self._overlap]),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        for rows, name in (
            (self._magnetometer, "magnetometer"),
            (self._gyroscope, "gyroscope"),
            (self._numbers, "numbers"),
        ):
            rows.append(state[name])
        self.length, self.turn, self._hole = (float(v) for v in state["limits"][:3])
        self._measured, self._overlap = int(state["counts"][0]), bool(state["counts"][1])

    def _begin(self) -> bool:
        """Leave out what the sensor that began first measured alone."""
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
        """While one sensor is silent for long, what the other measures is of no use: keep a minute of it."""
        mag, gyro = self._magnetometer.rows[:, 0], self._gyroscope.rows[:, 0]
        if mag[-1] > gyro[-1] + 2 * _WAITING:
            known = len(self._numbers)
            self._magnetometer.keep(known, mag[known:] >= mag[-1] - _WAITING)
        elif gyro[-1] > mag[-1] + 3 * _WAITING:
            known = int(np.searchsorted(gyro, mag[-1] + _WAITING))
            self._gyroscope.keep(known, gyro[known:] >= gyro[-1] - _WAITING)
            self._measured = min(self._measured, known)

    def _measure(self) -> None:
        """Distances of new gyroscope samples, and numbers of the magnetometer samples they reach."""
        gyro, done = self._gyroscope.rows, self._measured - 1
        if done < len(gyro) - 1:
            step = np.diff(gyro[done:, 0])
            progress = windows_passed(step, gyro[done:, 1:4], self.turn, self.length)
            progress[step > self._hole] = 2.0  # a window of its own, and parted
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
        if inside.any():  # of a hole: the attitude is unknown
            kept = np.append(~inside, np.ones(len(when) - reached, dtype=bool))
            when = when[:reached][~inside]  # a copy, before the rows behind it move
            reached = len(when)
            self._magnetometer.keep(known, kept)
        self._numbers.append(np.floor(np.interp(when[:reached], time, distance))[:, None])

    def _rows(self, first: int, stop: int) -> slice:
        return slice(*(int(i) for i in np.searchsorted(self.numbers, [first, stop])))

    def _span(self, rows: slice, delay: float) -> slice:
        """The gyroscope samples that the magnetometer samples `rows` need."""
        time, gyro = self._magnetometer.rows[:, 0], self._gyroscope.rows[:, 0]
        late, early = _LATENESS + max(delay, 0.0), _LATENESS - min(delay, 0.0)
        first = int(np.searchsorted(gyro, min(time[rows.start] - late, time[rows.start]))) - _MARGIN
        stop = int(np.searchsorted(gyro, time[rows.stop - 1] + early, side="right")) + _MARGIN
        return slice(max(first, 0), min(stop, len(gyro)))


class IntegratedWindows:
    """The windows of all samples kept, integrated block by block, each block once.

    Reading a calibration needs the windows, not the samples. They are integrated where the last refit integrated them,
    rounded, so that this seldom changes; the chain corrects for what is left. Everything here follows from samples and
    state alone: it is no part of the state file, and when it was computed makes no difference.
    """

    def __init__(self) -> None:
        self._key: tuple[float, ...] = ()
        self._blocks: list[FieldWindows] = []

    def of(self, buffer: SampleBuffer, origin: Array) -> FieldWindows:
        """All windows of a buffer, the open one with them, in one world frame, integrated about `origin` (4,) bias and
        delay."""
        origin = _POINT * np.round(origin / _POINT)
        bias, delay = origin[:3], float(origin[3])
        key = (*bias, delay, buffer.length, buffer.turn, float(buffer.magnetometer.time[0]))
        if key != self._key:
            self._key, self._blocks = key, []
        numbers, closed = np.unique(buffer.numbers), buffer.closed(delay)
        parts = self._blocks[: len(numbers) // _BLOCK]
        for first in range(_BLOCK * len(parts), len(numbers), _BLOCK):
            last = min(first + _BLOCK, len(numbers))
            begin = int(numbers[max(first - 1, 0)])  # the block before ends with this window
            part = buffer.windows(begin, int(numbers[last - 1]) + 1, delay).integrate(bias, delay)
            if parts:
                part = in_frame_of(parts[-1], part)
            parts.append(part)
            if last == first + _BLOCK and numbers[last - 1] < closed:
                self._blocks.append(part)
        return joined(parts)


def in_frame_of(before: FieldWindows, after: FieldWindows) -> FieldWindows:
    """`after`, whose first window is the last one of `before`, in the world frame of `before`."""
    # R' = Qᵀ R for all samples, so that the windows' means M = mean Rᵀ read M' = M Q.
    left, _, right = np.linalg.svd(np.linalg.solve(before.rotation[:, :, -1], after.rotation[:, :, 0]))
    turn = left @ right
    return replace(
        after,
        rotation=np.einsum("ijn,kj->ikn", after.rotation, turn),
        rotation_bias=np.einsum("ijbn,kj->ikbn", after.rotation_bias, turn),
        rotation_rate=np.einsum("ijn,kj->ikn", after.rotation_rate, turn),
        lever=np.einsum("ij,jkn->ikn", turn, after.lever),
    )


def joined(parts: list[FieldWindows]) -> FieldWindows:
    """One chain of parts in one frame, each but the first beginning with the last window of the one before."""

    def windows(name: str) -> Array:
        return np.concatenate([getattr(part, name)[..., min(i, 1) :] for i, part in enumerate(parts)], axis=-1)

    def links(name: str) -> Array:
        return np.concatenate([getattr(part, name) for part in parts], axis=-1)

    return FieldWindows(
        **{
            name: windows(name)
            for name in ("time", "count", "field", "rotation", "rotation_bias", "rotation_rate")
        },
        **{name: links(name) for name in ("lever", "link_time", "linked")},
        bias=parts[0].bias,
        delay=parts[0].delay,
    )
