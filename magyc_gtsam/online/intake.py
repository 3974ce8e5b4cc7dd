"""Checks of incoming rows and their separation into one clean stream per sensor: ascending, finite, without repeats."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import real_array
from magyc_gtsam.online.engine import Progress
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.recording.stamps import check_seconds

_LATE = 1.0  # s behind the last stamp; more, six times in a row, means that a clock was set back
_LEAP = 3.0  # ratio to the previous step, and at least `_LATE`, by which a stamp may be ahead without confirmation
_CONFIRMED_BY = 5  # number of further stamps that confirm one which leaps ahead or back
_FIELD_LIMIT = 3e-3  # T
_RATE_LIMIT = 70.0  # rad/s
_NAMES = ("magnetic_field", "angular_rate")
_WIDTH = (_FIELD_LIMIT, _RATE_LIMIT)


class Intake:
    """Separates rows of both sensors into two clean streams.
    Attributes:
        repeated: (n,) s, stamps in the last rows taken at which the magnetometer repeated the sample before.
    """

    def __init__(self) -> None:
        self.repeated = np.empty(0)
        self._last = {name: (-np.inf, np.full(3, np.nan)) for name in _NAMES}
        self._quarantine = {
            name: np.empty((0, 4)) for name in _NAMES
        }  # time and value of samples not yet confirmed
        self._step = dict.fromkeys(_NAMES, 0.0)  # s between the last two samples
        self._behind = dict.fromkeys(_NAMES, 0)  # number of the last rows in a row that were later than `_LATE`
        self._left_out = 0
        self._first = np.nan

    def take(
        self, time: ArrayLike, magnetic_field: ArrayLike | None, angular_rate: ArrayLike | None
    ) -> tuple[Samples, Samples]:
        """Return the new samples of magnetometer and gyroscope.

        Raises:
            MagycError: shapes or units are wrong, or a clock was set back; the intake is then unchanged.
        """
        stamps = _array("time", time, 0)
        rows = {
            name: _array(name, value, 1)
            for name, value in zip(_NAMES, (magnetic_field, angular_rate), strict=True)
            if value is not None
        }
        taken, last, left_out = {}, dict(self._last), self._left_out
        quarantine, steps, behind = dict(self._quarantine), dict(self._step), dict(self._behind)
        repeated = np.empty(0)
        for name, limit in zip(_NAMES, _WIDTH, strict=True):
            if name not in rows:
                taken[name] = Samples(np.empty(0), np.empty((0, 3)))
                continue
            first = not np.isfinite(last[name][0]) and not len(quarantine[name])
            when, value, refused = _within_limits(name, stamps, rows[name], limit, first)
            left_out += refused
            incoming = np.vstack([quarantine[name], np.column_stack([when, value])])
            admitted, quarantine[name] = _confirmed(incoming, last[name][0], steps[name])
            left_out += len(incoming) - len(admitted) - len(quarantine[name])
            when, value, behind[name] = _ascending(name, admitted, last[name][0], behind[name])
            left_out += len(admitted) - len(when)
            if len(when):
                if len(when) > 1 or np.isfinite(last[name][0]):
                    steps[name] = float(when[-1] - (when[-2] if len(when) > 1 else last[name][0]))
                if name == "magnetic_field":
                    fresh = (np.diff(np.vstack([last[name][1], value]), axis=0) != 0).any(axis=1)
                else:
                    fresh = np.ones(len(when), dtype=bool)
                last[name] = (float(when[-1]), value[-1].copy())
                repeated = np.append(repeated, when[~fresh])
                when, value = when[fresh], value[fresh]
            taken[name] = Samples(when, value)
        self._last, self._left_out, self.repeated = last, left_out, repeated
        self._quarantine, self._step, self._behind = quarantine, steps, behind
        if np.isnan(self._first):
            firsts = [s.time[0] for s in taken.values() if len(s.time)]
            self._first = float(min(firsts)) if firsts else np.nan
        return taken["magnetic_field"], taken["angular_rate"]

    @property
    def until(self) -> tuple[float, float]:
        """The stamps, s, of the last sample of magnetometer and gyroscope; −inf before the first."""
        (magnetometer, _), (gyroscope, _) = (self._last[name] for name in _NAMES)
        return magnetometer, gyroscope

    @property
    def duration(self) -> float:
        """The time from the first sample to the last, s."""
        last = max(self.until)
        return last - self._first if np.isfinite(last) else 0.0

    def counted(self, progress: Progress) -> Progress:
        """Return the engine's progress with time, duration and count of left-out samples."""
        last = max(self.until)
        time = last if np.isfinite(last) else progress.time
        absent = [name for name in _NAMES if not np.isfinite(self._last[name][0])]
        if len(absent) == 1:
            progress = replace(progress, sentence=f"collecting: no sample of {absent[0]} yet")
        return replace(progress, time=time, duration=self.duration, left_out=self._left_out)

    def state(self) -> Mapping[str, Array]:
        """Return the state as named arrays, for `restore`."""
        return {
            "last": np.array([[time, *value] for time, value in self._last.values()]),
            "count": np.array([self._first, self._left_out, *self._behind.values()]),
            "step": np.array([self._step[name] for name in _NAMES]),
            **{f"quarantine/{name}": rows for name, rows in self._quarantine.items()},
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Restore a state that `state` returned."""
        self._last = {
            name: (float(row[0]), row[1:].copy()) for name, row in zip(_NAMES, state["last"], strict=True)
        }
        first, left_out, *behind = state["count"].tolist()
        self._first, self._left_out = first, int(left_out)
        self._behind = {name: int(count) for name, count in zip(_NAMES, behind or (0, 0), strict=True)}
        self._step = dict(zip(_NAMES, state["step"].tolist(), strict=True))
        self._quarantine = {name: state[f"quarantine/{name}"] for name in _NAMES}


def _within_limits(name: str, stamps: Array, value: Array, limit: float, first: bool) -> tuple[Array, Array, int]:
    """Return stamps and values that are finite and within `limit`, and the number of rows left out.

    Rows of NaN stand for no sample and are not counted.

    Args:
        name: name of the sensor.
        stamps, value: (n,) s and (n, 3).
        limit: largest absolute value.
        first: whether no sample came before, so that values beyond the limit mean a wrong unit.

    Raises:
        MagycError: the numbers of rows differ, or the unit is wrong.
    """
    if len(value) != len(stamps):
        raise MagycError(f"{name}: {len(value)} rows for {len(stamps)} stamps")
    absent = np.isnan(value).all(axis=1)
    good = np.isfinite(stamps) & np.isfinite(value).all(axis=1)
    refused = int((~good & ~absent).sum())
    when, value = stamps[good], value[good]
    beyond = np.abs(value).max(axis=1, initial=0.0) > limit
    if first:
        check_seconds("time", when)
    if first and beyond.sum() > 0.5 * len(beyond):  # a wrong unit; after the first block it is a spike
        row = int(beyond.argmax())
        raise MagycError(
            f"{name}: {np.abs(value[row]).max():.4g} at {when[row]:.3f} s is beyond {limit:g} "
            f"{'T' if name == 'magnetic_field' else 'rad/s'}; convert it, or read it in its unit "
            f"({'magnetic_unit' if name == 'magnetic_field' else 'angular_unit'}=)"
        )
    return when[~beyond], value[~beyond], refused + int(beyond.sum())


def _ascending(name: str, rows: Array, last: float, behind: int) -> tuple[Array, Array, int]:
    """Return stamps and values of the rows (n, 4) that ascend after the stamp `last`, and the new `behind`.

    Raises:
        MagycError: more than `_CONFIRMED_BY` rows in a row are later than `_LATE` allows, because a clock was set back.
    """
    when, value = rows[:, 0], rows[:, 1:]
    if not len(when):
        return when, value, behind
    before = np.maximum.accumulate(np.concatenate([[last], when]))[:-1]
    far, place = before - when > _LATE, np.arange(1, len(when) + 1)
    since = np.maximum.accumulate(np.where(far, -behind, place))  # the last row before that was not far behind
    run = place - since
    if run.max() > _CONFIRMED_BY:
        row = int(run.argmax())
        raise MagycError(
            f"{name}: time goes back from {before[row]:.3f} to {when[row]:.3f} s and stays there; "
            "if a clock was set, save the calibration and start a new run"
        )
    late = when <= before
    return when[~late], value[~late], int(run[-1])


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


def scalar(name: str, value: ArrayLike) -> float:
    """Return one number.

    Raises:
        MagycError: the value is not a number.
    """
    try:
        return float(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: not a number ({error})") from None


def vector(name: str, value: ArrayLike | None) -> Array:
    """Return a copy (3,) of one sample, NaN for None."""
    if value is None:
        return np.full(3, np.nan)
    try:
        array = real_array(value, copy=True)
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: not an array of numbers ({error})") from None
    if array.shape != (3,):
        raise MagycError(f"{name}: shape {array.shape} for one stamp, expected (3,)")
    return array


def _array(name: str, value: ArrayLike, vectors: int) -> Array:
    """Return an array (N,) or (N, 3) from one sample or a block."""
    try:
        array = real_array(value, copy=True)
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: not an array of numbers ({error})") from None
    if array.ndim == vectors:
        array = array[None]
    if array.ndim != vectors + 1 or (vectors and array.shape[1] != 3):
        raise MagycError(
            f"{name}: shape {array.shape}, expected {'(N, 3) or (3,)' if vectors else '(N,) or a number'}"
        )
    return array
