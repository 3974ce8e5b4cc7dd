"""What a batch method may use of a recording: the rows in which neither sensor was at fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording
from magyc_gtsam.sensor_faults.cut_off import Clipped, inside
from magyc_gtsam.sensor_faults.faults import SensorFaults
from magyc_gtsam.sensor_faults.full_scale import ClippedField
from magyc_gtsam.sensor_faults.screen import may_be_faulty
from magyc_gtsam.sensor_faults.stuck import MOST, SMALL, Stuck
from magyc_gtsam.sensor_faults.zeros import NoValues


@dataclass(frozen=True, eq=False)
class Usable:
    """What is left of a recording.

    Attributes:
        recording: the rows in which nothing was wrong that could be left out.
        stuck: axes that stood still for more than an instant; the largest share first.
        zeros: samples of the magnetometer that are placeholders (zero on all axes); None where there are none.
        cut_off: what the gyroscope's full scale cut off; None where nothing was.
        clipped: what the magnetometer's full scale cut off, which is still in the rows; None where nothing was.
    """

    recording: Recording
    stuck: tuple[Stuck, ...]
    zeros: NoValues | None
    cut_off: Clipped | None
    clipped: ClippedField | None

    @property
    def left_out(self) -> list[str]:
        """What was left out, in words."""
        return [fault.where for fault in (*self.stuck, self.zeros, self.cut_off) if fault is not None]


def without_faults(recording: Recording, sensors: Sequence[str] = ("magnetic_field", "angular_rate")) -> Usable:
    """The rows in which nothing was wrong with the named sensors: a hole is no harm to a method, a false axis is.

    Raises:
        MagycError: an axis stood still for half of the recording, or too many turns were cut off.
    """
    if not may_be_faulty(recording, sensors):
        return Usable(recording, (), None, None, None)
    faults, time = SensorFaults.of(recording, sensors), recording.time
    hole = inside(faults.cut_off.spans, time)
    cut_off = faults.cut_off.finding(float(hole.mean()))
    if cut_off is not None and cut_off.too_often:
        raise MagycError(cut_off.sentence)
    stuck = tuple(s for s in faults.stuck(recording.duration) if s.share > SMALL)
    false = [
        found for found in stuck if (found.sensor, found.axes) != ("magnetic_field", "xyz")
    ]  # that has no samples
    if false and false[0].share > MOST:
        raise MagycError(false[0].sentence)
    kept = ~hole
    for start, end in (stretch for found in false for stretch in found.stretches):
        kept &= (time < start) | (time > end)
    zeros = faults.zeros.finding()
    usable = recording if zeros is None else _without_zeros(recording)
    return Usable(usable if kept.all() else usable.rows(kept), stuck, zeros, cut_off, faults.clipped_field)


def _without_zeros(recording: Recording) -> Recording:
    """Replace zeros of the magnetometer by the sample before (the first by the one after), marked as not measured."""
    zero = np.asarray(~recording.magnetic_field.any(axis=1))
    place = np.maximum.accumulate(np.where(zero, -1, np.arange(len(zero))))
    place = np.where(place < 0, np.argmin(zero), place)
    return replace(
        recording,
        magnetic_field=recording.magnetic_field[place],
        magnetic_field_fresh=recording.magnetic_field_fresh & ~zero,
        magnetic_field_stamped=recording.magnetic_field_stamped & ~zero,
    )
