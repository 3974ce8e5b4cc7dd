"""Turns faster than the gyroscope's full scale: nobody knows how far the instrument turned meanwhile."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import betainc

from magyc_gtsam.estimators.stuck import resolution
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording

BAND = 30  # steps of the sensor below the largest value, in which the values near it are counted
MOST = 0.5  # share of the recording
_LEAST = 5  # samples at exactly the largest value, of which some follow each other
_STEEP = 3.0  # steps of the sensor between the largest value and a neighbour: no turn levels off so
_CHANCE = 1e-7  # that so many fall on the largest value where all in the band are as likely
_EVEN = 0.9  # share of repeats from which the whole recording is at even rates: a simulation
_HOLE = 12  # median steps, and
_HOLE_DURATION = 0.6  # s, of the hole that is made of it: one that counts (`Recording.gaps`)


@dataclass(frozen=True)
class Clipped:
    """What a gyroscope's full scale cut off.

    Attributes:
        axes: of x, y, z, that reached it.
        level: rad/s, the largest of them.
        count: of the samples; first: s, stamp of the first.
        share: of the recording that is left out for it.
    """

    axes: str
    level: float
    count: int
    first: float
    share: float

    @property
    def where(self) -> str:
        """Which axes, at which rate, when first."""
        which = f"axis {self.axes}" if len(self.axes) == 1 else f"axes {', '.join(self.axes)}"
        return (
            f"angular_rate: {which} of the gyroscope cut off at {self.level:.3g} rad/s in {self.count} samples, "
            f"first at {self.first:.1f} s ({self.share:.1%} of the recording)"
        )

    @property
    def too_often(self) -> bool:
        """Whether what is left makes no calibration."""
        return self.share > MOST

    @property
    def sentence(self) -> str:
        """`where`, the limit and the remedy."""
        return (
            f"{self.where}: at most {MOST:.0%} can be left out; raise the gyroscope's full scale, turn more "
            "slowly, or choose an interval without it (--start, --end)"
        )


@dataclass(frozen=True, eq=False)
class ClippedRows(Clipped):
    """The same with the stamps (n,) s of the samples."""

    times: Array = field(repr=False)


@dataclass(frozen=True)
class Peak:
    """How the samples of an axis, to one side, come to their largest value.

    Attributes:
        count: samples exactly at it; pairs: of them that follow each other while another axis moved.
        edges: passages between it and a neighbour; steep: of those, by `steep` or more.
        near: samples less than `BAND` steps below it.
        others: pairs of neighbours of which neither is at it; repeats: of those, equal ones.
    """

    count: int
    pairs: int
    edges: int
    steep: int
    near: int
    others: int
    repeats: int

    @property
    def cut_off(self) -> bool:
        """Whether it is a full scale that cut off what was larger.

        A turn that levels off repeats its largest value by a step or so of the sensor; a full scale repeats it however
        steep the way there and back. Noise of some steps does so, too, but spreads over all values near the largest.
        """
        if self.count < _LEAST or not self.pairs or not self.edges or 2 * self.steep < self.edges:
            return False
        if self.others and self.repeats >= _EVEN * self.others:
            return False
        return bool(betainc(self.count, self.near + 1, 1 / (BAND + 1)) < _CHANCE)  # of a binomial distribution


def steep(step: Array | float) -> Array | float:
    """rad/s between neighbours that no turn which levels off passes, for a sensor of such steps."""
    return _STEEP * step


def hole(step: float) -> float:
    """s that are left out for one sample, from the median step of the stamps."""
    return max(_HOLE * step, _HOLE_DURATION)


def find_clipped(recording: Recording) -> ClippedRows | None:
    """Where an axis of the gyroscope stays at its largest value as no turn does; None where none does."""
    if recording.angular_rate is None:
        return None
    time, rate = recording.gyroscope
    step, moved = resolution(rate), (rate[1:] != rate[:-1]).any(axis=1)
    axes, rows = "", np.zeros(len(time), dtype=bool)
    for name, column in zip("xyz", rate.T, strict=True):
        for side in (column, -column):
            top = side == side.max()
            if top.sum() >= _LEAST and _peak(side, top, moved, step).cut_off:
                rows |= top
                axes += name if name not in axes else ""
    if not axes:
        return None
    level = float(np.abs(rate[rows]).max())
    times = time[rows]
    share = float(1 - _kept(recording, times).mean())
    return ClippedRows(axes, level, len(times), float(times[0]), share, times)


def _peak(side: Array, top: np.ndarray, moved: np.ndarray, step: float) -> Peak:
    change = np.abs(np.diff(side))
    edge, away = top[1:] != top[:-1], ~(top[1:] | top[:-1])
    return Peak(
        count=int(top.sum()),
        pairs=int((top[1:] & top[:-1] & moved).sum()),
        edges=int(edge.sum()),
        steep=int((change[edge] >= steep(step)).sum()),
        near=int((side > side.max() - BAND * step).sum() - top.sum()),
        others=int(away.sum()),
        repeats=int((change[away] == 0).sum()),
    )


def without_clipped(recording: Recording, clipped: ClippedRows | None) -> Recording:
    """With a hole wherever the gyroscope was cut off: a method takes up again after it, and learns nothing across.

    Raises:
        MagycError: it was cut off too often.
    """
    if clipped is None:
        return recording
    if clipped.too_often:
        raise MagycError(clipped.sentence)
    return recording.rows(_kept(recording, clipped.times))


def _kept(recording: Recording, times: Array) -> np.ndarray:
    """The rows that are not near any of the times."""
    half = 0.5 * hole(float(np.median(np.diff(recording.gyroscope.time))))
    at = np.searchsorted(times, recording.time)
    before = recording.time - times[np.maximum(at - 1, 0)]
    after = times[np.minimum(at, len(times) - 1)] - recording.time
    return (np.abs(before) > half) & (np.abs(after) > half)
