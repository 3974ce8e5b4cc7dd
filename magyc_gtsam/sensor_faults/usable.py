"""Select the rows of a recording that a batch method may use: those in which neither sensor was faulty."""

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
from magyc_gtsam.sensor_faults.single_samples import FaultySamples
from magyc_gtsam.sensor_faults.stuck_bit import StuckBit
from magyc_gtsam.sensor_faults.stuck_finding import MOST, SMALL, Stuck


@dataclass(frozen=True, eq=False)
class Usable:
    """A recording without its faulty rows, and the faults found.

    Attributes:
        recording: the rows without faults.
        stuck: axes that were stuck for more than a share of `SMALL`, the largest share first.
        single: single faulty samples: placeholders (zero on all axes) of each sensor, spikes of the gyroscope.
        cut_off: samples that the gyroscope's full scale cut off; None if there are none.
        clipped: samples that the magnetometer's full scale cut off, which remain in the rows; None if there are none.
        bits: bits of either sensor that are stuck or fail; their samples remain as well.
    """

    recording: Recording
    stuck: tuple[Stuck, ...]
    single: tuple[FaultySamples, ...]
    cut_off: Clipped | None
    clipped: ClippedField | None
    bits: tuple[StuckBit, ...] = ()

    @property
    def refused(self) -> str:
        """Why no calibration from the rows may be trusted; "" if one may."""
        return "; ".join(fault.sentence for fault in (*self.bits, self.clipped) if fault is not None)

    @property
    def left_out(self) -> list[str]:
        """One message per fault whose rows were left out."""
        return [fault.where for fault in (*self.stuck, *self.single, self.cut_off) if fault is not None]


def without_faults(recording: Recording, sensors: Sequence[str] = ("magnetic_field", "angular_rate")) -> Usable:
    """Return the recording without the rows in which the named sensors were faulty.

    The methods tolerate gaps in a recording but not faulty axes.

    Raises:
        MagycError: an axis was stuck for more than half of the recording, or too many turns were cut off.
    """
    if not may_be_faulty(recording, sensors):
        return Usable(recording, (), (), None, None)
    faults, time = SensorFaults.of(recording, sensors), recording.time
    hole = inside(faults.cut_off.spans, time)
    cut_off = faults.cut_off.finding(float(hole.mean()))
    if cut_off is not None and cut_off.too_often:
        raise MagycError(cut_off.sentence)
    stuck = tuple(s for s in faults.stuck(recording.duration) if s.share > SMALL)
    # A magnetometer stuck on all axes has no samples to leave out.
    faulty = [each for each in stuck if (each.sensor, each.axes) != ("magnetic_field", "xyz")]
    if faulty and faulty[0].share > MOST:
        raise MagycError(faulty[0].sentence)
    kept = ~hole
    for start, end in (stretch for each in faulty for stretch in each.stretches):
        kept &= (time < start) | (time > end)
    usable = recording
    if faults.zeros.finding() is not None:
        usable = _without_zero_fields(usable)
    no_rate = np.any([each.rejects(time) for each in (faults.zero_rates, *faults.spikes)], axis=0)
    if no_rate.any():
        usable = _without_rates(usable, no_rate)
    usable = usable if kept.all() else usable.rows(kept)
    bits = tuple(bit for bit in (faults.stuck_bit, faults.stuck_rate_bit) if bit is not None)
    return Usable(usable, stuck, faults.single_samples, cut_off, faults.clipped_field, bits)


def _without_zero_fields(recording: Recording) -> Recording:
    """Replace zeros of the magnetometer by the sample before (or after, at the start), marked as not measured."""
    zero = np.asarray(~recording.magnetic_field.any(axis=1))
    place = np.maximum.accumulate(np.where(zero, -1, np.arange(len(zero))))
    place = np.where(place < 0, np.argmin(zero), place)
    return replace(
        recording,
        magnetic_field=recording.magnetic_field[place],
        magnetic_field_fresh=recording.magnetic_field_fresh & ~zero,
        magnetic_field_stamped=recording.magnetic_field_stamped & ~zero,
    )


def _without_rates(recording: Recording, faulty: np.ndarray) -> Recording:
    """Replace `faulty` (n,) rates as `Recording.from_streams` fills rows without a sample of the gyroscope."""
    time, rate = recording.time, recording.angular_rate
    assert rate is not None
    measured = np.flatnonzero(~faulty)
    if recording.angular_rate_is == "interval-mean":
        filled = rate[measured[np.searchsorted(measured, np.arange(len(rate)))]]
    else:
        filled = np.column_stack([np.interp(time, time[measured], axis[measured]) for axis in rate.T])
    return replace(recording, angular_rate=filled, angular_rate_fresh=recording.angular_rate_fresh & ~faulty)
