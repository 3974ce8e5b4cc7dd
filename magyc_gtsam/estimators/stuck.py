"""Axes that stand still where a working sensor cannot: a broken chip, a bus that froze, a column never filled in.

A value that repeats is no fault by itself: a vehicle at rest with a coarse sensor repeats for minutes, and a
simulation without noise turns about one axis only. An axis counts as stuck where its own sensor shows noise of
1.5 steps or more on another axis meanwhile; a gyroscope as a whole where the field turned meanwhile, unless it stands
at a rate and the magnetometer shows no noise either, as in a simulation of an even turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording, Samples

LEAST_SAMPLES = 100  # in a row; with noise of half a step a working axis repeats that often once in 10¹⁵
LEAST_DURATION = 2.0  # s
NOISY = 1.5  # steps of the sensor from which noise on one axis must show on another
_ALTERNATES = 0.55  # share of sign changes of second differences; 0.73 for white noise, near 0 for motion
_TURNED = 0.2  # sweep of the field over its median strength that no gyroscope at rest goes with
_MOST = 0.5  # share of the recording from which no calibration is tried
_SMALL = 0.005  # share up to which it harms no method


@dataclass(frozen=True)
class Stuck:
    """Axes of one sensor that stood still.

    Attributes:
        sensor: "magnetic_field" or "angular_rate".
        axes: of x, y, z.
        value: what the first of them stood at at first, as shown: µT, counts or mrad/s with the unit.
        stretches: (from, to) in s, the longest first.
        share: of the recording's duration.
    """

    sensor: str
    axes: str
    value: str
    stretches: tuple[tuple[float, float], ...]
    share: float

    @property
    def where(self) -> str:
        """Which axes stood still, where and by what evidence."""
        start, end = self.stretches[0]
        more = f" and {len(self.stretches) - 1} more times" if len(self.stretches) > 1 else ""
        name = {"magnetic_field": "magnetometer", "angular_rate": "gyroscope"}[self.sensor]
        which = f"axis {self.axes} of the {name} is" if len(self.axes) == 1 else f"axes {', '.join(self.axes)} are"
        turned = "the gyroscope turned" if self.sensor == "magnetic_field" else "the field turned"
        others = {1: "its other axes show noise", 2: "its other axis shows noise", 3: turned}
        return (
            f"{self.sensor}: {which} stuck at {self.value} from {start:.1f} to {end:.1f} s{more}, "
            f"{self.share:.0%} of the recording, while {others[len(self.axes)]}"
        )

    @property
    def sentence(self) -> str:
        """`where`, the limit and the remedy."""
        spare = ""
        if self.sensor == "angular_rate":
            spare = "; methods that need the magnetometer alone (--method autocal) do without it"
        return (
            f"{self.where} (at most {_MOST:.0%} can be left out): name another source ({self.sensor}=), choose an "
            f"interval without it (--start, --end), or have the sensor repaired{spare}"
        )


def find_stuck(
    recording: Recording,
    sensors: Sequence[str] = ("magnetic_field", "angular_rate"),
    clipped: Array | None = None,
) -> list[Stuck]:
    """The axes of the named sensors that stood still for more than an instant, the largest share first.

    Args:
        recording: what to look at.
        sensors: of "magnetic_field" and "angular_rate".
        clipped: (3, 2) T or counts, levels at which the magnetometer's axes are not stuck but cut off; NaN for none.
    """
    shown, unit = recording.field_shown
    found = []
    if "magnetic_field" in sensors:
        found += _of_sensor("magnetic_field", recording.magnetometer, recording, shown, unit, clipped)
    if "angular_rate" in sensors and recording.angular_rate is not None:
        found += _of_sensor("angular_rate", recording.gyroscope, recording, 1e3, "mrad/s")
    return sorted((s for s in found if s.share > _SMALL), key=lambda s: -s.share)


def without_stuck(recording: Recording, found: Sequence[Stuck]) -> Recording:
    """The rows in which nothing stood still: a hole is no harm to a method, a false axis is.

    Raises:
        MagycError: an axis stood still for half of the recording.
    """
    if not found:
        return recording
    if found[0].share > _MOST:
        raise MagycError(found[0].sentence)
    kept = np.ones(len(recording.time), dtype=bool)
    for start, end in (stretch for stuck in found for stretch in stuck.stretches):
        kept &= (recording.time < start) | (recording.time > end)
    return recording.rows(kept)


def _of_sensor(
    sensor: str, samples: Samples, recording: Recording, shown: float, unit: str, spared: Array | None = None
) -> list[Stuck]:
    time, value = samples
    runs = [_runs(time, column) for column in value.T]
    if spared is not None:
        runs = [
            [run for run in found if value[run[0], axis] not in spared[axis]] for axis, found in enumerate(runs)
        ]
    if not any(runs):
        return []
    step = resolution(value)
    whole = _common(time, runs) if sensor == "angular_rate" else []
    groups = {tuple(run for run in whole if _turned(recording, *run)): "xyz"}
    for axis, name in enumerate("xyz"):
        others = np.delete(value, axis, axis=1)
        own = tuple(run for run in runs[axis] if white_noise(others[slice(*run)]) >= NOISY * step)
        groups[own] = groups.get(own, "") + name
    result = []
    for stretches, axes in groups.items():
        if stretches:
            times = sorted(((float(time[i]), float(time[j - 1])) for i, j in stretches), key=lambda s: s[0] - s[1])
            share = sum(end - start for start, end in times) / recording.duration
            at = shown_value(value[stretches[0][0]] * shown, axes)
            result.append(Stuck(sensor, axes, f"{at} {unit}", tuple(times), share))
    return result


def shown_value(value: Array, axes: str) -> str:
    """The values (3,) of the named axes, in words."""
    return ", ".join(f"{value['xyz'.index(axis)]:.4g}" for axis in axes)


def _runs(time: Array, column: Array) -> list[tuple[int, int]]:
    """[first, past the last) of the stretches in which a column repeats exactly for long."""
    edges = np.concatenate([[0], np.flatnonzero(column[1:] != column[:-1]) + 1, [len(column)]])
    long = np.flatnonzero(np.diff(edges) >= LEAST_SAMPLES)
    pairs = [(int(edges[i]), int(edges[i + 1])) for i in long]
    return [(i, j) for i, j in pairs if time[j - 1] - time[i] >= LEAST_DURATION]


def _common(time: Array, runs: Sequence[Sequence[tuple[int, int]]]) -> list[tuple[int, int]]:
    """The stretches in which all three axes repeat."""
    found = [(max(i, k, m), min(j, n, p)) for i, j in runs[0] for k, n in runs[1] for m, p in runs[2]]
    return [(i, j) for i, j in found if j - i >= LEAST_SAMPLES and time[j - 1] - time[i] >= LEAST_DURATION]


def resolution(value: Array) -> float:
    """The smallest change of any axis between neighbours: the sensor's resolution, or less."""
    change = np.abs(np.diff(value, axis=0))
    return float(change[change > 0].min(initial=np.inf))


