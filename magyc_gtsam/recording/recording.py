"""The class `Recording`: one table with one row per time stamp.

Sensors with different clocks or rates share the table: its rows are the union of their stamps, and a mask per sensor
marks the rows that carry a true sample. Every sample keeps its stamp and its value exactly; filled rows add no
information.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from magyc_gtsam.factors.effects.signals import kinds
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import LONGEST, printable
from magyc_gtsam.recording.autopilot import Autopilot
from magyc_gtsam.recording.axes import OWN_AXES, axes_text, parse_axes
from magyc_gtsam.recording.checks import (
    MAGNETOMETER_ALONE,
    NO_GYROSCOPE,
    Array,
    Mask,
    check_ascending,
    check_choice,
    check_field_unit,
    check_interval,
    check_rate_unit,
    frozen,
    given_notes,
    named_channels,
    unit_quaternions,
    without_no_values,
)
from magyc_gtsam.recording.freshness import sample_masks
from magyc_gtsam.recording.stamps import Hole, check_seconds, holes, origin_of, seconds
from magyc_gtsam.recording.time_base import Stream, unite

RateKind: TypeAlias = Literal["instant", "interval-mean"]
AttitudeKind: TypeAlias = Literal["independent", "estimate"]
FieldUnit: TypeAlias = Literal["T", "counts"]


class Samples(NamedTuple):
    """The true samples of one sensor: time (n,) s, value (n, 3)."""

    time: Array
    value: Array


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Magnetometer and gyroscope data of one instrument, with optional acceleration, attitude and channels.

    Args:
        time: (N,) s, strictly ascending; or datetime64, datetime or pandas stamps, the first of which becomes 0 s.
        magnetic_field: (N, 3) T, sensor frame.
        angular_rate: (N, 3) rad/s, sensor frame; None without a gyroscope.
        acceleration: (N, 3) m/s², specific force, sensor frame.
        attitude: (N, 4) unit quaternion x, y, z, w, sensor→world (scipy's order); rows of NaN where
            there is no reference.
        channels: {name: (N,) or (N, k)}, e.g. current, temperature, depth; NaN where absent. In channels of a known
            kind (`factors.effects.signals.CHANNELS`) placeholders such as −99999 become NaN, with a note.
        name: the recording's name in reports.
        angular_rate_is: "instant" (values AT `time`; see `factors.chain.rotations.increments`) or
            "interval-mean" (mean rate since the previous row, as delta angles are).
        attitude_is: "independent" of the magnetometer, or an "estimate" to which it contributed, as an autopilot's
            does. A calibration that rests on an estimate is not trusted.
        gyroscope_axes: the sensor's own axes along x, y, z of `angular_rate`, where it was turned into the axes of the
            magnetometer, such as "y,-x,z". Advice and exports are in the sensor's own.
        autopilot: where the autopilot that wrote the log has the sensors' parameters; None for other logs.
        magnetic_field_unit: "T", or "counts" where the scale is unknown; then the field, and every result that has
            its unit, is in counts.
        magnetic_field_fresh: (N,) bool, rows that hold a true sample of the magnetometer. Default: all rows that do
            not repeat the row before them exactly (sample-and-hold).
        angular_rate_fresh: (N,) bool, the same for the gyroscope. Default: all rows, unless the gyroscope repeats
            itself so often that it must be sample-held.
        magnetic_field_stamped: (N,) bool, rows at which the log has an entry of the magnetometer, fresh or repeated;
            in the others another sensor has one. Default: all rows, or `magnetic_field_fresh` if that is given.
        notes: remarks of the reader on converted or omitted data, for the report.

    Raises:
        MagycError: wrong shapes, non-finite values, time that does not ascend, implausible units.
    """

    time: Array
    magnetic_field: Array
    angular_rate: Array | None = None
    acceleration: Array | None = field(default=None, kw_only=True)
    attitude: Array | None = field(default=None, kw_only=True)
    channels: Mapping[str, Array] = field(default_factory=dict, kw_only=True)
    name: str = field(default="", kw_only=True)
    angular_rate_is: RateKind = field(default="instant", kw_only=True)
    attitude_is: AttitudeKind = field(default="independent", kw_only=True)
    gyroscope_axes: str = field(default=OWN_AXES, kw_only=True)
    autopilot: Autopilot | None = field(default=None, kw_only=True)
    magnetic_field_unit: FieldUnit = field(default="T", kw_only=True)
    magnetic_field_fresh: Mask = field(default=None, kw_only=True)  # type: ignore[arg-type]
    angular_rate_fresh: Mask = field(default=None, kw_only=True)  # type: ignore[arg-type]
    magnetic_field_stamped: Mask = field(default=None, kw_only=True)  # type: ignore[arg-type]
    notes: tuple[str, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        put = object.__setattr__  # the dataclass is frozen
        if not isinstance(self.name, str):
            raise MagycError(f"name: a text is needed, got {self.name!r:.40}")
        put(self, "name", printable(self.name[:LONGEST]))
        put(self, "notes", given_notes(self.notes))
        check_choice("angular_rate_is", self.angular_rate_is, get_args(RateKind))
        check_choice("attitude_is", self.attitude_is, get_args(AttitudeKind))
        put(self, "gyroscope_axes", axes_text(parse_axes(self.gyroscope_axes)))
        check_choice("magnetic_field_unit", self.magnetic_field_unit, get_args(FieldUnit))
        time = frozen("time", seconds("time", self.time, origin_of(self.time)), (None,))
        if len(time) < 3:
            raise MagycError(f"time: {len(time)} rows, at least 3 are needed; is the file or interval empty?")
        check_ascending(time)
        check_seconds("time", time)
        n = len(time)
        put(self, "time", time)
        put(self, "magnetic_field", frozen("magnetic_field", self.magnetic_field, (n, 3)))
        if self.magnetic_field_unit == "T":
            check_field_unit(self.magnetic_field)
        if self.angular_rate is not None:
            put(self, "angular_rate", frozen("angular_rate", self.angular_rate, (n, 3)))
            check_rate_unit(time, self.angular_rate)
        if self.acceleration is not None:
            put(self, "acceleration", frozen("acceleration", self.acceleration, (n, 3)))
        if self.attitude is not None:
            put(self, "attitude", unit_quaternions(frozen("attitude", self.attitude, (n, 4), nan=True)))
        channels = {
            k: frozen(f"channel {k!r}", v, (n, ...), nan=True) for k, v in named_channels(self.channels).items()
        }
        for name in filter(kinds, channels):
            channels[name], note = without_no_values(name, channels[name])
            put(self, "notes", (*self.notes, note) if note else self.notes)
        put(self, "channels", MappingProxyType(channels))
        given = self.magnetic_field_fresh, self.angular_rate_fresh, self.magnetic_field_stamped
        for name, mask in sample_masks(time, self.magnetic_field, self.angular_rate, *given).items():
            put(self, name, mask)

    @property
    def magnetometer(self) -> Samples:
        """The true samples of the magnetometer, without held and filled rows."""
        return self._samples(self.magnetic_field, self.magnetic_field_fresh, self._every_row[0])

    @property
    def gyroscope(self) -> Samples:
        """The true samples of the gyroscope, without held and filled rows.

        Raises:
            MagycError: the recording has no gyroscope.
        """
        if self.angular_rate is None:
            remark = next((note for note in self.notes if note.startswith(NO_GYROSCOPE)), "")
            raise MagycError(
                f"recording {self.name!r} has no angular rate, which this method needs; "
                + (remark or "name the gyroscope's topic or columns (angular_rate=)")
                + f", or {MAGNETOMETER_ALONE}"
            )
        return self._samples(self.angular_rate, self.angular_rate_fresh, self._every_row[1])

    def _samples(self, values: Array, fresh: Mask, every: bool) -> Samples:
        if every:
            return Samples(self.time, values)
        rows = np.flatnonzero(fresh)  # by numbers of rows in a tenth of the time that a mask takes
        return Samples(self.time.take(rows), values.take(rows, axis=0))

    @cached_property
    def _every_row(self) -> tuple[bool, bool]:  # holds a true sample of the magnetometer, of the gyroscope
        return bool(self.magnetic_field_fresh.all()), bool(self.angular_rate_fresh.all())

    @property
    def field_shown(self) -> tuple[float, str]:
        """The factor that converts the field to the unit in which it is shown, and that unit: "µT" or "counts"."""
        return (1e6, "µT") if self.magnetic_field_unit == "T" else (1.0, "counts")

    @property
    def duration(self) -> float:
        """Time from the first row to the last, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def gaps(self) -> tuple[Hole, ...]:
        """Holes in the stamps of the gyroscope (else the magnetometer) longer than 10 median steps and 0.5 s."""
        return holes(self.magnetometer.time if self.angular_rate is None else self.gyroscope.time)

    def between(self, start: float | None = None, end: float | None = None) -> Recording:
        """Return the rows from `start` to `end`, in s since the first row; None stands for the first or last row.

        Raises:
            MagycError: the interval holds fewer than 3 rows.
        """
        check_interval(start, end)
        since = self.time - self.time[0]
        first, last = (-np.inf if start is None else start), (np.inf if end is None else end)
        rows = (since >= first) & (since <= last)
        if rows.sum() < 3:
            ends = [f"{word} {at:g} s" for word, at in (("from", start), ("to", end)) if at is not None]
            raise MagycError(
                f"interval {' '.join(ends)}: holds {rows.sum()} rows of a recording of {since[-1]:.1f} s; start and "
                "end count from the first row"
            )
        return self.rows(rows)

    def rows(self, rows: Any) -> Recording:
        """Return the recording reduced to the given rows (slice, mask or indices).

        Raises:
            MagycError: there are no such rows, fewer than 3 of them, or they do not ascend.
        """
        try:
            rows = np.arange(len(self.time))[rows]
        except (IndexError, TypeError) as error:
            raise MagycError(f"rows: not a slice, mask or indices of {len(self.time)} rows ({error})") from None

        def take(value: Array | None) -> Any:
            return None if value is None else value[rows]

        return replace(
            self,
            time=self.time[rows],
            magnetic_field=self.magnetic_field[rows],
            angular_rate=take(self.angular_rate),
            acceleration=take(self.acceleration),
            attitude=take(self.attitude),
            channels={k: v[rows] for k, v in self.channels.items()},
            magnetic_field_fresh=self.magnetic_field_fresh[rows],
            angular_rate_fresh=self.angular_rate_fresh[rows],
            magnetic_field_stamped=self.magnetic_field_stamped[rows],
        )

    @classmethod
    def from_streams(
        cls,
        magnetic_field: Stream,
        angular_rate: Stream | None = None,
        *,
        acceleration: Stream | None = None,
        attitude: Stream | None = None,
        channels: Mapping[str, Stream] | None = None,
        name: str = "",
        notes: tuple[str, ...] = (),
        angular_rate_is: RateKind = "instant",
        attitude_is: AttitudeKind = "independent",
        magnetic_field_unit: FieldUnit = "T",
    ) -> Recording:
        """Merge sensors with separate time stamps, each given as (time, values), into one recording.

        The rows are the union of the magnetometer's and the gyroscope's stamps where the two overlap. Between its
        samples the magnetometer holds the last one and the gyroscope is interpolated (an interval mean applies back
        to the sample before); `*_fresh` marks these rows as filled. Acceleration and channels are interpolated,
        attitude by slerp; attitude and channels are NaN outside their time span and in their long pauses.

        Raises:
            MagycError: as the constructor, and if the stamps of the sensors do not overlap, or not all are dates.
        """
        united = unite(magnetic_field, angular_rate, acceleration, attitude, channels, angular_rate_is)
        united["notes"] = (*given_notes(notes), *united["notes"])
        return cls(
            **united,
            name=name,
            angular_rate_is=angular_rate_is,
            attitude_is=attitude_is,
            magnetic_field_unit=magnetic_field_unit,
        )

    def with_samples(self, magnetic_field: Stream, angular_rate: Stream | None) -> Recording:
        """Return the recording with other samples of its two sensors, and all other data interpolated to their rows."""
        optional = {"acceleration": self.acceleration, "attitude": self.attitude, **self.channels}
        others = {}
        for name, values in optional.items():
            if values is not None:
                known = np.isfinite(values).reshape(len(values), -1).all(axis=1)
                if known.sum() > 1:
                    others[name] = (self.time[known], values[known])
        acceleration, attitude = (others.pop(name, None) for name in ("acceleration", "attitude"))
        united = unite(magnetic_field, angular_rate, acceleration, attitude, others, self.angular_rate_is)
        absent = dict.fromkeys(("angular_rate", "acceleration", "attitude"))
        united = {**absent, **united, "notes": (*self.notes, *united["notes"])}
        return replace(self, **united)

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (
            {f.name: getattr(self, f.name) for f in fields(self)} | {"channels": dict(self.channels)},
        )

    def __repr__(self) -> str:
        fresh = {"magnetometer": self.magnetic_field_fresh}
        fresh |= {} if self.angular_rate is None else {"gyroscope": self.angular_rate_fresh}
        rates = ", ".join(f"{k} {(m.sum() - 1) / self.duration:.1f} Hz" for k, m in fresh.items())
        return f"Recording({self.name!r}, {len(self.time)} rows, {self.duration:.1f} s, {rates})"


def _rebuilt(values: dict[str, Any]) -> Recording:
    return Recording(**values)
