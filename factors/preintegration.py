"""Gyroscope and magnetometer samples, brought together in windows: the data behind every field chain.

The gyroscope is integrated once over the whole log into an attitude R_k against an arbitrary world
frame ("integrated world"); in that frame the field direction g stands still but for the gyroscope's
noise and bias error. A window of W magnetometer samples then reads, with B = F·A,

    mean(m_j) = B M g + h + ε/√W,    M = mean_j R_jᵀ,

which holds however far the vehicle turns inside the window (averaging m alone would set M = R_cᵀ).
A bias error δ turns R_k into Exp(K_k δ) R_k, K_k = −∫ R dt, so that two windows are linked by

    g' = Exp(−(K̄' − K̄) δ) g,    tangent noise σ_g √(Σ dt²),

K̄ being the mean over the window. Nothing else depends on the bias, and only to first order: when it
has moved far, integrate again. A delay τ of the magnetometer reads R at t − τ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.rotations import Array, chain, exponential, matrices, multiply

_CHUNK = 32768  # samples whose matrices are held at a time


@dataclass(frozen=True, eq=False)
class FieldWindows:
    """n windows integrated at one bias and delay; the windows run along the last axis, contiguous.

    Attributes:
        time: (n,) s, mean stamp.
        count: (n,) magnetometer samples.
        field: (3, n) T, mean measured field.
        rotation: (3, 3, n) mean of R_jᵀ, integrated world→sensor.
        rotation_rate: (3, 3, n) its derivative with respect to the delay, 1/s.
        lever: (3, 3, n − 1) s, K̄' − K̄ between neighbours.
        link_time: (n − 1,) s², Σ dt² between neighbours; the link's variance is σ_g² times it.
        linked: (n − 1,) False where a hole in the gyroscope parts two windows.
        bias: (3,) rad/s and delay: s, where the gyroscope was integrated.
    """

    time: Array
    count: Array
    field: Array
    rotation: Array
    rotation_rate: Array
    lever: Array
    link_time: Array
    linked: np.ndarray
    bias: Array
    delay: float

    def __len__(self) -> int:
        return len(self.time)


class _Track(NamedTuple):
    """The integrated gyroscope at its own stamps: spinors, K (9, G) and Σ dt² (G,)."""

    p: np.ndarray
    q: np.ndarray
    lever: Array
    variance: Array


@dataclass(frozen=True, eq=False)
class Preintegration:
    """The samples of both sensors and the windows they fall into.

    Args:
        magnetometer_time, magnetic_field: (M,) s, (M, 3) T.
        gyroscope_time, angular_rate: (G,) s, (G, 3) rad/s, may differ in rate and clock from the former.
        interval_mean: the rate is the mean since the previous sample, not the value at the stamp.
        length: s, longest window.
        turn: rad, largest rotation inside a window; infinitely small gives one window per sample.
        hole: s, a gyroscope step longer than this parts the chain.

    Raises:
        MagycError: no magnetometer sample lies inside the gyroscope's time span.
    """

    magnetometer_time: Array
    magnetic_field: Array
    gyroscope_time: Array
    angular_rate: Array
    interval_mean: bool = False
    length: float = 1.0
    turn: float = 0.2
    hole: float = 0.5

    def __post_init__(self) -> None:
        inside = (self.magnetometer_time >= self.gyroscope_time[0]) & (
            self.magnetometer_time <= self.gyroscope_time[-1]
        )
        if inside.sum() < 3 or len(self.gyroscope_time) < 3:
            raise MagycError(
                f"{inside.sum()} magnetometer samples inside the gyroscope's time span "
                f"({self.gyroscope_time[0]:.3f} to {self.gyroscope_time[-1]:.3f} s), at least 3 are needed"
            )
        if not inside.all():
            object.__setattr__(self, "magnetometer_time", self.magnetometer_time[inside])
            object.__setattr__(self, "magnetic_field", self.magnetic_field[inside])
        step = np.diff(self.gyroscope_time)
        holes = np.flatnonzero(step > max(10 * float(np.median(step)), self.hole))
        speed = np.linalg.norm(self.angular_rate, axis=1)
        progress = np.maximum(0.5 * (speed[1:] + speed[:-1]) / self.turn, 1 / self.length) * step
        progress[holes] = 1.0
        distance = np.interp(
            self.magnetometer_time, self.gyroscope_time, np.concatenate([[0.0], np.cumsum(progress)])
        )
        segment = np.searchsorted(self.gyroscope_time[holes], self.magnetometer_time, side="right")
        window = np.floor(distance).astype(np.int64) + segment
        starts = np.concatenate([[0], np.flatnonzero(np.diff(window)) + 1])
        object.__setattr__(self, "_starts", starts)
        object.__setattr__(self, "_linked", np.diff(segment[starts]) == 0)
        object.__setattr__(self, "_step", step)

    @property
    def starts(self) -> np.ndarray:
        """(n,) index of each window's first magnetometer sample."""
        return self._starts  # type: ignore[attr-defined,no-any-return]

    def integrate(self, bias: Array | None = None, delay: float = 0.0) -> FieldWindows:
        """Integrate the gyroscope at `bias` (3,) rad/s, the magnetometer taken `delay` s earlier."""
        bias = np.zeros(3) if bias is None else np.asarray(bias, dtype=float)
        track = self._track(bias)
        starts, total = self.starts, len(self.magnetometer_time)
        count = np.diff(np.append(starts, total)).astype(float)
        sums = np.empty((29, len(starts)))  # Rᵀ 9, its rate 9, K 9, Σ dt² 1, time 1
        first = 0
        while first < len(starts):  # chunks of whole windows, so that memory stays flat
            last = max(int(np.searchsorted(starts, starts[first] + _CHUNK)), first + 1)
            stop = int(starts[last]) if last < len(starts) else total
            rows = self._at(track, slice(int(starts[first]), stop), bias, delay)
            np.add.reduceat(rows, starts[first:last] - starts[first], axis=1, out=sums[:, first:last])
            first = last
        sums /= count
        return FieldWindows(
            time=sums[28],
            count=count,
            field=np.ascontiguousarray(np.add.reduceat(self.magnetic_field, starts, axis=0).T / count),
            rotation=sums[:9].reshape(3, 3, -1),
            rotation_rate=sums[9:18].reshape(3, 3, -1),
            lever=np.diff(sums[18:27]).reshape(3, 3, -1),
            link_time=np.diff(sums[27]),
            linked=self._linked,  # type: ignore[attr-defined]
            bias=bias,
            delay=delay,
        )

    def _increments(self, rows: slice, bias: Array) -> Array:
        """Rotation vectors from sample k to k + 1 by the trapezoid rule, (len(rows), 3)."""
        stop = rows.stop + 1
        if self.interval_mean:
            mean = self.angular_rate[rows.start + 1 : stop] - bias
        else:
            mean = 0.5 * (self.angular_rate[rows] + self.angular_rate[rows.start + 1 : stop]) - bias
        return mean * self._step[rows, None]  # type: ignore[attr-defined,no-any-return]

    def _track(self, bias: Array) -> _Track:
        n = len(self.gyroscope_time)
        step: Array = self._step  # type: ignore[attr-defined]
        p, q = chain(exponential(self._increments(slice(0, n - 1), bias)))
        lever = np.zeros((9, n))
        for first in range(0, n - 1, _CHUNK):
            stop = min(first + _CHUNK, n - 1)
            r = matrices((p[first : stop + 1], q[first : stop + 1]))
            # ∫ R dt by the trapezoid rule: the relative error is φ²/12 of one step, in a Jacobian.
            lever[:, first + 1 : stop + 1] = (r[:, 1:] + r[:, :-1]) * (-0.5 * step[first:stop])
        np.cumsum(lever, axis=1, out=lever)
        variance = np.zeros(n)
        np.cumsum(step**2, out=variance[1:])
        return _Track(p, q, lever, variance)

    def _at(self, track: _Track, rows: slice, bias: Array, delay: float) -> Array:
        """Rᵀ, its derivative with respect to the delay, K, Σ dt² and t of single samples: (29, len(rows))."""
        time = self.magnetometer_time[rows]
        when = time - delay
        gyro = self.gyroscope_time
        left = np.clip(np.searchsorted(gyro, when, side="right") - 1, 0, len(gyro) - 2)
        since = when - gyro[left]
        step: Array = self._step[left]  # type: ignore[attr-defined]
        share = since / step
        rate_before, rate_after = self.angular_rate[left], self.angular_rate[left + 1]
        p, q = track.p[left], track.q[left]
        lever, variance = track.lever[:, left], track.variance[left]
        rate = (rate_after if self.interval_mean else rate_before) - bias
        if since.any():  # else every sample lies on a gyroscope stamp
            change = 0.0 if self.interval_mean else (rate_after - rate_before) * share[:, None]
            p, q = multiply((p, q), exponential((rate + 0.5 * change) * since[:, None]))
            rate = rate + change
            lever += (track.lever[:, left + 1] - lever) * share
            variance += (track.variance[left + 1] - variance) * share
        r = matrices((p, q))
        result = np.empty((29, len(time)))
        result[:9] = r[[0, 3, 6, 1, 4, 7, 2, 5, 8]]  # transposed
        # d/dτ R(t − τ)ᵀ = [ω]× Rᵀ, row by row.
        r0, r1, r2 = result[0:3], result[3:6], result[6:9]
        x, y, z = rate.T
        result[9:12] = y * r2 - z * r1
        result[12:15] = z * r0 - x * r2
        result[15:18] = x * r1 - y * r0
        result[18:27] = lever
        result[27] = variance
        result[28] = time
        return result
