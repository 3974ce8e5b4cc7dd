"""A field beyond the magnetometer's full scale: an axis that reads its own extreme again and again, and no more.

The rows cannot be left out, as turns beyond the gyroscope's full scale are: that chooses rows by their noise. Without
them the hard iron was 1 to 17 sigmas off, and without 0.6 s around them, too, still 2 (in an hour 5) where an axis
stays near the level, as on a vehicle that stays level. So they stay in, for the gap's saturation to see, and no
calibration from them is trusted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.sensor_faults.noise import resolution

MOST = 0.005  # share of the samples; so few moved the hard iron by up to half a sigma in an hour
LEAST = 20  # samples at the extreme; a handful comes together by chance
_RUNS = 5  # separate ones: an axis that is stuck has one
_NOISY = (0.5, 1.0)  # steps of the sensor, of noise on the axis and on another: at rest it repeats without it
_OFTEN = (3.0, 1.5)  # times as often as a value next to it, at so much noise; a turn that levels off reaches 2.4
_STEEP = 1.5  # steps between the extreme and a neighbour, as on
_STEEPLY = 0.05  # of the passages with noise; on the edge between two values none is


@dataclass(frozen=True)
class ClippedField:
    """What the magnetometer's full scale cut off.

    Attributes:
        axes: of x, y, z, that reached it.
        levels: (lowest, highest) reading of each axis in T, or counts; NaN where nothing was cut off.
        shown: the largest reading that was cut off, in size, as shown: µT or counts with the unit.
        count: of the samples in which an axis was cut off; share: of all samples.
    """

    axes: str
    levels: tuple[tuple[float, float], ...] = field(repr=False, compare=False)
    shown: str
    count: int
    share: float

    @property
    def where(self) -> str:
        """Which axes, at which reading, how often."""
        which = f"axis {self.axes}" if len(self.axes) == 1 else f"axes {', '.join(self.axes)}"
        return (
            f"magnetic_field: {which} of the magnetometer cut off at {self.shown} in {self.count} samples "
            f"({self.share:.1%} of the recording)"
        )

    @property
    def too_often(self) -> bool:
        """Whether it harms a calibration."""
        return self.share > MOST

    @property
    def sentence(self) -> str:
        """`where`, the limit and the remedy."""
        return (
            f"{self.where}: at most {MOST:.1%} do no harm; choose a larger full scale, move what is magnetic away from "
            "the sensor, or take the calibration of `magyc-gtsam gap`, where that can model it"
        )


class FullScale:
    """Finds the levels at which a magnetometer's axes are cut off, and counts the samples there.

    Every so many samples the latest are looked at; a level that was found stays one until something is beyond it.

    Args:
        every, latest: samples; a batch gives the number of all it has.
    """

    def __init__(self, every: int = 300, latest: int = 6000) -> None:
        self._every, self._latest = every, latest
        self._rows, self._new = np.empty((0, 3)), np.empty((0, 3))
        self._levels = np.full((3, 2), np.nan)
        self._taken = self._count = 0  # samples; and of them, those at a level

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
                self._look()

    def _look(self) -> None:
        rows = self._rows
        beyond = np.stack([rows.min(axis=0) < self._levels[:, 0], rows.max(axis=0) > self._levels[:, 1]], axis=1)
        levels = np.where(beyond, np.nan, self._levels)
        levels = np.where(np.isnan(levels), clipped_levels(rows), levels)
        if np.array_equal(levels, self._levels, equal_nan=True):
            return
        # Of what is no longer kept only the count is known, which holds while no level was given up.
        known = 0 if beyond.any() else self._count - int(at_level(rows, self._levels).sum())
        self._count, self._levels = known + int(at_level(rows, levels).sum()), levels

    def finding(self, shown: float = 1e6, unit: str = "µT") -> ClippedField | None:
        """What was cut off so far, if it is enough to do harm; a field is shown times `shown`, with its unit."""
        known = np.isfinite(self._levels)
        if not known.any() or not self._count > MOST * self._taken:
            return None
        axes = "".join(axis for axis, sides in zip("xyz", known, strict=True) if sides.any())
        level = float(np.abs(self._levels[known]).max()) * shown
        each = tuple((float(low), float(high)) for low, high in self._levels)
        return ClippedField(axes, each, f"{level:.4g} {unit}", self._count, self._count / self._taken)

    def state(self) -> Mapping[str, Array]:
        """For `restore`."""
        counts = np.array([self._taken, self._count])
        return {"rows": self._rows, "new": self._new, "levels": self._levels, "counts": counts}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._rows, self._new, self._levels = state["rows"], state["new"], state["levels"]
        self._taken, self._count = (int(v) for v in state["counts"])


def at_level(value: Array, levels: Array) -> np.ndarray:
    """(n,) bool, which samples (n, 3) are at a level (3, 2) of any axis."""
    return np.asarray((value[:, :, None] == levels).any(axis=(1, 2)))


def clipped_levels(value: Array) -> Array:
    """(3, 2) lowest and highest reading of each axis of samples (n, 3) where it was cut off; NaN where it was not."""
    levels = np.full((3, 2), np.nan)
    step = resolution(value)
    for axis, column in enumerate(value.T):
        others = np.delete(value, axis, axis=1)
        for side, sign in enumerate((-1.0, 1.0)):
            if _cut_off(sign * column, others, step):
                levels[axis, side] = sign * (sign * column).max()
    return levels


def _cut_off(side: Array, others: Array, step: float) -> bool:
    """Whether a full scale cut off what was larger than the largest value of an axis.

    A full scale gathers there what noise and turns spread over all values beyond.
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
    often = (top.sum() - runs.max()) / max(beside, 1)  # without the longest: an axis that is stuck at its extreme
    noise = min(_noise(others, top, step), _noise(side[:, None], ~top, step))
    return any(noise >= least and often >= times for least, times in zip(_NOISY, _OFTEN, strict=True))


def _noise(value: Array, rows: np.ndarray, step: float) -> float:
    """Steps of white noise per sample about some rows, on the noisiest of the axes (n, axes), before it was rounded."""
    second = np.diff(value, 2, axis=0)[rows[1:-1]] / step
    if not len(second):
        return 0.0
    # 6 is the gain of second differences, 1/12 what rounding adds.
    variance = (second**2).mean(axis=0) / 6 - 1 / 12
    return float(np.sqrt(max(variance.max(), 0.0)))
