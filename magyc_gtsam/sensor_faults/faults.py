"""Detect all faults of both sensors, pass on the usable samples and report the rest, in batch and online."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

import numpy as np

from magyc_gtsam.recording import Array, Recording, Samples
from magyc_gtsam.sensor_faults.cut_off import Clipped, CutOff
from magyc_gtsam.sensor_faults.full_scale import ClippedField, FullScale
from magyc_gtsam.sensor_faults.gate import SampleGate
from magyc_gtsam.sensor_faults.repeats import Repeats
from magyc_gtsam.sensor_faults.single_samples import FaultySamples, ZeroRates, Zeros, found_in_turn
from magyc_gtsam.sensor_faults.spikes import Spikes
from magyc_gtsam.sensor_faults.stuck import Stretch, StuckAxes
from magyc_gtsam.sensor_faults.stuck_bit import StuckBit, StuckBits
from magyc_gtsam.sensor_faults.stuck_finding import Stuck, named
from magyc_gtsam.sensor_faults.waiting_field import WaitingField


class SensorFaults:
    """The fault detectors of both sensors and the gates behind them.

    Args:
        samples: number of magnetometer samples, if they come as one block; None for a stream.
        shown: (factor, unit) by which messages show a field.
    """

    def __init__(self, samples: int | None = None, shown: tuple[float, str] = (1e6, "µT")) -> None:
        self._shown, whole = shown, samples is not None
        self._field = WaitingField(whole)
        self.zeros = Zeros()
        self.zero_rates = ZeroRates()
        self.spikes = Spikes(), Spikes()
        self.cut_off = CutOff()
        self.full_scale = FullScale(samples, samples) if samples is not None else FullScale()
        self.stuck_bits = tuple(
            StuckBits(sys.maxsize, sys.maxsize, each) if whole else StuckBits(sensor=each)
            for each in ("magnetic_field", "angular_rate")
        )
        self.repeats = Repeats(None) if whole else Repeats()
        if whole:
            self.magnetometer = StuckAxes(remembered=None)
            self.gyroscope = StuckAxes(self._field.turned, np.inf, remembered=None)
        else:
            self.magnetometer, self.gyroscope = StuckAxes(), StuckAxes(self._field.turned)
        self._zero_gates = SampleGate(self.zeros), SampleGate(self.zero_rates)
        # If many neighbours are spikes, the first detector misses some, which the second finds once the others are
        # removed.
        self._spike_gates = tuple(SampleGate(each) for each in self.spikes)
        # A long turn at full scale looks like a stuck axis, so it is rejected first.
        self._cut_off_gate = SampleGate(self.cut_off)
        self._gates = SampleGate(self.magnetometer), SampleGate(self.gyroscope)

    @classmethod
    def of(cls, recording: Recording, sensors: Sequence[str] = ("magnetic_field", "angular_rate")) -> SensorFaults:
        """Return the faults of a whole recording, of the named sensors."""
        field = recording.magnetometer
        faults = cls(len(field.time), recording.field_shown)
        repeated = recording.time[recording.magnetic_field_stamped & ~recording.magnetic_field_fresh]
        turns = recording.angular_rate is not None and "angular_rate" in sensors
        faults.take(field, recording.gyroscope if turns else Samples(np.empty(0), np.empty((0, 3))), repeated)
        faults.full_scale.conclude()
        for bits in faults.stuck_bits:
            bits.conclude()
        faults.gyroscope.conclude()
        return faults

    def take(self, magnetometer: Samples, gyroscope: Samples, repeated: Array) -> tuple[Samples, Samples]:
        """Return the usable samples; `repeated` (n,) s are the stamps at which the magnetometer repeated a sample."""
        of_field, of_rate = self._zero_gates
        magnetometer, gyroscope = of_field.take(magnetometer), of_rate.take(gyroscope)
        for gate in self._spike_gates:
            gyroscope = gate.take(gyroscope)
        # A wrong bit whose readings are left out as spikes does no harm.
        for bits, samples in zip(self.stuck_bits, (magnetometer, gyroscope), strict=True):
            bits.observe(samples.value)
        self.repeats.observe(magnetometer, repeated, gyroscope)
        self.full_scale.observe(magnetometer.value)
        self._field.append(magnetometer, gyroscope)
        first, second = self._gates
        passed = first.take(magnetometer), second.take(self._cut_off_gate.take(gyroscope))
        self._field.cut(min(self.gyroscope.pending, self.cut_off.pending))
        return passed

    @property
    def dropped(self) -> int:
        """The number of samples that were dropped."""
        gates = (*self._zero_gates, *self._spike_gates, self._cut_off_gate, *self._gates)
        return sum(gate.dropped for gate in gates)

    @property
    def single_samples(self) -> tuple[FaultySamples, ...]:
        """The findings on single faulty samples."""
        findings = self.zeros.finding(), self.zero_rates.finding(), found_in_turn(self.spikes)
        return tuple(finding for finding in findings if finding is not None)

    @property
    def clipped(self) -> Clipped | None:
        """The samples that the gyroscope's full scale cut off, or None."""
        return self.cut_off.finding(self._cut_off_gate.dropped / max(self._cut_off_gate.taken, 1))

    @property
    def clipped_field(self) -> ClippedField | None:
        """The samples that the magnetometer's full scale cut off; None if too few to do harm."""
        return self.full_scale.finding(*self._shown)

    @property
    def stuck_bit(self) -> StuckBit | None:
        """The bit of the magnetometer that always reads the same, or fails, or None."""
        return self.stuck_bits[0].finding(*self._shown)

    @property
    def stuck_rate_bit(self) -> StuckBit | None:
        """The bit of the gyroscope that always reads the same, or fails, or None."""
        return self.stuck_bits[1].finding(1e3, "mrad/s")

    def stuck(self, duration: float, now: bool = False) -> tuple[Stuck, ...]:
        """Return the stuck axes in a run of `duration` s, the largest share first; with `now`, those still stuck."""
        field = self.magnetometer_stretches(now)
        field += self.repeats.now if now else self.repeats.stretches
        rate = self.gyroscope.now if now else self.gyroscope.stretches
        stuck = (
            *named("magnetic_field", field, duration, *self._shown),
            *named("angular_rate", rate, duration, 1e3, "mrad/s"),
        )
        return tuple(sorted(stuck, key=lambda stuck: -stuck.share))

    def magnetometer_stretches(self, now: bool = False) -> tuple[Stretch, ...]:
        """Return when axes of the magnetometer were stuck, except at its full scale."""
        finding = self.clipped_field
        levels = np.full((3, 2), np.nan) if finding is None else np.array(finding.levels)
        every = self.magnetometer.now if now else self.magnetometer.stretches
        return tuple(s for s in every if not _at_full_scale(s, levels))

    @property
    def _parts(self) -> Mapping[str, SampleGate | FullScale | StuckBits | Repeats]:
        return {
            "zeros": self._zero_gates[0],
            "zero_rates": self._zero_gates[1],
            "spikes": self._spike_gates[0],
            "spikes_again": self._spike_gates[1],
            "cut_off": self._cut_off_gate,
            "magnetometer": self._gates[0],
            "gyroscope": self._gates[1],
            "full_scale": self.full_scale,
            "stuck_bits": self.stuck_bits[0],
            "stuck_rate_bits": self.stuck_bits[1],
            "repeats": self.repeats,
        }

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        states = {name: part.state() for name, part in self._parts.items()}
        result = {f"{name}/{key}": value for name, state in states.items() for key, value in state.items()}
        return result | self._field.state()

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        for name, part in self._parts.items():
            prefix = f"{name}/"
            part.restore({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
        self._field.restore({"field": state["field"], "latest": state["latest"]})


def _at_full_scale(stretch: Stretch, levels: Array) -> bool:
    """Return whether the axes of a stretch were stuck at the levels (3, 2) at which they are cut off."""
    axes, value = np.array(stretch.axes), np.array(stretch.value)
    return bool((value[axes, None] == levels[axes]).any(axis=1).all())
