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

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.rotations import Array, chain, exponential, increments, matrices, multiply

_ROWS = 21  # per sample: Rᵀ 9, K 9, angular rate 3
_CHUNK = 32768  # samples whose matrices are held at a time


@dataclass(frozen=True, eq=False)
class FieldWindows:
    """n windows integrated at one bias and delay; the windows run along the last axis, contiguous.

    Attributes:
        time: (n,) s, mean stamp.
        count: (n,) magnetometer samples.
        field: (3, n) T, mean measured field.
        rotation: (3, 3, n) mean of R_jᵀ, integrated world→sensor.
        rotation_rate: (3, 3, n) its derivative with respect to the delay, 1/s (mean rate times mean rotation).
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
    """The gyroscope integrated at `bias`, at its own stamps: spinors, K (9, G) s and Σ dt² (G,) s²."""

    bias: Array
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

    Attributes:
        starts: (n,) index of each window's first magnetometer sample.
        linked: (n − 1,) False where a hole parts two windows.
        step: (G − 1,) s between gyroscope samples.

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
    starts: np.ndarray = field(init=False)
    linked: np.ndarray = field(init=False)
    step: Array = field(init=False)

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
        object.__setattr__(self, "starts", starts)
        object.__setattr__(self, "linked", np.diff(segment[starts]) == 0)
        object.__setattr__(self, "step", step)

    def integrate(self, bias: Array | None = None, delay: float = 0.0) -> FieldWindows:
        """Integrate the gyroscope at `bias` (3,) rad/s, the magnetometer taken `delay` s earlier."""
        bias = np.zeros(3) if bias is None else np.asarray(bias, dtype=float)
        track = self._track(bias)
        starts, total = self.starts, len(self.magnetometer_time)
        count = np.diff(np.append(starts, total)).astype(float)
        means = np.empty((_ROWS, len(starts)))
        first = 0
        while first < len(starts):  # chunks of whole windows, so that memory stays flat
            last = max(int(np.searchsorted(starts, starts[first] + _CHUNK)), first + 1)
            stop = int(starts[last]) if last < len(starts) else total
            rows = self._at(track, slice(int(starts[first]), stop), delay)
            np.add.reduceat(rows, starts[first:last] - starts[first], axis=1, out=means[:, first:last])
            first = last
        means /= count
        rotation = means[:9].reshape(3, 3, -1)
        x, y, z = means[18:21] - bias[:, None]
        # d/dτ R(t − τ)ᵀ = [ω]× Rᵀ, row by row.
        rotation_rate = np.stack(
            [
                y * rotation[2] - z * rotation[1],
                z * rotation[0] - x * rotation[2],
                x * rotation[1] - y * rotation[0],
            ]
        )
        time = np.add.reduceat(self.magnetometer_time, starts) / count
        return FieldWindows(
            time=time,
            count=count,
            field=np.ascontiguousarray(np.add.reduceat(self.magnetic_field, starts, axis=0).T / count),
            rotation=rotation,
            rotation_rate=rotation_rate,
            lever=np.diff(means[9:18]).reshape(3, 3, -1),
            link_time=np.diff(np.interp(time - delay, self.gyroscope_time, track.variance)),
            linked=self.linked,
            bias=bias,
            delay=delay,
        )

    def _increments(self, bias: Array) -> Array:
        """Rotation vectors from sample k to k + 1, (G − 1, 3)."""
        if self.interval_mean:
            return (self.angular_rate[1:] - bias) * self.step[:, None]
        return increments(self.gyroscope_time, self.angular_rate, bias)

    def _track(self, bias: Array) -> _Track:
        n = len(self.gyroscope_time)
        step = self.step
        p, q = chain(exponential(self._increments(bias)))
        lever = np.zeros((9, n))
        for first in range(0, n - 1, _CHUNK):
            stop = min(first + _CHUNK, n - 1)
            r = matrices((p[first : stop + 1], q[first : stop + 1]))
            # ∫ R dt by the trapezoid rule: the relative error is φ²/12 of one step, in a Jacobian.
            lever[:, first + 1 : stop + 1] = (r[:, 1:] + r[:, :-1]) * (-0.5 * step[first:stop])
        np.cumsum(lever, axis=1, out=lever)
        variance = np.zeros(n)
        np.cumsum(step**2, out=variance[1:])
        return _Track(bias, p, q, lever, variance)

    def _at(self, track: _Track, rows: slice, delay: float) -> Array:
        """Rᵀ (9), K (9) and the measured rate (3) at single samples' stamps less the delay: (21, len(rows))."""
        gyro = self.gyroscope_time
        when = self.magnetometer_time[rows] - delay
        result = np.empty((_ROWS, len(when)))
        if len(gyro) == len(self.magnetometer_time) and np.array_equal(when, gyro[rows]):
            r = matrices((track.p[rows], track.q[rows]))
            result[9:18] = track.lever[:, rows]
            result[18:] = self.angular_rate[rows].T
        else:
            left = np.clip(np.searchsorted(gyro, when, side="right") - 1, 0, len(gyro) - 2)
            since = when - gyro[left]
            share = since / self.step[left]
            rate, after = self.angular_rate[left], self.angular_rate[left + 1]
            if self.interval_mean:
                rate, change = after, np.zeros_like(after)
            else:
                change = (after - rate) * share[:, None]
            turned = exponential((rate + 0.5 * change - track.bias) * since[:, None])
            r = matrices(multiply((track.p[left], track.q[left]), turned))
            lever = track.lever[:, left]
            result[9:18] = lever + (track.lever[:, left + 1] - lever) * share
            result[18:] = (rate + change).T
        result[:9] = r.reshape(3, 3, -1).transpose(1, 0, 2).reshape(9, -1)
        return result
