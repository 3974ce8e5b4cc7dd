"""All faults of both sensors: which samples a method, batch or online, may use, and what is said of the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from magyc_gtsam.recording import Array, Recording, Samples
from magyc_gtsam.recording.growing_rows import GrowingRows
from magyc_gtsam.sensor_faults.cut_off import Clipped, CutOff
from magyc_gtsam.sensor_faults.full_scale import ClippedField, FullScale
from magyc_gtsam.sensor_faults.gate import SampleGate
from magyc_gtsam.sensor_faults.repeats import Repeats
from magyc_gtsam.sensor_faults.stuck import Stretch, Stuck, StuckAxes, field_turned, named
from magyc_gtsam.sensor_faults.zeros import Zeros

_WAITING = 60.0  # s after which an answer of the other sensor is not waited for


class SensorFaults:
    """The detectors of both sensors and the gates behind them.

    Args:
        samples: of the magnetometer, that come as one block; None for a stream.
        shown: what a field is multiplied with before it is shown, and its unit then.
    """

    def __init__(self, samples: int | None = None, shown: tuple[float, str] = (1e6, "µT")) -> None:
        self._shown, self._whole = shown, samples is not None
        self.zeros = Zeros()
        self.cut_off = CutOff()
        self.full_scale = FullScale(samples, samples) if samples is not None else FullScale()
        self.repeats = Repeats()
        self.magnetometer = StuckAxes()
        self.gyroscope = StuckAxes(self._field_turned, *([np.inf] if self._whole else []))
        # A long turn at full scale looks like an axis that is stuck, so it is rejected first.
        self._zeros_gate = SampleGate(self.zeros)
        self._cut_off_gate = SampleGate(self.cut_off)
        self._gates = SampleGate(self.magnetometer), SampleGate(self.gyroscope)
        self._field = GrowingRows(4)  # magnetometer samples that the gyroscope has not come to
        self._latest = -np.inf  # s, stamp of the last gyroscope sample

    @classmethod
    def of(cls, recording: Recording, sensors: Sequence[str] = ("magnetic_field", "angular_rate")) -> SensorFaults:
        """Those of a whole recording, of the named sensors."""
        field = recording.magnetometer
        faults = cls(len(field.time), recording.field_shown)
        repeated = recording.time[recording.magnetic_field_stamped & ~recording.magnetic_field_fresh]
        turns = recording.angular_rate is not None and "angular_rate" in sensors
        faults.take(field, recording.gyroscope if turns else Samples(np.empty(0), np.empty((0, 3))), repeated)
        faults.gyroscope.conclude()
        return faults

    def take(self, magnetometer: Samples, gyroscope: Samples, repeated: Array) -> tuple[Samples, Samples]:
        """What of the samples a method may use; `repeated` (n,) s are the stamps of repeats of the magnetometer."""
        magnetometer = self._zeros_gate.take(magnetometer)
        self.repeats.observe(magnetometer, repeated, gyroscope)
        self.full_scale.observe(magnetometer.value)
        if len(gyroscope.time):
            self._latest = float(gyroscope.time[-1])
        if len(magnetometer.time):
            self._field.append(np.column_stack(magnetometer))
        first, second = self._gates
        passed = first.take(magnetometer), second.take(self._cut_off_gate.take(gyroscope))
        if len(self._field):
            time = self._field.rows[:, 0]
            since = min(self.gyroscope.pending, self.cut_off.pending, self._latest)
            self._field.cut(int(np.searchsorted(time, max(since, time[-1] - 2 * _WAITING))))
        return passed

    @property
    def dropped(self) -> int:
        """Samples that were dropped."""
        return sum(gate.dropped for gate in (self._zeros_gate, self._cut_off_gate, *self._gates))

    @property
    def clipped(self) -> Clipped | None:
        """What the gyroscope's full scale cut off."""
        return self.cut_off.finding(self._cut_off_gate.dropped / max(self._cut_off_gate.taken, 1))

    @property
    def clipped_field(self) -> ClippedField | None:
        """What the magnetometer's full scale cut off, if it does harm."""
        return self.full_scale.finding(*self._shown)

    def stuck(self, duration: float, now: bool = False) -> tuple[Stuck, ...]:
        """What stood still in a run of `duration` s, the largest share first; or only what does so `now`."""
        field = self.magnetometer_stretches(now)
        field += self.repeats.now if now else self.repeats.stretches
        rate = self.gyroscope.now if now else self.gyroscope.stretches
        found = (
            *named("magnetic_field", field, duration, *self._shown),
            *named("angular_rate", rate, duration, 1e3, "mrad/s"),
        )
        return tuple(sorted(found, key=lambda stuck: -stuck.share))

    def magnetometer_stretches(self, now: bool = False) -> tuple[Stretch, ...]:
        """When axes of the magnetometer stood still other than at its full scale."""
        finding = self.clipped_field
        levels = np.full((3, 2), np.nan) if finding is None else np.array(finding.levels)
        every = self.magnetometer.now if now else self.magnetometer.stretches
        return tuple(s for s in every if not _at_full_scale(s, levels))

    def _field_turned(self, rows: Array) -> bool | None:
        """Whether the field turned while the gyroscope stood still as in rows (n, 4); None while that is not known."""
        field, last = self._field.rows, rows[-1, 0]
        if not self._whole and (not len(field) or field[-1, 0] < last):
            return None if self._latest - last < _WAITING else False
        between = slice(*np.searchsorted(field[:, 0], [rows[0, 0], last]))
        return field_turned(field[between, 1:], rows[0, 1:])

    @property
    def _parts(self) -> Mapping[str, SampleGate | FullScale | Repeats]:
        return {
            "zeros": self._zeros_gate,
            "cut_off": self._cut_off_gate,
            "magnetometer": self._gates[0],
            "gyroscope": self._gates[1],
            "full_scale": self.full_scale,
            "repeats": self.repeats,
        }

    def state(self) -> Mapping[str, Array]:
        """For `restore`."""
        states = {name: part.state() for name, part in self._parts.items()}
        result = {f"{name}/{key}": value for name, state in states.items() for key, value in state.items()}
        return result | {"field": self._field.rows.copy(), "latest": np.array(self._latest)}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        for name, part in self._parts.items():
            prefix = f"{name}/"
            part.restore({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
        self._field.append(state["field"])
        self._latest = float(state["latest"])


def _at_full_scale(stretch: Stretch, levels: Array) -> bool:
    """Whether the axes of a stretch stood at levels (3, 2) at which they are cut off."""
    axes, value = np.array(stretch.axes), np.array(stretch.value)
    return bool((value[axes, None] == levels[axes]).any(axis=1).all())
