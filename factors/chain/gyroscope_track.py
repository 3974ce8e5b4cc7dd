"""The gyroscope integrated over a log, computed once for all users.

    R_{k+1} = R_k Exp(φ_k),    K_k = −∫ R dt,    Σ dt²

R_k turns the sensor's axes at stamp k into those at the first stamp. A bias changed by δ turns R_k into
Exp(K_k δ) R_k to first order (as GTSAM preintegrates); σ_g² Σ dt² is the variance of its angle per axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import (
    Array,
    Spinor,
    chained,
    exponential,
    increments,
    matrices,
    multiply,
)

_CHUNK = 32768  # stamps whose matrices are held at a time, which bounds the memory
_BLOCK = 24  # stamps summed by one product
_UP_TO = np.triu(np.ones((_BLOCK, _BLOCK)))


def running_sums(values: Array) -> Array:
    """Return the cumulative sums of (k, n) along each row.

    The sums are formed in blocks by a triangular matrix: sequential additions wait for each other and take four times
    as long.
    """
    rows, n = values.shape
    blocks = -(-n // _BLOCK)
    padded = np.zeros((rows, blocks * _BLOCK))
    padded[:, :n] = values
    inside = (padded.reshape(-1, _BLOCK) @ _UP_TO).reshape(rows, blocks, _BLOCK)
    inside[:, 1:] += np.cumsum(inside[:, :-1, -1], axis=1)[:, :, None]
    return inside.reshape(rows, -1)[:, :n]


def summed_rate(time: Array, rate: Array) -> Array:
    """Return the cumulative integral (G, …) in rad of rates (G, …) in rad/s by the trapezoid rule.

    The result is not an attitude. It is the angle about an axis only where the other axes hardly turn, and the path
    length if the rate is a speed. It serves where the amount of rotation matters but not its direction.
    """
    total = np.zeros_like(rate)
    step = np.diff(time).reshape(-1, *[1] * (rate.ndim - 1))
    np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step, axis=0, out=total[1:])
    return total


@dataclass(frozen=True, eq=False)
class GyroscopeTrack:
    """The gyroscope integrated from its first stamp on.

    Attributes:
        time: (G,) s, ascending.
        angular_rate: (G, 3) rad/s, bias included.
        bias: (3,) rad/s, subtracted before the integration.
        interval_mean: the rates are means since the previous stamp, not values at the stamps.
        increment: (G − 1, 3) rad, rotation vectors from stamp to stamp.
        rotation: R at the stamps, as spinors (G,).
        lever_before: (9,) s, K at the first stamp, for a piece of a longer track (`following`).
        squared_time_before: s², Σ dt² at the first stamp, for a piece of a longer track.
        added_variance: (G − 1,) s², what errors of stamps or lost samples add to dt² in each step; None for none.
    """

    time: Array
    angular_rate: Array
    bias: Array
    interval_mean: bool
    increment: Array
    rotation: Spinor
    lever_before: Array = field(default_factory=lambda: np.zeros(9))
    squared_time_before: float = 0.0
    added_variance: Array | None = None

    @classmethod
    def integrate(
        cls,
        time: Array,
        angular_rate: Array,
        bias: Array | None = None,
        *,
        interval_mean: bool = False,
        stamps: Array | None = None,
        added_variance: Array | None = None,
    ) -> GyroscopeTrack:
        """Integrate the rates (`rotations.increments`).

        Args:
            time: (G,) s, ascending.
            angular_rate: (G, 3) rad/s.
            bias: (3,) rad/s; None for no bias.
            interval_mean: the rates are means since the previous stamp.
            stamps: (n,) s inside `time`, where to integrate instead of at `time`; rates AT their stamps are
                interpolated linearly.
            added_variance: (G − 1,) s², what errors of stamps or lost samples add to dt² in each step; None for none.
        """
        b = np.zeros(3) if bias is None else bias
        if stamps is not None:
            if interval_mean:  # the rate of a stamp is that of the interval containing it
                angular_rate = angular_rate[np.searchsorted(time, stamps)]
            elif len(stamps) != len(time) or not np.array_equal(stamps, time):
                angular_rate = np.stack([np.interp(stamps, time, axis) for axis in angular_rate.T], axis=1)
            time = stamps
        if interval_mean:
            increment = (angular_rate[1:] - b) * np.diff(time)[:, None]
        else:
            increment = increments(time, angular_rate, None if bias is None else b)
        rotation = chained(increment)
        return cls(time, angular_rate, b, interval_mean, increment, rotation, added_variance=added_variance)

    def following(self, before: GyroscopeTrack, when: float) -> GyroscopeTrack:
        """Return this piece of a track in the world frame of the preceding piece, with K and Σ dt² continued.

        Args:
            before: the preceding piece, which overlaps this one.
            when: s, a stamp of both pieces, at which they are joined.
        """
        here, there = (int(np.searchsorted(track.time, when)) for track in (self, before))
        p, q = (x[here : here + 1] for x in self.rotation)
        joined = multiply(
            (before.rotation[0][there : there + 1], before.rotation[1][there : there + 1]), (p.conj(), -q)
        )
        result = replace(self, rotation=multiply(joined, self.rotation))
        return replace(
            result,
            lever_before=before.lever[:, there] - result.lever[:, here],
            squared_time_before=float(before.squared_time[there] - self.squared_time[here]),
        )

    @cached_property
    def step(self) -> Array:
        """Intervals between stamps (G − 1,) in s."""
        return np.diff(self.time)

    @cached_property
    def matrices(self) -> Array:
        """Rotation matrices at the stamps (9, G), row by row along the first axis."""
        return matrices(self.rotation)

    @cached_property
    def lever(self) -> Array:
        """K = −∫ R dt (9, G) in s by the trapezoid rule (relative error φ²/12 of a step), rows as in `matrices`."""
        p, q = self.rotation
        n, step = len(self.time), self.step
        lever = np.empty((9, n))
        if compiled.loops:
            compiled.loops.lever(n, *map(compiled.given, (p, q, step, self.lever_before)), lever)
            return lever
        lever[:, 0] = self.lever_before
        for first in range(0, n - 1, _CHUNK):
            stop = min(first + _CHUNK, n - 1)
            r = matrices((p[first : stop + 1], q[first : stop + 1]))
            added = lever[:, first + 1 : stop + 1]
            np.add(r[:, 1:], r[:, :-1], out=added)
            added *= -0.5 * step[first:stop]
        return running_sums(lever)

    @cached_property
    def squared_time(self) -> Array:
        """Σ dt² up to each stamp (G,) in s², with what errors of the stamps or lost samples add to it."""
        squared = self.step**2 if self.added_variance is None else self.step**2 + self.added_variance
        result = np.full(len(self.time), self.squared_time_before)
        result[1:] += np.cumsum(squared)
        return result

    def motion_at(self, when: Array) -> tuple[Spinor, Array, Array]:
        """Return R as spinors (n,), K (9, n) and the rate (n, 3), as `rotation_at` and `lever_at` do."""
        if compiled.loops is None:
            rotation, rate = self.rotation_at(when)
            return rotation, self.lever_at(when), rate
        n = len(when)
        track = (self.time, *self.rotation, self.angular_rate, self.increment.T, self.lever, self.bias)
        inputs = map(compiled.given, (*track, np.array([float(self.interval_mean)]), when))
        result = np.empty(n, complex), np.empty(n, complex), np.empty((9, n)), np.empty((n, 3))
        compiled.loops.motion_at(len(self.time), *inputs, *result)
        return (result[0], result[1]), result[2], result[3]

    def rotation_at(self, when: Array) -> tuple[Spinor, Array]:
        """Return R as spinors (n,), and the rate (n, 3) in rad/s less the bias, at times inside the track.

        Between stamps the rate is linear; the difference between the whole increment and its integral is spread
        evenly.
        """
        left, since, share = self._place(when)
        share = share[:, None]
        rate, after = self.angular_rate[left], self.angular_rate[left + 1]
        if self.interval_mean:
            rate, turned = after, self.increment[left] * share
        else:
            linear = 0.5 * (rate + after) - self.bias
            rest = self.increment[left] - linear * self.step[left, None]
            rate = rate + (after - rate) * share
            turned = (0.5 * (self.angular_rate[left] + rate) - self.bias) * since[:, None] + rest * share
            rate = rate + rest / self.step[left, None]
        p, q = self.rotation
        return multiply((p[left], q[left]), exponential(turned)), rate - self.bias

    def lever_at(self, when: Array) -> Array:
        """Return K (9, n) in s at times inside the track, interpolated linearly between stamps."""
        left, _, share = self._place(when)
        before = self.lever[:, left]
        result: Array = before + (self.lever[:, left + 1] - before) * share
        return result

    def _place(self, when: Array) -> tuple[np.ndarray, Array, Array]:
        """Return the step containing each time: its index, the time since its begin in s, and that as a share of the
        step.
        """
        left = np.clip(np.searchsorted(self.time, when, side="right") - 1, 0, len(self.time) - 2)
        since = when - self.time[left]
        return left, since, since / self.step[left]
