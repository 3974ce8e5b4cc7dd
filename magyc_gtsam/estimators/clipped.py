"""Turns faster than the gyroscope's full scale: nobody knows how far the instrument turned meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.estimators.stuck import resolution
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording

_LEAST = 3  # samples at exactly the largest value, of which some follow each other
_STEEP = 3.0  # steps of the sensor between the largest value and a neighbour: no turn levels off so
_EVEN = 0.9  # share of repeats from which the whole recording is at even rates: a simulation
_HOLE = 12  # median steps, and
_HOLE_DURATION = 0.6  # s, of the hole that is made of it: one that counts (`Recording.gaps`)
_MOST = 0.5  # share of the recording


@dataclass(frozen=True)
class Clipped:
    """What a gyroscope's full scale cut off.

    Attributes:
        axes: of x, y, z, that reached it.
        level: rad/s, the largest of them.
        times: (n,) s of the samples.
        share: of the recording's duration that is left out for it.
    """

    axes: str
    level: float
    times: Array
    share: float

    @property
    def where(self) -> str:
        """Which axes, at which rate, when first."""
        which = f"axis {self.axes}" if len(self.axes) == 1 else f"axes {', '.join(self.axes)}"
        return (
            f"angular_rate: {which} of the gyroscope cut off at {self.level:.3g} rad/s in {len(self.times)} samples, "
            f"first at {self.times[0]:.1f} s ({self.share:.1%} of the recording)"
        )


def find_clipped(recording: Recording) -> Clipped | None:
    """Where an axis of the gyroscope stays at its largest value as no turn does; None where none does.

    A turn that levels off repeats its largest value by a step or so of the sensor; a full scale repeats it however
    steep the way there and back.
    """
    if recording.angular_rate is None:
        return None
    time, rate = recording.gyroscope
    step = resolution(rate)
    axes, rows = "", np.zeros(len(time), dtype=bool)
    for name, column in zip("xyz", rate.T, strict=True):
        for side in (column, -column):
            top = side == side.max()
            inside = top[1:] & top[:-1]
            fall = np.abs(np.diff(side))[top[1:] != top[:-1]]
            if not _LEAST <= top.sum() < len(top) or not inside.any() or np.median(fall) < _STEEP * step:
                continue
            if (np.diff(side[~top]) == 0).mean() < _EVEN:
                rows |= top
                axes += name if name not in axes else ""
    if not axes:
        return None
    level = float(np.abs(rate[rows]).max())
    return Clipped(axes, level, time[rows], float(1 - _kept(recording, time[rows]).mean()))


def without_clipped(recording: Recording, clipped: Clipped | None) -> Recording:
    """With a hole wherever the gyroscope was cut off: a method takes up again after it, and learns nothing across.

    Raises:
        MagycError: it was cut off too often.
    """
    if clipped is None:
        return recording
    if clipped.share > _MOST:
        raise MagycError(
            f"{clipped.where}: at most {_MOST:.0%} can be left out; raise the gyroscope's full scale, turn more "
            "slowly, or choose an interval without it (--start, --end)"
        )
    return recording.rows(_kept(recording, clipped.times))


def _kept(recording: Recording, times: Array) -> np.ndarray:
    """The rows that are not near any of the times."""
    half = 0.5 * max(_HOLE * float(np.median(np.diff(recording.gyroscope.time))), _HOLE_DURATION)
    at = np.searchsorted(times, recording.time)
    before = recording.time - times[np.maximum(at - 1, 0)]
    after = times[np.minimum(at, len(times) - 1)] - recording.time
    return (np.abs(before) > half) & (np.abs(after) > half)
