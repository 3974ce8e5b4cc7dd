"""The gyroscope integrated over a log: what every other file here needs of it, computed in one place.

    R_{k+1} = R_k Exp(φ_k),    K_k = −∫ R dt,    Σ dt²

R_k turns the sensor's axes at stamp k into those at the first stamp; a bias moved by δ turns it into
Exp(K_k δ) R_k to first order (as GTSAM preintegrates), and σ_g² Σ dt² is the variance of its angle per axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain.rotations import (
    Array,
    Spinor,
    chain,
    exponential,
    increments,
    matrices,
    multiply,
)

_CHUNK = 32768  # stamps whose matrices are held at a time
_BLOCK = 24  # stamps that are summed by one product
_UP_TO = np.triu(np.ones((_BLOCK, _BLOCK)))


def running_sums(values: Array) -> Array:
    """Sums of (k, n) along the rows up to each entry: in blocks by a triangular matrix, for one addition after the
    other waits for the one before, four times as long."""
    rows, n = values.shape
    blocks = -(-n // _BLOCK)
    padded = np.zeros((rows, blocks * _BLOCK))
    padded[:, :n] = values
    inside = (padded.reshape(-1, _BLOCK) @ _UP_TO).reshape(rows, blocks, _BLOCK)
    inside[:, 1:] += np.cumsum(inside[:, :-1, -1], axis=1)[:, :, None]
    return inside.reshape(rows, -1)[:, :n]


def summed_rate(time: Array, rate: Array) -> Array:
    """(G, …) rad, rates (G, …) rad/s summed from the first stamp on by the trapezoid rule.

    No attitude: the angle about an axis only where the others hardly turn, and the length of the way of a speed. For
    what asks how much the sensor turned and not where to.
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
        bias: (3,) rad/s, taken out before the integration.
        interval_mean: the rates are means since the previous stamp, not values at the stamps.
        increment: (G − 1, 3) rad, rotation vectors from stamp to stamp.
        rotation: R at the stamps, as spinors (G,).
        lever_before: (9,) s, K at the first stamp, and squared_time_before: s², Σ dt² there; of a piece of a longer
            track (`following`).
    """

    time: Array
    angular_rate: Array
    bias: Array
    interval_mean: bool
    increment: Array
    rotation: Spinor
    lever_before: Array = field(default_factory=lambda: np.zeros(9))
    squared_time_before: float = 0.0

    @classmethod
    def integrate(
        cls,
        time: Array,
        angular_rate: Array,
        bias: Array | None = None,
        *,
        interval_mean: bool = False,
        stamps: Array | None = None,
    ) -> GyroscopeTrack:
        """Integrate the rates (`rotations.increments`).

        Args:
            time: (G,) s, ascending.
            angular_rate: (G, 3) rad/s.
            bias: (3,) rad/s; None for no bias.
            interval_mean: the rates are means since the previous stamp.
            stamps: (n,) s inside `time`, where to integrate instead of at `time`; rates AT their stamps are
                interpolated linearly.
        """
        b = np.zeros(3) if bias is None else bias
        if stamps is not None:
            if interval_mean:  # the rate of a stamp is that of the interval in which it lies
                angular_rate = angular_rate[np.searchsorted(time, stamps)]
            elif len(stamps) != len(time) or not np.array_equal(stamps, time):
                angular_rate = np.stack([np.interp(stamps, time, axis) for axis in angular_rate.T], axis=1)
            time = stamps
        if interval_mean:
            increment = (angular_rate[1:] - b) * np.diff(time)[:, None]
        else:
            increment = increments(time, angular_rate, None if bias is None else b)
        return cls(time, angular_rate, b, interval_mean, increment, chain(exponential(increment)))

    def following(self, before: GyroscopeTrack, when: float) -> GyroscopeTrack:
        """This piece of a track in the world frame of the piece before it, with its K and Σ dt² continued.

        Args:
            before: the piece before, which overlaps this one.
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
        """(G − 1,) s between stamps."""
        return np.diff(self.time)

    @cached_property
    def matrices(self) -> Array:
        """(9, G) rotation matrices at the stamps, row by row along the first axis."""
        return matrices(self.rotation)

    @cached_property
    def lever(self) -> Array:
        """(9, G) s, K = −∫ R dt by the trapezoid rule (relative error φ²/12 of a step), rows as `matrices`."""
        p, q = self.rotation
        n, step = len(self.time), self.step
        lever = np.empty((9, n))
        lever[:, 0] = self.lever_before
        for first in range(0, n - 1, _CHUNK):
            stop = min(first + _CHUNK, n - 1)
            whole = stop - first == n - 1
            r = self.matrices if whole else matrices((p[first : stop + 1], q[first : stop + 1]))
            added = lever[:, first + 1 : stop + 1]
            np.add(r[:, 1:], r[:, :-1], out=added)
            added *= -0.5 * step[first:stop]
        return running_sums(lever)

    @cached_property
    def squared_time(self) -> Array:
        """(G,) s², Σ dt² up to each stamp."""
        return np.cumsum(np.concatenate([[self.squared_time_before], self.step**2]))

    def rotation_at(self, when: Array) -> tuple[Spinor, Array]:
        """R as spinors (n,), and the rate (n, 3) rad/s less the bias, at times inside the track.

        Between stamps the rate is linear, and what makes the whole step differ from its integral acts evenly.
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
        """(9, n) s, K at times inside the track, linear between stamps."""
        left, _, share = self._place(when)
        before = self.lever[:, left]
        result: Array = before + (self.lever[:, left + 1] - before) * share
        return result

    def _place(self, when: Array) -> tuple[np.ndarray, Array, Array]:
        """The step in which each time lies: its number, s since its begin, and that as a share of it."""
        left = np.clip(np.searchsorted(self.time, when, side="right") - 1, 0, len(self.time) - 2)
        since = when - self.time[left]
        return left, since, since / self.step[left]
