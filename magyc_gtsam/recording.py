"""`Recording`: what a vehicle recorded, validated once and never changed afterwards.

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
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from magyc_gtsam.factors.errors import MagycError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EARTH_FIELD = (20e-6, 70e-6)  # T, the range of the Earth's field at its surface
_FIELD_LIMITS = (2e-6, 3e-3)  # T, median norm; a hard iron of forty times the field still passes
_RATE_LIMIT = 70.0  # rad/s, twice the range of the fastest common gyroscopes (2000 deg/s)
_HELD_GYROSCOPE = 0.3  # share of exact repeats from which a gyroscope counts as sample-held
_LONGEST_HOLD = 0.2  # s; a rate that repeats for longer stands still and is measured all the same
_FIELD_UNITS = {"µT": 1e-6, "gauss": 1e-4, "milligauss": 1e-7, "nT": 1e-9, "mT": 1e-3}


class Samples(NamedTuple):
    """The true samples of one sensor at its own time stamps: time (n,) s, value (n, 3)."""

    time: Array
    value: Array


class Gap(NamedTuple):
    """A hole in the time stamps: the last stamp before it and its duration, both in seconds."""

    start: float
    duration: float


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Magnetometer and gyroscope data of one instrument, with what else was recorded.

    Args:
        time: (N,) s, strictly ascending.
        magnetic_field: (N, 3) T, sensor frame.
        angular_rate: (N, 3) rad/s, sensor frame; None where there is no gyroscope.
        acceleration: (N, 3) m/s², specific force, sensor frame.
        attitude: (N, 4) unit quaternion x, y, z, w, sensor→world (scipy's order); rows of NaN where
            there is no reference.
        channels: {name: (N,) or (N, k)}, e.g. current, temperature, depth; NaN where absent.
        name: what to call it in reports.
        angular_rate_is: "instant" (values AT `time`; see `factors.rotations.increments`) or
            "interval-mean" (mean rate since the previous row, as delta angles are).
        magnetic_field_unit: "T", or "counts" where nobody knows what one is; then the field is what the log
            holds, and all that follows from it is in counts too.
        magnetic_field_fresh: (N,) bool, rows that hold a sample of the magnetometer's own. Default:
            all rows that do not repeat the row before them exactly (sample-and-hold).
        angular_rate_fresh: (N,) bool, likewise for the gyroscope. Default: all rows, unless the
            gyroscope repeats itself so often that it must be sample-held.
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
    magnetic_field_unit: Literal["T", "counts"] = field(default="T", kw_only=True)
    magnetic_field_fresh: Mask = field(default=None, kw_only=True)  # type: ignore[arg-type]
    angular_rate_fresh: Mask = field(default=None, kw_only=True)  # type: ignore[arg-type]
    notes: tuple[str, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        put = object.__setattr__  # the only place that writes: the dataclass is frozen
        time = _frozen("time", self.time, (None,))
        if len(time) < 3:
            raise MagycError(f"time: {len(time)} rows, at least 3 are needed; is the file or interval empty?")
        _check_ascending(time)
        n = len(time)
        put(self, "time", time)
        put(self, "magnetic_field", _frozen("magnetic_field", self.magnetic_field, (n, 3)))
        if self.magnetic_field_unit not in ("T", "counts"):
            raise MagycError(f"magnetic_field_unit: {self.magnetic_field_unit!r} is neither 'T' nor 'counts'")
        if self.magnetic_field_unit == "T":
            _check_field_unit(self.magnetic_field)
        if self.angular_rate is not None:
            put(self, "angular_rate", _frozen("angular_rate", self.angular_rate, (n, 3)))
            _check_rate_unit(time, self.angular_rate)
        if self.acceleration is not None:
            put(self, "acceleration", _frozen("acceleration", self.acceleration, (n, 3)))
        if self.attitude is not None:
            put(self, "attitude", _unit_quaternions(_frozen("attitude", self.attitude, (n, 4), nan=True)))
        if self.angular_rate_is not in ("instant", "interval-mean"):
            raise MagycError(f"angular_rate_is: {self.angular_rate_is!r} is neither 'instant' nor 'interval-mean'")
        channels = {k: _frozen(f"channel {k!r}", v, (n, ...), nan=True) for k, v in (self.channels or {}).items()}
        put(self, "channels", MappingProxyType(channels))
        put(self, "magnetic_field_fresh", self._mask("magnetic_field_fresh", self.magnetic_field, 0.0, np.inf))
        put(
            self,
            "angular_rate_fresh",
            self._mask("angular_rate_fresh", self.angular_rate, _HELD_GYROSCOPE, _LONGEST_HOLD),
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
    def gaps(self) -> tuple[Gap, ...]:
        """Holes of the gyroscope's (else the magnetometer's) stamps: over 10 median steps and 0.5 s."""
        time = self.magnetometer.time if self.angular_rate is None else self.gyroscope.time
        step = np.diff(time)
        holes = np.flatnonzero(step > max(10 * float(np.median(step)), 0.5))
        return tuple(Gap(float(time[i]), float(step[i])) for i in holes)

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
        )

    @classmethod
    def from_streams(
        cls,
        magnetic_field: tuple[ArrayLike, ArrayLike],
        angular_rate: tuple[ArrayLike, ArrayLike] | None = None,
        *,
        acceleration: tuple[ArrayLike, ArrayLike] | None = None,
        attitude: tuple[ArrayLike, ArrayLike] | None = None,
        channels: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
        name: str = "",
        notes: tuple[str, ...] = (),
        angular_rate_is: Literal["instant", "interval-mean"] = "instant",
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
        streams = {"magnetic_field": magnetic_field, "angular_rate": angular_rate}
        clean = {k: _stream(k, *v, width=3) for k, v in streams.items() if v is not None}
        first = max(t[0] for t, _ in clean.values())
        last = min(t[-1] for t, _ in clean.values())
        if last <= first:
            spans = ", ".join(f"{k} {t[0]:.3f} to {t[-1]:.3f} s" for k, (t, _) in clean.items())
            raise MagycError(
                f"the sensors' clocks do not overlap ({spans}); "
                "shift one of them, or read a log by its recording times (stamps='log')"
            )
        inside = [t[(t >= first) & (t <= last)] for t, _ in clean.values()]
        time = np.unique(np.concatenate(inside))
        cut = sum(len(t) for t, _ in clean.values()) - sum(len(t) for t in inside)
        if cut:
            notes = (*notes, f"{cut} samples outside the time that both sensors cover were left out")
        mag_time, mag = clean["magnetic_field"]
        held = np.searchsorted(mag_time, time, side="right") - 1
        mag_fresh = mag_time[held] == time
        mag_fresh[np.flatnonzero(mag_fresh)[1:]] &= (np.diff(mag[held[mag_fresh]], axis=0) != 0).any(axis=1)
        rate, rate_fresh = None, np.ones(len(time), dtype=bool)
        if "angular_rate" in clean:
            gyro_time, gyro = clean["angular_rate"]
            if angular_rate_is == "interval-mean":
                rate = gyro[np.searchsorted(gyro_time, time)]  # the mean holds all the way up to its stamp
            else:
                rate = _interpolate(time, gyro_time, gyro)
            rate_fresh = np.isin(time, gyro_time)
        return cls(
            time,
            mag[held],
            rate,
            acceleration=None
            if acceleration is None
            else _interpolate(time, *_stream("acceleration", *acceleration, 3)),
            attitude=None if attitude is None else _slerp(time, *_stream("attitude", *attitude, 4)),
            channels={
                k: _interpolate(time, *_stream(f"channel {k!r}", *v, None), outside=np.nan)
                for k, v in (channels or {}).items()
            },
            name=name,
            notes=notes,
            angular_rate_is=angular_rate_is,
            magnetic_field_unit=magnetic_field_unit,
            magnetic_field_fresh=mag_fresh,
            angular_rate_fresh=rate_fresh,
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


def _frozen(name: str, value: ArrayLike, shape: tuple[Any, ...], nan: bool = False) -> Array:
    """A read-only float64 copy of `value`, checked for shape and finiteness."""
    try:
        array = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: not an array of numbers ({error})") from None
    want = tuple(s for s in shape if s is not ...)
    loose = len(want) < len(shape)
    if (array.ndim != len(want) and not (loose and array.ndim == len(want) + 1)) or any(
        w is not None and w != s for w, s in zip(want, array.shape, strict=False)
    ):
        text = ", ".join("N" if s is None else "k" if s is ... else str(s) for s in shape)
        turned = " (transpose it?)" if array.ndim == 2 and array.shape[::-1] == want else ""
        raise MagycError(f"{name}: shape {array.shape}, expected ({text}){turned}")
    bad = ~np.isfinite(array)
    if not nan and bad.any():
        row = int(np.argwhere(bad)[0][0])
        raise MagycError(
            f"{name}: {bad.reshape(len(array), -1).any(axis=1).sum()} of {len(array)} rows are not finite, "
            f"the first is row {row}; remove those rows (each sensor may keep its own stamps: "
            "Recording.from_streams) or name another column"
        )
    array.flags.writeable = False
    return array


def _check_ascending(time: Array) -> None:
    step = np.diff(time)
    if (step > 0).all():
        return
    row = int(np.flatnonzero(step <= 0)[0]) + 1
    what = "repeats" if step[row - 1] == 0 else "goes back"
    raise MagycError(
        f"time: {what} at row {row} ({time[row - 1]:.6f} s, then {time[row]:.6f} s; "
        f"{(step <= 0).sum()} such rows); it must ascend strictly: remove repeats, or cut where a clock was reset"
    )


def _check_field_unit(magnetic_field: Array) -> None:
    norm = float(np.median(np.linalg.norm(magnetic_field, axis=1)))
    low, high = _FIELD_LIMITS
    if low <= norm <= high:
        return
    centre = np.log(np.sqrt(EARTH_FIELD[0] * EARTH_FIELD[1]))
    unit = min(_FIELD_UNITS, key=lambda u: abs(np.log(max(norm, 1e-300) * _FIELD_UNITS[u]) - centre))
    guess = norm * _FIELD_UNITS[unit]
    likely = f"; likely unit: {unit}" if 0.2 * EARTH_FIELD[0] <= guess <= 10 * EARTH_FIELD[1] else ""
    raise MagycError(
        f"magnetic_field: median norm {norm:.4g} is not a field in tesla "
        f"(the Earth's is 20e-6 to 70e-6, {low:g} to {high:g} is accepted){likely}; "
        "convert it, or say the unit (--magnetic-unit)"
    )


def _check_rate_unit(time: Array, angular_rate: Array) -> None:
    largest = np.abs(angular_rate).max(axis=1)
    if largest.max() > _RATE_LIMIT:
        row = int(largest.argmax())
        raise MagycError(
            f"angular_rate: {largest[row]:.4g} at row {row} ({time[row]:.3f} s) is beyond {_RATE_LIMIT:g} rad/s; "
            "likely unit: deg/s; convert it, or say the unit (--angular-unit)"
        )


def _unit_quaternions(attitude: Array) -> Array:
    norm = np.linalg.norm(attitude, axis=1)
    known = np.isfinite(norm)
    wrong = known & (np.abs(norm - 1) > 0.01)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise MagycError(
            f"attitude: quaternion of norm {norm[row]:.4g} at row {row}, 1 is expected (x, y, z, w, "
            "sensor→world); mark rows without a reference with NaN"
        )
    # What is normalised stays as it is to the last bit, so that a part of a recording repeats the whole.
    unit = attitude / np.where(np.abs(norm - 1) < 1e-14, 1.0, norm)[:, None]
    unit.flags.writeable = False
    return unit


def _stream(name: str, time: ArrayLike, value: ArrayLike, width: int | None) -> tuple[Array, Array]:
    clean_time = _frozen(f"time of {name}", time, (None,))
    if len(clean_time) < 2:
        raise MagycError(f"{name}: {len(clean_time)} samples, at least 2 are needed")
    try:
        _check_ascending(clean_time)
    except MagycError as error:
        raise MagycError(f"{name}: {error}") from None
    n = len(clean_time)
    return clean_time, _frozen(name, value, (n, ...) if width is None else (n, width))


def _interpolate(at: Array, time: Array, value: Array, outside: float | None = None) -> Array:
    columns = value.reshape(len(time), -1).T
    result = np.stack([np.interp(at, time, c, left=outside, right=outside) for c in columns], axis=1)
    return result[:, 0] if value.ndim == 1 else result


def _slerp(at: Array, time: Array, quaternion: Array) -> Array:
    result = np.full((len(at), 4), np.nan)
    inside = (at >= time[0]) & (at <= time[-1])
    # Inside a hole of the reference there is no reference either.
    step = np.diff(time)
    left = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(step) - 1)
    inside &= (step[left] <= max(10 * float(np.median(step)), 0.1)) | np.isin(at, time)
    result[inside] = Slerp(time, Rotation.from_quat(_unit_quaternions(quaternion)))(at[inside]).as_quat()
    return result
