"""What the detectors of `sensor_faults` find in a whole recording."""

from __future__ import annotations

import magyc_gtsam as mg
from magyc_gtsam.recording import Samples
from magyc_gtsam.sensor_faults.cut_off import Clipped, CutOff, inside
from magyc_gtsam.sensor_faults.faults import SensorFaults
from magyc_gtsam.sensor_faults.full_scale import ClippedField, FullScale
from magyc_gtsam.sensor_faults.gate import SampleGate
from magyc_gtsam.sensor_faults.stuck_finding import SMALL, Stuck


def find_stuck(recording: mg.Recording) -> list[Stuck]:
    """Axes that stood still for more than an instant."""
    return [s for s in SensorFaults.of(recording).stuck(recording.duration) if s.share > SMALL]


def find_clipped(recording: mg.Recording) -> Clipped | None:
    """What the gyroscope's full scale cut off."""
    faults = SensorFaults.of(recording)
    return faults.cut_off.finding(float(inside(faults.cut_off.spans, recording.time).mean()))


def find_clipped_field(recording: mg.Recording) -> ClippedField | None:
    """What the magnetometer's full scale cut off."""
    field = recording.magnetometer.value
    detector = FullScale(len(field), len(field))
    detector.observe(field)
    return detector.finding(*recording.field_shown)


def watched(samples: Samples, step: int = 16) -> SampleGate:
    """A gate behind the detector of cut-off turns that has seen all samples, so many at a time."""
    gate = SampleGate(CutOff())
    for i in range(0, len(samples.time), step):
        gate.take(Samples(samples.time[i : i + step], samples.value[i : i + step]))
    return gate


def cut_off(gate: SampleGate) -> Clipped | None:
    """What the detector of a gate found."""
    return gate.detector.finding(gate.dropped / max(gate.taken, 1))
