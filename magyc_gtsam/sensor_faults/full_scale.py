"""Detect a field beyond the magnetometer's full scale: an axis that reads its own extreme value repeatedly.

Unlike turns beyond the gyroscope's full scale, these rows cannot be left out, because that would select rows by their
noise. Without them the hard iron was off by 1 to 17 sigmas; without 0.6 s around them it was still off by 2 sigmas
(5 in an hour) if an axis stays near the level, as on a vehicle that does not tilt. The rows are therefore kept, so that
the gap's saturation term can model them, and no calibration from them is trusted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.sensor_faults.noise import resolution

MOST = 0.005  # harmless share of the samples: it moved the hard iron by up to half a sigma in an hour
LEAST = 20  # samples at the extreme; fewer occur by chance
_RUNS = 5  # separate runs at the extreme; a stuck axis has one
_NOISY = (0.5, 1.0)  # noise in steps of the sensor, on this axis and another; less noise repeats values at rest
_OFTEN = (3.0, 1.5)  # ratio to the count of the next value, for each noise; a turn that levels off reaches 2.4
_STEEP = 1.5  # steps between the extreme and its neighbour in a steep passage
_STEEPLY = 0.05  # share of the passages that must be steep; noise between two values gives none


@dataclass(frozen=True)
class ClippedField:
    """The samples that the magnetometer's full scale cut off.

    Attributes:
        axes: the axes that reached full scale, of "xyz".
        levels: (lowest, highest) reading of each axis, T or counts; NaN where nothing was cut off.
        shown: the largest absolute reading that was cut off, as text with its unit (µT or counts).
        count: number of samples in which an axis was cut off.
        share: their share of all samples.
    """

    axes: str
    levels: tuple[tuple[float, float], ...] = field(repr=False, compare=False)
    shown: str
    count: int
    share: float

    @property
    def where(self) -> str:
        """The axes that were cut off, the reading and the number of samples, as text."""
        axes = f"axis {self.axes}" if len(self.axes) == 1 else f"axes {', '.join(self.axes)}"
        return (
            f"magnetic_field: {axes} of the magnetometer cut off at {self.shown} in {self.count} samples "
            f"({self.share:.1%} of the recording)"
        )

    @property
    def too_often(self) -> bool:
        """Whether the samples are enough to harm a calibration."""
        return self.share > MOST

    @property
    def sentence(self) -> str:
        """The message: `where`, the limit and the remedy."""
        return (
            f"{self.where}, and at most {MOST:.1%} do no harm: choose a larger full scale, move what is magnetic away "
            "from the sensor, or take the calibration of `mg.find_gap`, where that can model it"
        )


class FullScale:
    """Find the levels at which a magnetometer's axes are cut off, and count the samples there.

    After every `every` samples the last `latest` are examined. A level remains valid until a sample exceeds it.

    Args:
        every, latest: numbers of samples; a batch passes the number of all its samples.
    """

    def __init__(self, every: int = 300, latest: int = 6000) -> None:
        self._every, self._latest = every, latest
        self._rows, self._new = np.empty((0, 3)), np.empty((0, 3))
        self._levels = np.full((3, 2), np.nan)
        self._taken = self._count = 0  # samples, and those of them at a level

    def observe(self, value: Array) -> None:
        """Take the next samples (n, 3) T or counts."""
        while len(value):
            now, value = np.split(value, [self._every - len(self._new)])
            self._new = np.vstack([self._new, now])
            self._taken += len(now)
            self._count += int(at_level(now, self._levels).sum())
            if len(self._new) == self._every:
                self._rows = np.vstack([self._rows, self._new])[-self._latest :]
                self._new = self._new[:0]
                self._examine()

    def conclude(self) -> None:
        """Examine the samples of a batch that ends before the number given, since some were left out before."""
        if len(self._new):
            self._rows, self._new = np.vstack([self._rows, self._new])[-self._latest :], self._new[:0]
            self._examine()

    def _examine(self) -> None:
        rows = self._rows
        beyond = np.stack([rows.min(axis=0) < self._levels[:, 0], rows.max(axis=0) > self._levels[:, 1]], axis=1)
        levels = np.where(beyond, np.nan, self._levels)
        levels = np.where(np.isnan(levels), clipped_levels(rows), levels)
        if np.array_equal(levels, self._levels, equal_nan=True):
            return
        # For samples that are no longer kept only their count is known, which is valid unless a level was exceeded.
        known = 0 if beyond.any() else self._count - int(at_level(rows, self._levels).sum())
        self._count, self._levels = known + int(at_level(rows, levels).sum()), levels

    def finding(self, shown: float = 1e6, unit: str = "µT") -> ClippedField | None:
        """Return the samples cut off so far, or None if too few to do harm; `shown` scales a field to `unit`."""
        known = np.isfinite(self._levels)
        if not known.any() or not self._count > MOST * self._taken:
            return None
        axes = "".join(axis for axis, sides in zip("xyz", known, strict=True) if sides.any())
        level = float(np.abs(self._levels[known]).max()) * shown
        each = tuple((float(low), float(high)) for low, high in self._levels)
        return ClippedField(axes, each, f"{level:.4g} {unit}", self._count, self._count / self._taken)

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        counts = np.array([self._taken, self._count])
        return {"rows": self._rows, "new": self._new, "levels": self._levels, "counts": counts}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._rows, self._new, self._levels = state["rows"], state["new"], state["levels"]
        self._taken, self._count = (int(v) for v in state["counts"])


def at_level(value: Array, levels: Array) -> np.ndarray:
    """Return (n,) bool: which samples (n, 3) are at a level (3, 2) of any axis."""
    return np.asarray((value[:, :, None] == levels).any(axis=(1, 2)))


def clipped_levels(value: Array) -> Array:
    """Return the levels (3, 2), lowest and highest, at which samples (n, 3) were cut off; NaN if they were not."""
    levels = np.full((3, 2), np.nan)
    step = resolution(value)
    for axis, column in enumerate(value.T):
        others = np.delete(value, axis, axis=1)
        for side, sign in enumerate((-1.0, 1.0)):
            if _cut_off(sign * column, others, step):
                levels[axis, side] = sign * (sign * column).max()
    return levels


def _cut_off(side: Array, others: Array, step: float) -> bool:
    """Return whether a full scale cut off the values beyond the largest value of an axis.

    A full scale maps all samples beyond it to one value, which noise and motion would otherwise spread.
    """
    away = side.max() - side
    top = away == 0
    if top.sum() <= max(LEAST, MOST * len(top)):
        return False
    edges = np.flatnonzero(top[1:] != top[:-1])
    bounds = np.concatenate([[0], edges + 1, [len(top)]])
    runs = np.diff(bounds)[top[bounds[:-1]]]
    if len(runs) < _RUNS:
        return False
    steep = int((np.abs(np.diff(side))[edges] > _STEEP * step).sum())
    if steep < max(_RUNS, _STEEPLY * len(edges)):
        return False
    beside = np.histogram(away, np.array([0.5, 1.5, 2.5]) * step)[0].max()
    often = (top.sum() - runs.max()) / max(beside, 1)  # without the longest run, which may be a stuck axis
    noise = min(_noise(others, top, step), _noise(side[:, None], ~top, step))
    return any(noise >= least and often >= times for least, times in zip(_NOISY, _OFTEN, strict=True))


def _noise(value: Array, rows: np.ndarray, step: float) -> float:
    """Return the white noise per sample in steps before rounding, near `rows`, on the noisiest axis of (n, axes)."""
    second = np.diff(value, 2, axis=0)[rows[1:-1]] / step
    if not len(second):
        return 0.0
    # 6 is the gain of second differences; rounding adds 1/12.
    variance = (second**2).mean(axis=0) / 6 - 1 / 12
    return float(np.sqrt(max(variance.max(), 0.0)))
