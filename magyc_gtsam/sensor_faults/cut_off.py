"""Detect turns faster than the gyroscope's full scale, during which the rotation is unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.sensor_faults.largest_value import LargestValue

MOST = 0.5  # largest share of the recording that may be left out
# The longer of `_HOLE` median steps and `_HOLE_DURATION` s is left out after each sample that was cut off; it is long
# enough to count as a gap (`Recording.gaps`).
_HOLE = 12
_HOLE_DURATION = 0.6
_STAMPS = 33  # samples needed for the median step; nothing is decided before
ROUNDING = 1e-9  # rad/s, below the step of any gyroscope: what a change of axes or units leaves of a zero
_LONGEST_RUN = 100  # samples at the largest value that are held back; a longer run is left to `stuck`


@dataclass(frozen=True)
class Clipped:
    """The samples that a gyroscope's full scale cut off.

    Attributes:
        axes: the axes that reached full scale, of "xyz".
        level: the largest full scale found, rad/s.
        count: number of samples cut off.
        first: stamp of the first of them, s.
        share: share of the recording that is left out for them.
    """

    axes: str
    level: float
    count: int
    first: float
    share: float

    @property
    def where(self) -> str:
        """The axes that were cut off, the rate, the number of samples and the first time, as text."""
        axes = f"axis {self.axes}" if len(self.axes) == 1 else f"axes {', '.join(self.axes)}"
        return (
            f"angular_rate: {axes} of the gyroscope cut off at {self.level:.3g} rad/s in {self.count} samples, "
            f"first at {self.first:.1f} s ({self.share:.1%} of the recording)"
        )

    @property
    def too_often(self) -> bool:
        """Whether too little of the recording is left for a calibration."""
        return self.share > MOST

    @property
    def sentence(self) -> str:
        """The message: `where`, the limit and the remedy."""
        return (
            f"{self.where}, and at most {MOST:.0%} can be left out: raise the gyroscope's full scale, turn more "
            "slowly, or choose an interval without it (start=, end=)"
        )


class CutOff:
    """Find the samples of a gyroscope that its full scale cut off; a `gate.Detector`.

    A turn that levels off repeats its largest value only where the rate changes by a step of the sensor or less; a
    full scale repeats it however steeply the rate rises and falls. Noise of a few steps also repeats it, but spreads
    over all values near the largest.

    Attributes:
        spans: (m, 2) s, intervals that a batch leaves out: each sample that was cut off and the hole after it.
    """

    def __init__(self) -> None:
        self.pending = np.inf
        self.spans = np.empty((0, 2))
        self._sides = tuple(LargestValue() for _ in range(6))  # x, y, z and −x, −y, −z
        self._step = np.inf  # rad/s, smallest change of any axis
        self._seen, self._last = 0, np.full(3, np.nan)
        self._stamps = np.empty(0)  # s, the first ones
        self._run, self._run_since = 0, np.nan  # samples in a row at a largest value, and since when
        self._rejected = np.empty((0, 2))  # like `spans`, restricted to samples that could still be held back
        self._count, self._first, self._latest = 0, np.nan, -np.inf

    def observe(self, block: Samples) -> None:
        """Take the next samples."""
        time, value = block
        n = len(time)
        if not n:
            return
        self._stamps = np.append(self._stamps, time[: _STAMPS - len(self._stamps)])
        change = np.abs(np.diff(value, axis=0, prepend=self._last[None]))
        moved = np.asarray((change > 0).any(axis=1))
        smallest = np.where(change > ROUNDING, change, np.inf).min(axis=1)
        step = np.minimum(np.minimum.accumulate(smallest), self._step)
        high, low = value.max(axis=0).tolist(), value.min(axis=0).tolist()
        far = [
            side.is_far(most, self._step)
            for side, most in zip(self._sides, [*high, *(-v for v in low)], strict=True)
        ]
        if all(far):
            repeats = (change == 0).sum(axis=0)
            for side, count in zip(self._sides, [*repeats, *repeats], strict=True):
                side.pass_by(n, int(count))
            self._run, self.pending = 0, np.inf
        else:
            self._examine(time, value, change, moved, step)
        self._seen, self._last, self._step = self._seen + n, value[-1].copy(), float(step[-1])
        self._latest = float(time[-1])

    def _examine(self, time: Array, value: Array, change: Array, moved: np.ndarray, step: Array) -> None:
        """Take samples of which some are near the largest value of their side."""
        n = len(time)
        allowed = self._seen + np.arange(n) >= _STAMPS
        at, continued, known = (np.zeros(n, dtype=bool) for _ in range(3))
        stamps, decisive = [np.empty(0)], set()
        for side, x, by in zip(
            self._sides, np.hstack([value, -value]).T, np.hstack([change, change]).T, strict=True
        ):
            part = side.observe(time, x, by, moved, step, self._step, allowed)
            if part is not None:
                at |= part.at
                continued |= part.continued
                known |= part.at & part.known
                stamps.append(part.stamps)
                decisive |= part.decisive
        self._find(time, np.unique(np.concatenate(stamps)), at, continued, known, decisive)

    def _find(
        self,
        time: Array,
        stamps: Array,
        at: np.ndarray,
        continued: np.ndarray,
        known: np.ndarray,
        decisive: set[int],
    ) -> None:
        """Record the samples cut off at `stamps`, and which of them can still be held back from an estimator."""
        place = np.arange(len(time))
        begun = np.maximum.accumulate(np.where(at & ~continued, place, -1))
        run = np.where(at, np.where(begun >= 0, place - begun + 1, self._run + place + 1), 0)
        since = np.where(begun >= 0, time[begun], self._run_since)
        self._rejected = self._rejected[self._rejected[:, 1] >= min(self.pending, time[0])]
        if len(stamps):
            hole = max(_HOLE * float(np.median(np.diff(self._stamps))), _HOLE_DURATION)
            self._count += len(stamps)
            self._first = float(np.fmin(self._first, stamps[0]))
            self.spans = _merged(np.vstack([self.spans, np.column_stack([stamps, stamps + hole])]))
            rejected = [np.column_stack([time[known], time[known] + hole])]
            for row in sorted(decisive):  # together with the run that was held back until then
                last = row if at[row] else row - 1
                length, start = (run[last], since[last]) if last >= 0 else (self._run, self._run_since)
                if length - int(at[row]) < _LONGEST_RUN:
                    rejected.append(np.array([[start, (time[last] if last >= 0 else time[0]) + hole]]))
            self._rejected = _merged(np.vstack([self._rejected, *rejected]))
        self._run, self._run_since = int(run[-1]), float(since[-1])
        until = self._rejected[-1, 1] if len(self._rejected) else -np.inf
        undecided = at[-1] and self._run < _LONGEST_RUN and time[-1] > until
        self.pending = self._run_since if undecided else np.inf

    def rejects(self, time: Array) -> np.ndarray:
        """Return (n,) bool: the samples in a hole that began while they could be held back."""
        return inside(self._rejected, time)

    def finding(self, share: float) -> Clipped | None:
        """Return the samples cut off so far, or None; `share` is the share of the recording left out for them."""
        levels = [side.full_scale for side in self._sides]
        if np.isnan(levels).all():
            return None
        axes = "".join(
            axis for axis, *of in zip("xyz", levels[:3], levels[3:], strict=True) if not np.isnan(of).all()
        )
        return Clipped(axes, float(np.nanmax(levels)), self._count, self._first, share)

    @property
    def now(self) -> bool:
        """Whether the last sample is in a hole."""
        return len(self._rejected) > 0 and bool(self._latest <= self._rejected[-1, 1])

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        state = {
            "numbers": np.array([self.pending, self._step, self._run_since, self._first, self._latest]),
            "counts": np.array([self._seen, self._run, self._count]),
            "last": self._last,
            "stamps": self._stamps,
            "spans": self.spans,
            "rejected": self._rejected,
        }
        return state | {f"{i}/{name}": v for i, side in enumerate(self._sides) for name, v in side.state().items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        numbers = (float(v) for v in state["numbers"])
        self.pending, self._step, self._run_since, self._first, self._latest = numbers
        self._seen, self._run, self._count = (int(v) for v in state["counts"])
        self._last, self._stamps = state["last"], state["stamps"]
        self.spans, self._rejected = state["spans"], state["rejected"]
        for i, side in enumerate(self._sides):
            side.restore({k.removeprefix(f"{i}/"): v for k, v in state.items() if k.startswith(f"{i}/")})


def inside(spans: Array, time: Array) -> np.ndarray:
    """Return (n,) bool: which times are inside one of the ascending `spans` (m, 2) s, ends included."""
    if not len(spans):
        return np.zeros(len(time), dtype=bool)
    at = np.searchsorted(spans[:, 0], time, side="right") - 1
    return np.asarray((at >= 0) & (time <= spans[at, 1]))


def _merged(spans: Array) -> Array:
    """Return the spans (m, 2) in ascending order, with overlaps merged."""
    if not len(spans):
        return spans
    spans = spans[np.argsort(spans[:, 0], kind="stable")]
    end = np.maximum.accumulate(spans[:, 1])
    first = np.concatenate([[True], spans[1:, 0] > end[:-1]])
    last = np.append(np.flatnonzero(first)[1:] - 1, len(spans) - 1)
    return np.column_stack([spans[first, 0], end[last]])
