"""Gyroscope and magnetometer samples combined in windows: the data of every field chain.

The gyroscope is integrated once over the whole log into an attitude R_k relative to an arbitrary world
frame ("integrated world"). In that frame the field direction g is constant except for the gyroscope's
noise and bias error. A window of W magnetometer samples then reads, with B = F·A,

    mean(m_j) = B M g + h + ε/√W,    M = mean_j R_jᵀ,

which holds for any rotation of the vehicle inside the window (averaging m alone would set M = R_cᵀ).
A bias error δ turns R_k into Exp(K_k δ) R_k, K_k = −∫ R dt, so that two windows are linked by

    g' = Exp(−(K̄' − K̄) δ) g,    tangent noise σ_g √(Σ dt²),

with K̄ the mean over the window; inside the window M g gains mean_j R_jᵀ [g]× (K_j − K̄) δ, which is
dM/dτ [g]× R̄ δ times the variance of the stamps to first order in the turn inside (within 1 to 4 % on windows of 0.15 to
0.4 rad, 0.03 % of ΔK). Both are first order in δ, so that a large change of the bias requires a new integration. With a
delay τ of the magnetometer R is taken at t − τ.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.field_windows import (
    NONE,
    NOTHING,
    Between,
    EmptyWindows,
    FieldWindows,
    gaps,
    joined_between,
)
from magyc_gtsam.factors.chain.gyroscope_track import GyroscopeTrack
from magyc_gtsam.factors.chain.rotations import Array, Spinor
from magyc_gtsam.factors.chain.window_sums import ROWS, of_samples, of_windows, window_sums
from magyc_gtsam.factors.errors import MagycError

HOLE = 0.5  # s, a longer step of the gyroscope interrupts a chain
_CHUNK = 16384  # samples whose matrices are held at a time, which bounds the memory
_MARGIN = 3  # stamps by which pieces of the track overlap; an increment depends on the neighbouring samples


def interruptions(time: Array, hole: float = HOLE) -> np.ndarray:
    """Return the indices of the steps between gyroscope stamps (n,) across which its rotation is not known.

    Args:
        time: (n,) s.
        hole: s, least length; also ten times the median step.
    """
    step = np.diff(time)
    found = np.flatnonzero(step > hole)
    return found[step[found] > 10 * float(np.median(step))] if len(found) else found


def windows_passed(step: Array, rate: Array, turn: float, length: float) -> Array:
    """Return the fractions of a window (n − 1,) that pass in steps (n − 1,) s between rates (n, 3) rad/s.

    A window ends after a rotation by `turn` rad, and after `length` s at the latest.
    """
    if compiled.loops:
        passed = np.empty(len(step))
        limits = np.array([turn, length])
        compiled.loops.windows_passed(len(step), compiled.given(step), compiled.given(rate), limits, passed)
        return passed
    x, y, z = np.ascontiguousarray(rate.T)
    speed = np.sqrt(x * x + y * y + z * z)
    passed = np.maximum(0.5 * (speed[1:] + speed[:-1]) / turn, 1 / length) * step
    return passed


@dataclass(frozen=True, eq=False)
class Preintegration:
    """The samples of both sensors and the windows that contain them.

    Args:
        magnetometer_time, magnetic_field: (M,) s, (M, 3) T.
        gyroscope_time, angular_rate: (G,) s, (G, 3) rad/s; may differ from the magnetometer in rate and clock.
        interval_mean: the rate is the mean since the previous sample, not the value at the stamp.
        length: s, longest window.
        turn: rad, largest rotation inside a window; an infinitesimal one gives one window per sample.
        hole: s, a gyroscope step longer than this interrupts the chain.
        begun: number of windows, including the share of the present one, before the first gyroscope sample; for the
            continuation of a longer log.
        added_variance: (G − 1,) s², what errors of the stamps or lost samples add to dt² in each step; None for none.

    Attributes:
        starts: (n,) index of each window's first magnetometer sample.
        linked: (n − 1,) False where a hole separates two windows.
        empty: windows that contain no magnetometer sample.

    Raises:
        MagycError: fewer than 3 gyroscope samples, or fewer than 3 magnetometer samples inside the gyroscope's time
            span.
    """

    magnetometer_time: Array
    magnetic_field: Array
    gyroscope_time: Array
    angular_rate: Array
    interval_mean: bool = False
    length: float = 1.0
    turn: float = 0.2
    hole: float = HOLE
    begun: float = 0.0
    added_variance: Array | None = None
    starts: np.ndarray = field(init=False)
    linked: np.ndarray = field(init=False)
    empty: EmptyWindows = field(init=False)

    def __post_init__(self) -> None:
        if len(self.gyroscope_time) < 3:
            raise MagycError(f"{len(self.gyroscope_time)} gyroscope samples, at least 3 are needed")
        holes = interruptions(self.gyroscope_time, self.hole)
        # Outside the gyroscope's span and inside its holes the attitude is unknown.
        before, after = self.gyroscope_time[holes], self.gyroscope_time[holes + 1]
        known = self.magnetometer_time >= self.gyroscope_time[0]
        known &= self.magnetometer_time <= self.gyroscope_time[-1]
        if len(holes):
            segment = np.searchsorted(after, self.magnetometer_time, side="right")
            known &= segment == np.searchsorted(before, self.magnetometer_time, side="left")
        count = np.count_nonzero(known)
        if count < 3:
            raise MagycError(
                f"{count} magnetometer samples inside the gyroscope's time span "
                f"({self.gyroscope_time[0]:.3f} to {self.gyroscope_time[-1]:.3f} s), at least 3 are needed"
            )
        if count < len(known):
            object.__setattr__(self, "magnetometer_time", self.magnetometer_time[known])
            object.__setattr__(self, "magnetic_field", self.magnetic_field[known])
        ended = self._ended(holes)
        starts = self._starts(holes, ended)
        linked = np.diff(np.searchsorted(after, self.magnetometer_time[starts], side="right")) == 0
        object.__setattr__(self, "starts", starts)
        object.__setattr__(self, "linked", linked)
        object.__setattr__(self, "empty", self._empty(ended))

    @property
    def step(self) -> Array:
        """Intervals between gyroscope samples (G − 1,) in s."""
        return np.diff(self.gyroscope_time)

    def _ended(self, holes: np.ndarray) -> Array:
        """Return the number of windows (G,) that have ended by each stamp; a hole ends a window, too."""
        time = self.gyroscope_time
        ended = np.empty(len(time))
        ended[0] = self.begun
        for first in range(0, len(time) - 1, _CHUNK):
            rows = slice(first, first + _CHUNK + 1)
            passed = windows_passed(np.diff(time[rows]), self.angular_rate[rows], self.turn, self.length)
            if len(holes):
                passed[holes[(holes >= first) & (holes < first + len(passed))] - first] = 1.0
            passed[0] += ended[first]
            np.cumsum(passed, out=ended[first + 1 : first + _CHUNK + 1])
        return ended

    def _starts(self, holes: np.ndarray, ended: Array) -> np.ndarray:
        """Return the index of the first sample of each window."""
        time, ends = self.gyroscope_time, self.gyroscope_time[holes + 1]
        starts, last = [], -1
        for first in range(0, len(self.magnetometer_time), _CHUNK):
            when = self.magnetometer_time[first : first + _CHUNK]
            own = slice(first, first + len(when))
            same = np.array_equal(when, time[own])
            window = (ended[own] if same else np.interp(when, time, ended)).astype(np.int64)
            if len(ends):
                window += np.searchsorted(ends, when, side="right")
            starts.append(first + np.flatnonzero(window != np.concatenate([[last], window[:-1]])))
            last = window[-1]
        return np.concatenate(starts)

    def _empty(self, ended: Array) -> EmptyWindows:
        apart = self.linked & gaps(self.magnetometer_time, self.starts, self.length)
        if not apart.any():
            return NONE
        numbers = np.floor(np.interp(self.magnetometer_time[self.starts], self.gyroscope_time, ended))
        return EmptyWindows.of(self.gyroscope_time, ended, numbers.astype(np.int64), apart)

    def integrate(self, bias: Array | None = None, delay: float = 0.0) -> FieldWindows:
        """Integrate the gyroscope at `bias` (3,) rad/s, with the magnetometer taken `delay` s earlier."""
        bias = np.zeros(3) if bias is None else np.asarray(bias, dtype=float)
        starts, total = self.starts, len(self.magnetometer_time)
        count = np.diff(np.append(starts, total)).astype(float)
        time = np.add.reduceat(self.magnetometer_time, starts) / count
        field, spread = of_samples(starts, time, self.magnetometer_time, self.magnetic_field)
        sums = np.empty((ROWS, len(starts)))
        squared_time = np.empty(len(starts))
        first, track = 0, None
        between: list[Between] = []
        links: list[int] = []
        while first < len(starts):  # chunks of whole windows, which bounds the memory
            last = max(int(np.searchsorted(starts, starts[first] + _CHUNK)), first + 1)
            stop = int(starts[last]) if last < len(starts) else total
            track = self._track(track, slice(int(starts[first]), stop), bias, delay)
            own = starts[first:last] - starts[first]
            sums[:, first:last] = window_sums(own, *self._at(track, slice(int(starts[first]), stop), delay))
            squared_time[first:last] = np.interp(time[first:last] - delay, track.time, track.squared_time)
            if len(self.empty.link):
                between.append(self.empty.part(first, last).integrated(track, delay))
                links.append(last - first)
            first = last
        motion = of_windows(sums, count, spread)
        return FieldWindows(
            time=time,
            count=count,
            field=field,
            link_time=np.diff(squared_time),
            linked=self.linked,
            bias=bias,
            delay=delay,
            between=joined_between(between, links) if between else NOTHING,
            **motion._asdict(),
        )

    def with_rate(self, angular_rate: Array) -> Preintegration:
        """Return the same samples and windows with another angular rate (G, 3) in rad/s."""
        return self._with(angular_rate=np.ascontiguousarray(angular_rate))

    def stretch(self, first: int, last: int, beyond: float) -> tuple[Preintegration, slice]:
        """Return the samples of the windows `first` ≤ n < `last`, and the slice of the gyroscope samples among them.

        Args:
            first, last: 0 ≤ first < last ≤ number of windows.
            beyond: s of the gyroscope kept before the first and after the last magnetometer sample.
        """
        edges = np.append(self.starts, len(self.magnetometer_time))
        rows = slice(edges[first], edges[last])
        time = self.magnetometer_time[rows]
        begin = int(np.searchsorted(self.gyroscope_time, time[0] - beyond, side="right")) - 1
        rates = slice(max(begin, 0), int(np.searchsorted(self.gyroscope_time, time[-1] + beyond)) + 1)
        result = self._with(
            magnetometer_time=time,
            magnetic_field=self.magnetic_field[rows],
            gyroscope_time=self.gyroscope_time[rates],
            angular_rate=self.angular_rate[rates],
            starts=self.starts[first:last] - self.starts[first],
            linked=self.linked[first : last - 1],
            empty=self.empty.part(first, last - 1),
            added_variance=self._added_variance(rates),
        )
        return result, rates

    def _with(self, **changes: Array | EmptyWindows | None) -> Preintegration:
        """Return a copy with other fields and the same windows, which are not computed again."""
        result = copy.copy(self)
        for name, value in changes.items():
            object.__setattr__(result, name, value)
        return result

    def _added_variance(self, rows: slice) -> Array | None:
        stop = min(rows.stop, len(self.gyroscope_time)) - 1
        return None if self.added_variance is None else self.added_variance[rows.start : stop]

    def _track(self, before: GyroscopeTrack | None, rows: slice, bias: Array, delay: float) -> GyroscopeTrack:
        """Integrate the gyroscope over a slice of the magnetometer's samples, in the world frame of `before`."""

        def after(sample: int) -> int:
            when = self.magnetometer_time[sample] - delay
            return int(np.searchsorted(self.gyroscope_time, when, side="right"))

        begin, stop = 0, len(self.gyroscope_time)
        if rows.stop < len(self.magnetometer_time):  # beyond the first sample of the next piece
            stop = min(max(after(rows.stop), 1) + _MARGIN, stop)
        if before is not None:
            begin = max(after(rows.start) - 1 - _MARGIN, 0)
        time, rate = self.gyroscope_time[begin:stop], self.angular_rate[begin:stop]
        added_variance = self._added_variance(slice(begin, stop))
        track = GyroscopeTrack.integrate(
            time, rate, bias, interval_mean=self.interval_mean, added_variance=added_variance
        )
        return track if before is None else track.following(before, float(time[min(_MARGIN, len(time) - 1)]))

    def _at(self, track: GyroscopeTrack, rows: slice, delay: float) -> tuple[Spinor, Array, Array]:
        """Return R, K (9, len(rows)) and the rate (len(rows), 3) less the bias, at the stamps less the delay."""
        when = self.magnetometer_time[rows] - delay
        begin = int(np.searchsorted(track.time, when[0]))
        own = slice(begin, begin + len(when))
        if np.array_equal(when, track.time[own]):
            p, q = track.rotation
            rate = track.angular_rate[own]
            return (p[own], q[own]), track.lever[:, own], rate - track.bias if track.bias.any() else rate
        return track.motion_at(when)
