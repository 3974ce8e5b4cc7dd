"""Detect a bit of a sensor's converter that always reads the same: half of its readings never appear.

The readings of an axis are whole numbers of its step. If the bit worth B is stuck, they lie in stretches of B that
follow each other at 2 B, with nothing between. A motion with noise fills a range of readings without holes, whatever
the offset and the scale that a driver applies. Such readings are off by B for half of the field's values: by 0.6 µT the
hard iron was off by 6 to 30 sigmas. A bit that is wrong in some of the readings only is found in `failing_bit`. No
calibration from either is trusted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.sensor_faults.failing_bit import failing_bit


@dataclass(frozen=True)
class BitRules:
    """Limits between readings that a stuck bit leaves out and those that a motion does not reach.

    Attributes:
        first: samples at the beginning by which readings in steps are recognised.
        whole: share of a step by which a reading may be off a whole number of steps; rounding by float32 takes 1e-4.
        rare: share of the readings at either end that is not looked at, where few samples leave holes.
        exceptions: largest share of the readings where there should be none.
        filled: least share of the values between the holes that were read: 0.91 to 1 with a stuck bit. Where an
            instrument rests in a few positions the values between them are not filled.
        holes: fewest holes. 110 clean logs in steps of 0.1 to 1.5 µT and 30 real recordings have none.
        steps: most steps of a range, those of 18 bits.
    """

    first: int = 512
    whole: float = 0.05
    rare: float = 0.1
    exceptions: float = 0.01
    filled: float = 0.75
    holes: int = 3
    steps: int = 1 << 18


RULES = BitRules()


@dataclass(frozen=True)
class StuckBit:
    """A bit that is stuck, or wrong in some of the readings.

    Attributes:
        axis: of "xyz".
        shown: what the bit is worth, as text with its unit (µT, mrad/s or counts).
        always: whether it is stuck.
        sensor: "magnetic_field" or "angular_rate".
    """

    axis: str
    shown: str
    always: bool = True
    sensor: str = "magnetic_field"
    too_often = True  # however few the samples are

    @property
    def state(self) -> str:
        """What is wrong with it, as text."""
        return "is stuck" if self.always else "is wrong in some of the readings"

    @property
    def where(self) -> str:
        """The axis and the bit, as text."""
        return f"{self.sensor}: the bit worth {self.shown} of {self.place} {self.state}"

    @property
    def place(self) -> str:
        """The axis of the sensor, as text."""
        return f"axis {self.axis} of the {'magnetometer' if self.sensor == 'magnetic_field' else 'gyroscope'}"

    @property
    def sentence(self) -> str:
        """The message: `where`, the reason and the remedy."""
        harm = "half of its values are never read" if self.always else "their mean is off by an unknown amount"
        return f"{self.where}, so that {harm}: check the driver, or replace the sensor"


class Bit(NamedTuple):
    """The place of a bit: the axis, 0 to 2, what it is worth, T, rad/s or counts, and whether it is always stuck."""

    axis: int
    worth: float
    always: bool


class StuckBits:
    """Look for bits that are stuck or fail in a sensor's samples as they arrive.

    After every `every` samples the last `latest` are examined. What was found remains, because a range of readings
    that does not show it does not exclude it.

    Args:
        every, latest: numbers of samples; a batch passes one beyond that of all its samples, and concludes itself.
        sensor: "magnetic_field" or "angular_rate", for the message.
    """

    def __init__(self, every: int = 300, latest: int = 6000, sensor: str = "magnetic_field") -> None:
        self._every, self._latest, self._sensor = every, latest, sensor
        self._rows, self._new = np.empty((0, 3)), np.empty((0, 3))
        self._found: Bit | None = None

    def observe(self, value: Array) -> None:
        """Take the next samples (n, 3) T, rad/s or counts."""
        while len(value):
            now, value = np.split(value, [self._every - len(self._new)])
            self._new = np.vstack([self._new, now])
            if len(self._new) == self._every:
                self.conclude()

    def conclude(self) -> None:
        """Examine the samples so far, as at the end of a batch."""
        if not len(self._new):
            return
        self._rows, self._new = np.vstack([self._rows, self._new])[-self._latest :], self._new[:0]
        self._found = self._found or stuck_bit(self._rows)

    def finding(self, shown: float = 1e6, unit: str = "µT") -> StuckBit | None:
        """Return the bit that was found, or None; `shown` scales a reading to `unit`."""
        if self._found is None:
            return None
        worth = f"{self._found.worth * shown:.3g} {unit}"
        return StuckBit("xyz"[self._found.axis], worth, self._found.always, self._sensor)

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        found = np.full(3, np.nan) if self._found is None else np.array(self._found)
        return {"rows": self._rows, "new": self._new, "found": found}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._rows, self._new = state["rows"], state["new"]
        axis, worth, always = (float(v) for v in state["found"])
        self._found = None if np.isnan(axis) else Bit(int(axis), worth, bool(always))


def stuck_bit(value: Array, rules: BitRules = RULES) -> Bit | None:
    """Return the first bit of samples (n, 3) that is stuck, or wrong in some of them; None if none is told."""
    if len(value) < 2:
        return None
    for axis, step in enumerate(_steps(np.ascontiguousarray(value[: rules.first].T), rules)):
        if not step:
            continue
        steps = np.rint((value[:, axis] - value[:, axis].min()) / step)
        if steps.max() > rules.steps:
            continue
        always = _bit(steps.astype(np.int64), rules)
        if worth := always or failing_bit(steps):
            return Bit(axis, worth * step, bool(always))
    return None


def _steps(reading: Array, rules: BitRules) -> list[float]:
    """Return for each axis the step whose multiples, apart from an offset, all readings (3, n) are; 0 if there is none.

    Equal readings may differ by rounding.
    """
    ordered = np.sort(reading)
    change = ordered[:, 1:] - ordered[:, :-1]
    mean = (ordered[:, -1:] - ordered[:, :1]) / change.shape[1]
    step = np.where(change > rules.whole * mean, change, np.inf).min(axis=1)  # infinite if there is no change
    steps = (reading - reading[:, :1]) / step[:, None]
    whole = np.abs(steps - np.rint(steps)).max(axis=1) < rules.whole
    found: list[float] = np.where(whole & np.isfinite(step), step, 0.0).tolist()
    return found


def _bit(steps: np.ndarray, rules: BitRules) -> int:
    """Return how many steps the bit is worth that is stuck in readings (n,), whole steps; 0 if there is none."""
    count = np.bincount(steps)
    below = np.cumsum(count)
    first, last = np.searchsorted(below, [rules.rare * below[-1], (1 - rules.rare) * below[-1]])
    count = count[first : last + 1]
    if 4 * np.count_nonzero(count) > 3 * len(count):  # at least half of them are empty, less a hole at the end
        return 0
    worth = 2  # of the lowest bit the step would be twice as large
    while 2 * worth * rules.holes <= len(count):
        if _leaves_out(count, worth, rules):
            return worth
        worth *= 2
    return 0


def _leaves_out(count: np.ndarray, worth: int, rules: BitRules) -> bool:
    """Return whether the numbers of samples (n,) at each value are none in every second stretch of `worth` values."""
    periods = count[: len(count) // (2 * worth) * 2 * worth].reshape(-1, 2 * worth)
    folded = periods.sum(axis=0)
    within = np.cumsum(np.concatenate([[0], folded, folded]))
    inside = within[worth : 3 * worth] - within[: 2 * worth]  # samples in the stretch that begins at each place
    place = int(np.argmin(inside))
    if inside[place] > rules.exceptions * folded.sum():
        return False
    between = (np.arange(worth) + place + worth) % (2 * worth)
    return bool(np.count_nonzero(periods[:, between]) > rules.filled * periods.size / 2)
