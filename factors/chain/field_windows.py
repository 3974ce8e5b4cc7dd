"""Windows of magnetometer samples with the gyroscope's integrals over each: the data of a field chain.

Windows without a sample hold the gyroscope's motion while the field is not measured. A link across a gap of many
seconds is exact in attitude and bias. The effect of a gyroscope error on it, such as a scale error, is an integral over
the rotation inside the gap, which the windows on either side do not contain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.gyroscope_track import GyroscopeTrack
from magyc_gtsam.factors.chain.median import median
from magyc_gtsam.factors.chain.rotations import Array, exponential_matrices, matrices

_GAP = 3.0  # magnetometer steps; a magnetometer slower than the windows has no gaps


@dataclass(frozen=True, eq=False)
class EmptyWindows:
    """The time intervals of k windows without a magnetometer sample, in ascending order.

    Attributes:
        stamps: (3, k) s on the magnetometer's clock: begin, middle and end of each.
        link: (k,) index of the link that contains each window.
    """

    stamps: Array
    link: np.ndarray

    @classmethod
    def of(cls, time: Array, passed: Array, numbers: np.ndarray, gap: np.ndarray) -> EmptyWindows:
        """Return the empty windows inside links.

        Args:
            time, passed: (G,) s, the gyroscope's stamps, and the number of windows passed at each.
            numbers: (n,) numbers of the windows that have samples, ascending where there is a gap.
            gap: (n − 1,) bool, links across a gap of the magnetometer.
        """
        missing = np.where(gap, np.maximum(np.diff(numbers) - 1, 0), 0)
        if not missing.any():
            return NONE
        link = np.flatnonzero(missing)
        # At most one window per gyroscope step: windows may be shorter than the steps.
        begin, end = numbers[link] + 1.0, numbers[link + 1].astype(float)
        steps = np.searchsorted(passed, end) - np.searchsorted(passed, begin)
        count = np.clip(missing[link], 1, np.maximum(steps, 1))
        inside = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        width = np.repeat((end - begin) / count, count)
        first = np.repeat(begin, count) + inside * width
        edges = np.array([first, first + 0.5 * width, first + width])
        return cls(np.interp(edges, passed, time), np.repeat(link, count))

    def part(self, first: int, stop: int) -> EmptyWindows:
        """Return the windows in the links `first` ≤ link < `stop`, numbered from `first` on."""
        own = slice(*np.searchsorted(self.link, [first, stop]))
        return EmptyWindows(self.stamps[:, own], self.link[own] - first)

    def integrated(self, track: GyroscopeTrack, delay: float) -> Between:
        """Return the motion in the windows, from a track that covers them."""
        begin, middle, end = (matrices(track.rotation_at(each - delay)[0]) for each in self.stamps)
        begin, middle, end = (each.reshape(3, 3, -1) for each in (begin, middle, end))
        turn = np.einsum("jin,jkn->ikn", begin, end)
        axis = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        sine, cosine = np.sqrt(np.square(axis).sum(axis=0)), 0.5 * (np.einsum("iin->n", turn) - 1)
        angle = np.arctan2(sine, cosine) / np.maximum(sine, 1e-12)
        angle[sine < 1e-9] = 1.0
        rate = axis * angle / np.maximum(self.stamps[2] - self.stamps[0], 1e-9)
        return Between(self.stamps[1], self.link, middle.swapaxes(0, 1).copy(), rate)


@dataclass(frozen=True, eq=False)
class Between:
    """The motion in k empty windows.

    Attributes:
        time: (k,) s, middles.
        link: (k,) ascending, index of the link that contains each window.
        rotation: (3, 3, k) integrated world → sensor.
        rate: (3, k) rad/s in the sensor's axes, mean, less the bias of the integration.
    """

    time: Array
    link: np.ndarray
    rotation: Array
    rate: Array

    def __len__(self) -> int:
        return len(self.time)

    def turned(self, turn: Array) -> Between:
        """Return the motion in another world frame, into which `turn` (3, 3) rotates."""
        return replace(self, rotation=np.einsum("ijn,kj->ikn", self.rotation, turn))

    def part(self, first: int, stop: int) -> Between:
        """Return the motion in the links `first` ≤ link < `stop`, numbered from `first` on."""
        own = slice(*np.searchsorted(self.link, [first, stop]))
        return Between(self.time[own], self.link[own] - first, self.rotation[:, :, own], self.rate[:, own])


def joined_between(parts: list[Between], links: list[int]) -> Between:
    """Concatenate motions; `links` are their numbers of links, by which the link indices continue."""
    before = np.cumsum([0, *links[:-1]])
    return Between(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.link + first for part, first in zip(parts, before, strict=True)]),
        np.concatenate([part.rotation for part in parts], axis=-1),
        np.concatenate([part.rate for part in parts], axis=-1),
    )


def gaps(time: Array, starts: np.ndarray, length: float) -> np.ndarray:
    """Return (n − 1,) bool: links across which the magnetometer pauses.

    A pause is longer than a window and longer than several times the median sample interval.

    Args:
        time: (M,) s, stamps of all magnetometer samples.
        starts: (n,) index of each window's first sample.
        length: s, longest window.
    """
    across = time[starts[1:]] - time[starts[1:] - 1]
    result: np.ndarray = across > length
    return result & (across > _GAP * median(np.diff(time))) if result.any() else result


NONE = EmptyWindows(np.empty((3, 0)), np.empty(0, dtype=np.int64))
NOTHING = Between(np.empty(0), NONE.link, np.empty((3, 3, 0)), np.empty((3, 0)))


@dataclass(frozen=True, eq=False)
class FieldWindows:
    """n windows integrated at one bias and delay; the windows run along the last, contiguous axis.

    Attributes:
        time: (n,) s, mean stamp.
        count: (n,) number of magnetometer samples.
        field: (3, n) T, mean measured field.
        rotation: (3, 3, n) mean of R_jᵀ, integrated world→sensor.
        rotation_bias: (3, 3, 3, n) its derivative with respect to the bias (third axis), s.
        rotation_rate: (3, 3, n) its derivative with respect to the delay, 1/s.
        lever: (3, 3, n − 1) s, K̄' − K̄ between neighbours.
        link_time: (n − 1,) s², Σ dt² between neighbours; the link's variance is σ_g² times it.
        linked: (n − 1,) False where a hole in the gyroscope separates two windows.
        bias: (3,) rad/s and delay: s, at which the gyroscope was integrated.
        between: the motion while the field was not measured.
    """

    time: Array
    count: Array
    field: Array
    rotation: Array
    rotation_bias: Array
    rotation_rate: Array
    lever: Array
    link_time: Array
    linked: np.ndarray
    bias: Array
    delay: float
    between: Between = NOTHING

    def __len__(self) -> int:
        return len(self.time)

    def rotation_at(self, bias: Array, delay: float) -> Array:
        """Return M (3, 3, n) at a bias and delay, to first order; the latest result is cached and must not be written
        to.
        """

        def moved() -> Array:
            if compiled.loops:
                change = np.array([*(bias - self.bias), delay - self.delay])
                parts = map(compiled.given, (self.rotation, self.rotation_bias, self.rotation_rate))
                result = np.empty(self.rotation.shape)
                compiled.loops.rotate(len(self), *parts, change, result)
                return result
            result = np.einsum("ijkn,k->ijn", self.rotation_bias, bias - self.bias)
            result += self.rotation
            if delay != self.delay:
                result += (delay - self.delay) * self.rotation_rate
            return result

        return self._kept("rotation", (bias.tobytes(), delay), moved)

    def turn_at(self, bias: Array) -> Array:
        """Return E = Exp(−ΔK (b − b₀)) (3, 3, n − 1) from one window to the next; cached in the same way."""

        def turned() -> Array:
            change = self.bias - bias
            if compiled.loops:
                result = np.empty(self.lever.shape)
                compiled.loops.turn(self.lever.shape[2], compiled.given(self.lever), change, result)
                return result
            return exponential_matrices(np.einsum("ijn,j->in", self.lever, change))

        return self._kept("turn", bias.tobytes(), turned)

    @cached_property
    def spread(self) -> float:
        """Mean distance, in T, of a window's field from the centroid of all."""
        away = self.field - self.field.mean(axis=1)[:, None]
        return float(np.sqrt(np.einsum("in,in->n", away, away)).mean())

    def _kept(self, what: str, key: object, compute: Callable[[], Array]) -> Array:
        """Return the cached result if the key is the last one; residuals and Jacobians are requested at the same
        state.
        """
        kept = self._last.get(what)
        if kept is None or kept[0] != key:
            kept = self._last[what] = key, compute()
        return kept[1]

    @cached_property
    def _last(self) -> dict[str, tuple[object, Array]]:
        return {}

    def part(self, first: int, stop: int) -> FieldWindows:
        """Return the windows `first` ≤ n < `stop`, in the same world frame."""
        rows, links = slice(first, stop), slice(first, stop - 1)
        return replace(
            self,
            time=self.time[rows],
            count=self.count[rows],
            field=self.field[:, rows],
            rotation=self.rotation[:, :, rows],
            rotation_bias=self.rotation_bias[:, :, :, rows],
            rotation_rate=self.rotation_rate[:, :, rows],
            lever=self.lever[:, :, links],
            link_time=self.link_time[links],
            linked=self.linked[links],
            between=self.between.part(first, stop - 1),
        )


def in_frame_of(before: FieldWindows, after: FieldWindows) -> FieldWindows:
    """Return `after`, whose first window is the last one of `before`, rotated into the world frame of `before`."""
    # R' = Qᵀ R for all samples, so that the windows' means M = mean Rᵀ become M' = M Q.
    left, _, right = np.linalg.svd(np.linalg.solve(before.rotation[:, :, -1], after.rotation[:, :, 0]))
    turn = left @ right
    return replace(
        after,
        rotation=np.einsum("ijn,kj->ikn", after.rotation, turn),
        rotation_bias=np.einsum("ijbn,kj->ikbn", after.rotation_bias, turn),
        rotation_rate=np.einsum("ijn,kj->ikn", after.rotation_rate, turn),
        lever=np.einsum("ij,jkn->ikn", turn, after.lever),
        between=after.between.turned(turn),
    )


def joined(parts: list[FieldWindows]) -> FieldWindows:
    """Join parts in one world frame, each of which begins with the last window of the part before."""

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
        between=joined_between([part.between for part in parts], [len(part.linked) for part in parts]),
    )
