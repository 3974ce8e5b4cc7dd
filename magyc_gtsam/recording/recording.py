"""The recording itself.

One table, one row per instant. Where the sensors have clocks or rates of their own the rows are the
union of their time stamps, and two masks say which rows carry a sample of which sensor: every sample
keeps its own stamp and its own bits, and the filled rows are never counted as information.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from magyc_gtsam.factors.effects.signals import kinds
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import LONGEST, printable
from magyc_gtsam.recording.checks import (
    Array,
    Mask,
    check_ascending,
    check_field_unit,
    check_rate_unit,
    frozen,
    unit_quaternions,
    without_no_values,
)
from magyc_gtsam.recording.stamps import check_seconds, origin_of, seconds
from magyc_gtsam.recording.time_base import Stream, unite

_HELD_GYROSCOPE = 0.3  # share of exact repeats from which a gyroscope counts as sample-held
_LONGEST_HOLD = 0.2  # s; a rate that repeats for longer stands still and is measured all the same


class Samples(NamedTuple):
    """The true samples of one sensor at its own time stamps: time (n,) s, value (n, 3)."""

    time: Array
    value: Array


class Hole(NamedTuple):
    """A hole in the time stamps: the last stamp before it and its duration, both in seconds."""

    start: float
    duration: float


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Magnetometer and gyroscope data of one instrument, with what else was recorded.

    Args:
        time: (N,) s, strictly ascending; or datetime64, datetime or pandas stamps, of which the first becomes 0 s.
        magnetic_field: (N, 3) T, sensor frame.
        angular_rate: (N, 3) rad/s, sensor frame; None where there is no gyroscope.
        acceleration: (N, 3) m/s², specific force, sensor frame.
        attitude: (N, 4) unit quaternion x, y, z, w, sensor→world (scipy's order); rows of NaN where
            there is no reference.
        channels: {name: (N,) or (N, k)}, e.g. current, temperature, depth; NaN where absent. Of those that count as
            one of a kind (`factors.signals.CHANNELS`), placeholders such as −99999 become NaN with a note.
        name: what to call it in reports.
        angular_rate_is: "instant" (values AT `time`; see `factors.rotations.increments`) or
            "interval-mean" (mean rate since the previous row, as delta angles are).
        attitude_is: "independent" of the magnetometer, or an "estimate" that it took part in, as an autopilot's own
            is. No calibration that rests on the latter is trusted.
        magnetic_field_unit: "T", or "counts" where nobody knows what one is; then the field is what the log
            holds, and all that follows from it is in counts too.
        magnetic_field_fresh: (N,) bool, rows that hold a sample of the magnetometer's own. Default:
            all rows that do not repeat the row before them exactly (sample-and-hold).
        angular_rate_fresh: (N,) bool, likewise for the gyroscope. Default: all rows, unless the
            gyroscope repeats itself so often that it must be sample-held.
        magnetic_field_stamped: (N,) bool, rows at whose time the magnetometer's log has an entry, fresh or repeated;
            the others fill its column only since another sensor has one there. Default: all rows, or those that are
            given as fresh.
        notes: what a reader had to do or leave out, for the report.

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
    angular_rate_is: Literal["instant", "interval-mean"] = field(default="instant", kw_only=True)
    attitude_is: Literal["independent", "estimate"] = field(default="independent", kw_only=True)
    magnetic_field_unit: Literal["T", "counts"] = field(default="T", kw_only=True)
    magnetic_field_fresh: Mask = field(default=None, kw_only=True)  # type: ignore[arg-type]
    angular_rate_fresh: Mask = field(default=None, kw_only=True)  # type: ignore[arg-type]
    magnetic_field_stamped: Mask = field(default=None, kw_only=True)  # type: ignore[arg-type]
    notes: tuple[str, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        put = object.__setattr__  # the only place that writes: the dataclass is frozen
        put(self, "name", printable(self.name[:LONGEST]))
        time = frozen("time", seconds("time", self.time, origin_of(self.time)), (None,))
        if len(time) < 3:
            raise MagycError(f"time: {len(time)} rows, at least 3 are needed; is the file or interval empty?")
        check_ascending(time)
        check_seconds("time", time)
        n = len(time)
        put(self, "time", time)
        put(self, "magnetic_field", frozen("magnetic_field", self.magnetic_field, (n, 3)))
        if self.magnetic_field_unit not in ("T", "counts"):
            raise MagycError(f"magnetic_field_unit: {self.magnetic_field_unit!r} is neither 'T' nor 'counts'")
        if self.magnetic_field_unit == "T":
            check_field_unit(self.magnetic_field)
        if self.angular_rate is not None:
            put(self, "angular_rate", frozen("angular_rate", self.angular_rate, (n, 3)))
            check_rate_unit(time, self.angular_rate)
        if self.acceleration is not None:
            put(self, "acceleration", frozen("acceleration", self.acceleration, (n, 3)))
        if self.attitude is not None:
            put(self, "attitude", unit_quaternions(frozen("attitude", self.attitude, (n, 4), nan=True)))
        if self.angular_rate_is not in ("instant", "interval-mean"):
            raise MagycError(f"angular_rate_is: {self.angular_rate_is!r} is neither 'instant' nor 'interval-mean'")
        if self.attitude_is not in ("independent", "estimate"):
            raise MagycError(f"attitude_is: must be 'independent' or 'estimate', got {self.attitude_is!r}")
        channels = {k: frozen(f"channel {k!r}", v, (n, ...), nan=True) for k, v in (self.channels or {}).items()}
        for name in filter(kinds, channels):
            channels[name], note = without_no_values(name, channels[name])
            put(self, "notes", (*self.notes, note) if note else self.notes)
        put(self, "channels", MappingProxyType(channels))
        stamped = self.magnetic_field_fresh if self.magnetic_field_stamped is None else self.magnetic_field_stamped
        put(self, "magnetic_field_stamped", stamped)
        for mask, values, tolerated, longest in (
            ("magnetic_field_fresh", self.magnetic_field, 0.0, np.inf),
            ("angular_rate_fresh", self.angular_rate, _HELD_GYROSCOPE, _LONGEST_HOLD),
            ("magnetic_field_stamped", None, 0.0, np.inf),
        ):
            put(self, mask, self._mask(mask, values, tolerated, longest))
        if (self.magnetic_field_fresh & ~self.magnetic_field_stamped).any():
            row = int(np.argmax(self.magnetic_field_fresh & ~self.magnetic_field_stamped))
            raise MagycError(
                f"magnetic_field_stamped: row {row} is fresh, and so an entry, but not stamped as one"
            )
        if self.magnetic_field_fresh.sum() < 3:
            raise MagycError(
                "magnetic_field: fewer than 3 different samples, all others repeat the row before; "
                "the sensor is stuck or the wrong column was read"
            )

    def _mask(self, name: str, values: Array | None, tolerated: float, longest: float) -> Mask:
        given = getattr(self, name)
        if given is not None:
            mask = np.array(given, dtype=bool)
            if mask.shape != self.time.shape:
                raise MagycError(f"{name}: shape {mask.shape}, expected {self.time.shape}, one flag per row")
        else:
            mask = np.ones(len(self.time), dtype=bool)
            if values is not None:
                repeats = (values[1:] == values[:-1]).all(axis=1)
                if repeats.mean() > tolerated:
                    mask[1:] = ~repeats
                    own = np.maximum.accumulate(np.where(mask, self.time, -np.inf))
                    mask |= self.time - own > longest
        mask.flags.writeable = False
        return mask

    @property
    def magnetometer(self) -> Samples:
        """The magnetometer's own samples, held and filled rows left out."""
        return self._samples(self.magnetic_field, self.magnetic_field_fresh)

    @property
    def gyroscope(self) -> Samples:
        """The gyroscope's own samples.

        Raises:
            MagycError: the recording has no gyroscope.
        """
        if self.angular_rate is None:
            raise MagycError(
                f"recording {self.name!r} has no angular rate, which this method needs; "
                "name the gyroscope's topic or columns, or choose a magnetometer-only method"
            )
        return self._samples(self.angular_rate, self.angular_rate_fresh)

    def _samples(self, values: Array, fresh: Mask) -> Samples:
        if fresh.all():
            return Samples(self.time, values)
        return Samples(self.time[fresh], values[fresh])

    @property
    def field_shown(self) -> tuple[float, str]:
        """What to multiply a field with before it is shown, and its unit then: µT, or counts as they are."""
        return (1e6, "µT") if self.magnetic_field_unit == "T" else (1.0, "counts")

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return float(self.time[-1] - self.time[0])

    @property
    def gaps(self) -> tuple[Hole, ...]:
        """Holes of the gyroscope's (else the magnetometer's) stamps: over 10 median steps and 0.5 s."""
        time = self.magnetometer.time if self.angular_rate is None else self.gyroscope.time
        step = np.diff(time)
        long = np.flatnonzero(step > 0.5)
        holes = long[step[long] > 10 * float(np.median(step))] if len(long) else long
        return tuple(Hole(float(time[i]), float(step[i])) for i in holes)

    def between(self, start: float | None = None, end: float | None = None) -> Recording:
        """The rows from `start` to `end`, in seconds since the first row; None is the first or last row."""
        since = self.time - self.time[0]
        first = -np.inf if start is None else start
        last = np.inf if end is None else end
        rows = (since >= first) & (since <= last)
        if rows.sum() < 3:
            raise MagycError(
                f"interval {first:g} to {last:g} s holds {rows.sum()} rows of a recording of {since[-1]:.1f} s; "
                "start and end count from the first row"
            )
        return self.rows(rows)

    def rows(self, rows: Any) -> Recording:
        """The recording with only the given rows (slice, mask or indices)."""

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
        angular_rate_is: Literal["instant", "interval-mean"] = "instant",
        attitude_is: Literal["independent", "estimate"] = "independent",
        magnetic_field_unit: Literal["T", "counts"] = "T",
    ) -> Recording:
        """Bring sensors with clocks or rates of their own, each (time, values), to one table.

        The rows are the union of the magnetometer's and the gyroscope's stamps where the two overlap.
        Magnetometer rows between samples hold the last sample, gyroscope rows are interpolated (interval
        means hold back to the sample before); neither counts as information (`*_fresh`). Acceleration and
        channels are interpolated, attitude by slerp; attitude and channels are NaN outside their own time span.

        Raises:
            MagycError: as the constructor, and where the clocks do not overlap.
        """
        united = unite(magnetic_field, angular_rate, acceleration, attitude, channels or {}, angular_rate_is)
        notes = (*notes, *united.pop("notes"))
        return cls(
            **united,
            name=name,
            notes=notes,
            angular_rate_is=angular_rate_is,
            attitude_is=attitude_is,
            magnetic_field_unit=magnetic_field_unit,
        )

    def with_samples(self, magnetic_field: Stream, angular_rate: Stream | None) -> Recording:
        """The recording with other samples of its two sensors, and everything else brought to their rows."""
        optional = {"acceleration": self.acceleration, "attitude": self.attitude, **self.channels}
        others = {}
        for name, values in optional.items():
            if values is not None:
                known = np.isfinite(values).reshape(len(values), -1).all(axis=1)
                if known.sum() > 1:
                    others[name] = (self.time[known], values[known])
        return Recording.from_streams(
            magnetic_field,
            angular_rate,
            acceleration=others.pop("acceleration", None),
            attitude=others.pop("attitude", None),
            channels=others,
            name=self.name,
            notes=self.notes,
            angular_rate_is=self.angular_rate_is,
            attitude_is=self.attitude_is,
            magnetic_field_unit=self.magnetic_field_unit,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (
            {f.name: getattr(self, f.name) for f in fields(self)} | {"channels": dict(self.channels)},
        )

    def __repr__(self) -> str:
        own = {"magnetometer": self.magnetic_field_fresh, "gyroscope": self.angular_rate_fresh}
        if self.angular_rate is None:
            del own["gyroscope"]
        rates = ", ".join(f"{k} {(m.sum() - 1) / self.duration:.1f} Hz" for k, m in own.items())
        return f"Recording({self.name!r}, {len(self.time)} rows, {self.duration:.1f} s, {rates})"


def _rebuilt(values: dict[str, Any]) -> Recording:
    return Recording(**values)
