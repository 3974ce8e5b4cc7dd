"""The watch over both sensors: what stands still, and turns that were cut off, are not learnt from, and said; a field
that was cut off is said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.stuck import Stuck, field_turned, shown_value
from magyc_gtsam.online.buffers import Rows
from magyc_gtsam.online.clipped_field import ClippedFieldWatch
from magyc_gtsam.online.full_scale import FullScaleWatch
from magyc_gtsam.online.repeats import Repeats
from magyc_gtsam.online.standstill import AxisWatch
from magyc_gtsam.online.values import Progress
from magyc_gtsam.recording import Array, Samples

_WAITING = 60.0  # s after which an answer of the other sensor is not waited for
_NAMES = ("magnetic_field", "angular_rate")
_SHOWN = ((1e6, "µT"), (1e3, "mrad/s"))
_MOST = 50  # stretches remembered, the latest


class Watch:
    """Passes on what may be learnt from."""

    def __init__(self) -> None:
        self._axes = tuple(AxisWatch() for _ in _NAMES)
        self._repeats = Repeats()
        self._full_scale = FullScaleWatch()
        self._clipped_field = ClippedFieldWatch()
        self._field = Rows(4)  # magnetometer samples that the gyroscope has not come to
        self._latest = -np.inf  # s, stamp of the last gyroscope sample
        self._stretches: list[tuple[float, ...]] = []  # sensor, 3 flags, 3 values, from, to

    def take(self, magnetometer: Samples, gyroscope: Samples, repeated: Array) -> tuple[Samples, Samples]:
        """What of the samples may be learnt from; `repeated` (n,) s are the stamps of repeats of the magnetometer."""
        for since, until, *value in self._repeats.take(magnetometer, repeated, gyroscope):
            self._note(0, np.ones(3, dtype=bool), np.array(value), since, until)
        if len(gyroscope.time):
            self._latest = float(gyroscope.time[-1])
        if len(magnetometer.time):
            self._field.append(np.column_stack(magnetometer))
        self._clipped_field.take(magnetometer.value)
        field, rate = self._axes
        passed = (
            field.take(magnetometer, lambda rows: False, lambda: self._end(0)),
            rate.take(self._full_scale.take(gyroscope), self._field_turned, lambda: self._end(1)),
        )
        if len(self._field):
            time = self._field.rows[:, 0]
            self._field.cut(int(np.searchsorted(time, np.fmax(rate.until, time[-1] - 2 * _WAITING))))
        return passed

    @property
    def dropped(self) -> int:
        """Samples that were dropped."""
        return sum(axes.dropped for axes in self._axes) + self._full_scale.dropped

    def stuck(self, duration: float) -> tuple[tuple[Stuck, ...], tuple[Stuck, ...]]:
        """What stood still in a run of `duration` s, the largest share first; and what does so now."""
        now = [
            _stretch(i, axes.stuck, axes.last[1:], float(axes.begun[axes.stuck].min()), float(axes.last[0]))
            for i, axes in enumerate(self._axes)
            if axes.stuck.any()
        ]
        repeated = self._repeats.now()
        if repeated is not None:
            now.append(_stretch(0, np.ones(3, dtype=bool), repeated[2:], *repeated[:2].tolist()))
        levels = self._clipped_field.levels
        every, now = ([s for s in found if not _cut_off(s, levels)] for found in ([*self._stretches, *now], now))
        return _named(every, duration), _named(now, duration)

    @property
    def refused(self) -> str:
        """Why what is left makes no calibration; empty where it does."""
        faults = self._full_scale.clipped, self._clipped_field.clipped
        return "; ".join(fault.sentence for fault in faults if fault is not None and fault.too_often)

    def noted(self, progress: Progress) -> Progress:
        """A progress with what only the watch knows."""
        every, now = self.stuck(progress.duration)
        clipped = self._full_scale.clipped
        clipped_field = self._clipped_field.clipped
        if not every and clipped is None and clipped_field is None:
            return progress
        sentence, converged = progress.sentence, progress.converged
        if self.refused:
            sentence, converged = self.refused, False
        elif now:
            sentence = f"{now[0].where}: nothing is learnt from it until it moves"
        elif clipped is not None and self._full_scale.now:
            sentence = f"{clipped.where}: nothing is learnt across it"
        return replace(
            progress,
            sentence=sentence,
            converged=converged,
            stuck=every,
            clipped=clipped,
            clipped_field=clipped_field,
            left_out=progress.left_out + self.dropped,
        )

    def marked(self, calibration: Calibration | None, duration: float) -> Calibration | None:
        """A calibration with what was left out, as the batch methods say it."""
        faults = [*self.stuck(duration)[0], self._full_scale.clipped]
        where = [fault.where for fault in faults if fault is not None]
        if calibration is None or not (where or self.refused):
            return calibration
        diagnostics = {**calibration.diagnostics} | ({"left_out": where} if where else {})
        if self.refused:
            return replace(calibration, converged=False, message=self.refused, diagnostics=diagnostics)
        message = f"{calibration.message}; left out: {'; '.join(where)}"
        return replace(calibration, message=message, diagnostics=diagnostics)

    def _field_turned(self, rows: Array) -> bool | None:
        """Whether the field turned while the gyroscope stood still as in rows (n, 4); None while that is not known."""
        field, last = self._field.rows, rows[-1, 0]
        if not len(field) or field[-1, 0] < last:
            return None if self._latest - last < _WAITING else False
        field = field[(field[:, 0] >= rows[0, 0]) & (field[:, 0] <= last), 1:]
        strength = float(np.median(np.linalg.norm(field, axis=1))) if len(field) else 0.0
        return field_turned(field, strength, rows[0, 1:])

    def _end(self, sensor: int) -> None:
        axes = self._axes[sensor]
        self._note(sensor, axes.stuck, axes.last[1:], float(axes.begun[axes.stuck].min()), float(axes.last[0]))

    def _note(self, sensor: int, axes: np.ndarray, value: Array, since: float, until: float) -> None:
        self._stretches = [*self._stretches, _stretch(sensor, axes, value, since, until)][-_MOST:]

    @property
    def _parts(self) -> tuple[tuple[str, AxisWatch | Repeats | FullScaleWatch | ClippedFieldWatch], ...]:
        return (
            ("magnetometer", self._axes[0]),
            ("gyroscope", self._axes[1]),
            ("repeats", self._repeats),
            ("full_scale", self._full_scale),
            ("clipped_field", self._clipped_field),
        )

    def state(self) -> Mapping[str, Array]:
        """For `restore`."""
        states = {part: owner.state() for part, owner in self._parts}
        result = {f"{part}/{name}": value for part, state in states.items() for name, value in state.items()}
        return result | {
            "field": self._field.rows.copy(),
            "latest": np.array(self._latest),
            "stretches": np.array(self._stretches).reshape(-1, 9),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        for part, owner in self._parts:
            prefix = f"{part}/"
            owner.restore({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
        self._field.append(state["field"])
        self._latest = float(state["latest"])
        self._stretches = [tuple(row) for row in state["stretches"].tolist()]


def _stretch(sensor: int, axes: np.ndarray, value: Array, since: float, until: float) -> tuple[float, ...]:
    return (float(sensor), *axes.astype(float).tolist(), *np.asarray(value).tolist(), since, until)


def _cut_off(stretch: tuple[float, ...], levels: Array) -> bool:
    """Whether a stretch of one axis of the magnetometer is at a level (3, 2) at which it is cut off."""
    sensor, flags, value = stretch[0], np.array(stretch[1:4], dtype=bool), np.array(stretch[4:7])
    return sensor == 0 and bool((value[flags, None] == levels[flags]).any(axis=1).all())


def _named(stretches: list[tuple[float, ...]], duration: float) -> tuple[Stuck, ...]:
    """The same sensor and axes together."""
    groups: dict[tuple[float, ...], list[tuple[float, ...]]] = {}
    for stretch in stretches:
        groups.setdefault(stretch[:4], []).append(stretch)
    result = []
    for (sensor, *flags), group in groups.items():
        scale, unit = _SHOWN[int(sensor)]
        axes = "".join(axis for axis, flag in zip("xyz", flags, strict=True) if flag)
        times = sorted(((s[7], s[8]) for s in group), key=lambda pair: pair[0] - pair[1])
        share = sum(end - start for start, end in times) / max(duration, 1e-9)
        at = shown_value(np.array(group[0][4:7]) * scale, axes)
        result.append(Stuck(_NAMES[int(sensor)], axes, f"{at} {unit}", tuple(times), min(share, 1.0)))
    return tuple(sorted(result, key=lambda stuck: -stuck.share))