def white_noise(value: Array) -> float:
    """Largest deviation of white noise per sample on any of the axes; 0 where what changes is smooth."""
    levels = []
    for column in value.T:
        second = np.diff(column, 2)
        moved = np.sign(second[second != 0])
        alternates = float((moved[1:] != moved[:-1]).mean()) if len(moved) > LEAST_SAMPLES // 2 else 0.0
        if alternates < _ALTERNATES:
            levels.append(0.0)
            continue
        # The median passes over spikes and motion; 2.45 is the gain of second differences.
        levels.append(float(np.median(np.abs(second))) / (0.6745 * np.sqrt(6)))
    return max(levels)


def _turned(recording: Recording, first: int, past: int) -> bool:
    """Whether the field turned between two of the gyroscope's samples, and a working one had shown it."""
    gyroscope, rate = recording.gyroscope
    time, field = recording.magnetometer
    field = field[(time >= gyroscope[first]) & (time <= gyroscope[past - 1])]
    strength = float(np.median(np.linalg.norm(recording.magnetic_field, axis=1)))
    return field_turned(field, strength, rate[first])


def field_turned(field: Array, strength: float, rate: Array) -> bool:
    """Whether a field (n, 3) turned by more than a gyroscope would go with that stands at `rate` (3,)."""
    if len(field) < 3:
        return False
    low, high = np.percentile(field, (5, 95), axis=0)
    turned = float(np.linalg.norm(high - low)) > _TURNED * strength
    return turned and (not rate.any() or white_noise(field) > 0)
