"""Checks of incoming rows and their separation into one clean stream per sensor: ascending and finite."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.online.arguments import block
from magyc_gtsam.online.engine import Progress
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.recording.axes import OWN_AXES, parse_axes
from magyc_gtsam.recording.stamps import check_seconds
from magyc_gtsam.recording.time_base import ONE_CLOCK

_LATE = 1.0  # s behind the last stamp; more, six times in a row, means that a clock was set back
_LEAP = 3.0  # ratio to the previous step, and at least `_LATE`, by which a stamp may be ahead without confirmation
_SILENT = 60.0  # s by which a sensor may be behind the other before the estimate is out of date
_REMEMBERED = 2048  # rows of each sensor by which those that are sent again are known: 200 s at 10 Hz
_CONFIRMED_BY = 5  # number of further stamps that confirm one which leaps ahead or back
_FIELD_LIMIT = 3e-3  # T
_RATE_LIMIT = 70.0  # rad/s
_NAMES = ("magnetic_field", "angular_rate")
_UNITS = ("magnetic_unit", "T", _FIELD_LIMIT), ("angular_unit", "rad/s", _RATE_LIMIT)


class ClockSetBack(MagycError):
    """The stamps of a sensor went back and stay there."""


@dataclass(frozen=True, eq=False)
class _Stream:
    """What is known of the samples of one sensor.

    Attributes:
        name: the argument that gives them.
        last: (4,) stamp, s, and value of the last one; before the first −inf and NaN.
        step: s between the last two.
        behind: number of the last rows in a row that were later than `_LATE` allows.
        recent: (n, 4) the last rows admitted, by which rows that are sent again are known.
        quarantine: (n, 4) stamps and values that are not confirmed yet.
    """

    name: str
    last: Array = field(default_factory=lambda: np.array([-np.inf, np.nan, np.nan, np.nan]))
    step: float = 0.0
    behind: int = 0
    quarantine: Array = field(default_factory=lambda: np.empty((0, 4)))
    recent: Array = field(default_factory=lambda: np.empty((0, 4)))

    def take(self, stamps: Array, value: Array) -> tuple[Array, _Stream, int]:
        """Return the rows (n, 4) that are admitted, the stream after them, and the number of rows left out.

        Raises:
            MagycError: the numbers of rows differ, the unit is wrong, or a clock was set back.
        """
        rows, left_out = self._within_limits(stamps, value)
        incoming = np.vstack([self.quarantine, rows])
        admitted, quarantine = _confirmed(incoming, float(self.last[0]), self.step)
        ascending, behind = self._ascending(admitted)
        left_out += len(incoming) - len(ascending) - len(quarantine)
        last, step = self.last, self.step
        if len(ascending):
            last = ascending[-1].copy()
            before = float(ascending[-2, 0] if len(ascending) > 1 else self.last[0])
            step = float(last[0]) - before if np.isfinite(before) else step
        recent = np.vstack([self.recent, ascending])[-_REMEMBERED:] if len(ascending) else self.recent
        return ascending, _Stream(self.name, last, step, behind, quarantine, recent), left_out

    def _within_limits(self, stamps: Array, value: Array) -> tuple[Array, int]:
        """Return the rows of stamp and value that are finite and within the limit, and the number of rows left out.

        Rows of NaN stand for no sample and are not counted.
        """
        if len(value) != len(stamps):
            raise MagycError(f"{self.name}: {len(value)} rows for {len(stamps)} stamps")
        argument, unit, limit = _UNITS[_NAMES.index(self.name)]
        absent = np.isnan(value).all(axis=1)
        good = np.isfinite(stamps) & np.isfinite(value).all(axis=1)
        refused = int((~good & ~absent).sum())
        when, value = stamps[good], value[good]
        beyond = np.abs(value).max(axis=1, initial=0.0) > limit
        if not np.isfinite(self.last[0]) and not len(self.quarantine):
            check_seconds("time", when)
            if beyond.sum() > 0.5 * len(beyond):  # a wrong unit; after the first block it is a spike
                row = int(beyond.argmax())
                raise MagycError(
                    f"{self.name}: {np.abs(value[row]).max():.4g} at {when[row]:.3f} s is beyond {limit:g} {unit}; "
                    f"convert it to {unit}, or read a log in its unit ({argument}=)"
                )
        return np.column_stack([when, value])[~beyond], refused + int(beyond.sum())

    def _ascending(self, rows: Array) -> tuple[Array, int]:
        """Return the rows (n, 4) whose stamps ascend after the last one, and the new `behind`."""
        when = rows[:, 0]
        if not len(when):
            return rows, self.behind
        before = np.maximum.accumulate(np.concatenate([self.last[:1], when]))[:-1]
        far, place = before - when > _LATE, np.arange(1, len(when) + 1)
        if far.any():
            far &= ~_among(rows, np.vstack([self.recent, rows[when > before]]))
        since = np.maximum.accumulate(
            np.where(far, -self.behind, place)
        )  # the last row before that was not far behind
        run = place - since
        if run.max() > _CONFIRMED_BY:
            row = int((run > _CONFIRMED_BY).argmax())
            raise ClockSetBack(
                f"{self.name}: time goes back from {before[row]:.3f} to {when[row]:.3f} s and stays there; "
                "if a clock was set, keep the calibration so far and start a new run without the saved state"
            )
        return rows[when > before], int(run[-1])


def _among(rows: Array, known: Array) -> np.ndarray:
    """Return (n,) bool, which rows equal one of the `known`, whose stamps ascend, in stamp and value."""
    at = np.searchsorted(known[:, 0], rows[:, 0]).clip(max=len(known) - 1)
    same: np.ndarray = (known[at] == rows).all(axis=1)
    return same


class Intake:
    """Separates rows of both sensors into two clean streams.

    Args:
        gyroscope_axes: the gyroscope's axes along the magnetometer's x, y, z, into which its rates are turned.
    """

    def __init__(self, gyroscope_axes: str = OWN_AXES) -> None:
        self._axes = parse_axes(gyroscope_axes)
        self._streams = tuple(_Stream(name) for name in _NAMES)
        self._left_out = 0
        self._first = np.nan

    def take(
        self, time: ArrayLike, magnetic_field: ArrayLike | None, angular_rate: ArrayLike | None
    ) -> tuple[Samples, Samples]:
        """Return the new entries of magnetometer and gyroscope.

        Raises:
            MagycError: shapes or units are wrong, or a clock was set back; the intake is then unchanged.
        """
        stamps = block("time", time, 0)
        given = [
            None if value is None else block(name, value, 1)
            for name, value in zip(_NAMES, (magnetic_field, angular_rate), strict=True)
        ]
        taken = [
            (np.empty((0, 4)), stream, 0) if value is None else stream.take(stamps, value)
            for stream, value in zip(self._streams, given, strict=True)
        ]
        (magnetometer, *_), (gyroscope, *_) = taken
        self._streams = tuple(stream for _, stream, _ in taken)
        self._left_out += sum(count for *_, count in taken)
        if np.isnan(self._first):
            self._first = min((rows[0, 0] for rows in (magnetometer, gyroscope) if len(rows)), default=np.nan)
        turned = gyroscope[:, 1:] @ self._axes.T
        return Samples(magnetometer[:, 0], magnetometer[:, 1:]), Samples(gyroscope[:, 0], turned)

    @property
    def until(self) -> tuple[float, float]:
        """The stamps, s, of the last sample of magnetometer and gyroscope; −inf before the first."""
        magnetometer, gyroscope = (float(stream.last[0]) for stream in self._streams)
        return magnetometer, gyroscope

    @property
    def silence(self) -> str:
        """Which sensor has had no sample for long while the other has, in words; "" if both have.

        Nothing is known of the iron since: the windows need both.
        """
        first, last = sorted(self.until)
        if not np.isfinite(first) or last - first <= _SILENT:
            return ""
        name = _NAMES[int(np.argmin(self.until))]
        return (
            f"no sample of {name} for {last - first:.0f} s, or its clock is another one: nothing is known since; "
            f"if the clocks differ, {ONE_CLOCK}"
        )

    @property
    def duration(self) -> float:
        """The time from the first sample to the last, s."""
        last = max(self.until)
        return float(last - self._first) if np.isfinite(last) else 0.0

    def counted(self, progress: Progress) -> Progress:
        """Return the engine's progress with time, duration and count of left-out samples."""
        last = max(self.until)
        time = last if np.isfinite(last) else progress.time
        absent = [stream.name for stream in self._streams if not np.isfinite(stream.last[0])]
        if len(absent) == 1:
            progress = replace(progress, sentence=f"collecting: no sample of {absent[0]} yet")
        if self.silence:
            progress = replace(progress, converged=False, sentence=self.silence)
        return replace(progress, time=time, duration=self.duration, left_out=self._left_out)

    def state(self) -> Mapping[str, Array]:
        """Return the state as named arrays, for `restore`."""
        return {
            "last": np.array([stream.last for stream in self._streams]),
            "count": np.array([self._first, self._left_out, *(stream.behind for stream in self._streams)]),
            "step": np.array([stream.step for stream in self._streams]),
            **{f"quarantine/{stream.name}": stream.quarantine for stream in self._streams},
            **{f"recent/{stream.name}": stream.recent for stream in self._streams},
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Restore a state that `state` returned."""
        self._first, left_out, *behind = state["count"].tolist()
        self._left_out = int(left_out)
        self._streams = tuple(
            _Stream(
                name,
                last.copy(),
                float(step),
                int(count),
                state[f"quarantine/{name}"],
                state[f"recent/{name}"],
            )
            for name, last, step, count in zip(_NAMES, state["last"], state["step"], behind, strict=True)
        )


def _confirmed(rows: Array, last: float, step: float) -> tuple[Array, Array]:
    """Return the rows (n, 4) of time and value that are admitted, and those still in quarantine.

    A stamp far ahead of the last one follows a pause or is wrong. After a pause the next stamps are later still; after
    a wrong stamp they fall back behind it, and it is dropped. Before the first sample every stamp is far ahead.
    """
    if not np.isfinite(last):
        return _confirmed_first(rows)
    time = rows[:, 0]
    before = np.maximum.accumulate(np.concatenate([[last], time]))
    steps = np.concatenate([[step], np.diff(before)])[:-1]
    if not (time - before[:-1] > np.maximum(_LATE, _LEAP * steps)).any():
        return rows, rows[:0]
    admitted: list[int] = []
    waiting: list[int] = []
    for i in range(len(time)):  # reached only if a stamp leaps ahead
        _wait(waiting, time, i)
        while waiting:
            leap = time[waiting[0]] - last
            if leap > max(_LATE, _LEAP * step) and len(waiting) <= _CONFIRMED_BY:
                break
            first = waiting.pop(0)
            admitted.append(first)
            if time[first] > last:
                last, step = float(time[first]), float(leap)
    return rows[admitted], rows[waiting]


def _confirmed_first(rows: Array) -> tuple[Array, Array]:
    """Return admitted and quarantined rows before the first sample, which five later stamps must confirm.

    Rows before a leap among these are left out as well, because a clock may have been set right after the start.
    """
    time = rows[:, 0]
    waiting: list[int] = []
    for i in range(len(time)):
        _wait(waiting, time, i)
        if len(waiting) <= _CONFIRMED_BY:
            continue
        steps = np.diff(time[waiting])
        leaps = np.flatnonzero(steps > max(_LATE, _LEAP * float(np.median(steps))))
        begun = waiting[leaps[-1] + 1 :] if len(leaps) else waiting
        step = float(time[begun[-1]] - time[begun[-2]]) if len(begun) > 1 else 0.0
        admitted, quarantine = _confirmed(rows[i + 1 :], float(time[i]), step)
        return np.vstack([rows[begun], admitted]), quarantine
    return rows[:0], rows[waiting]


def _wait(waiting: list[int], time: Array, i: int) -> None:
    """Add row i to the waiting rows, and drop the waiting rows whose stamps are later than its own."""
    while waiting and time[waiting[-1]] >= time[i]:
        waiting.pop()
    waiting.append(i)
