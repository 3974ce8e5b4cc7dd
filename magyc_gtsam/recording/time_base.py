"""Merge sensor streams with separate time stamps into one table, marking which rows are true samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.effects.signals import kinds
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import counted
from magyc_gtsam.recording.checks import (
    Array,
    check_ascending,
    frozen,
    given_away,
    named_channels,
    unit_quaternions,
    without_no_values,
)
from magyc_gtsam.recording.freshness import fresh_rates
from magyc_gtsam.recording.pauses import known_at
from magyc_gtsam.recording.stamps import is_calendar, origin_of, seconds

Stream = tuple[ArrayLike, ArrayLike]

CLOCKS_APART = "the stamps of the two sensors begin and end"  # begins a note
ONE_CLOCK = "shift one of them, or read a log by its recording times (stamps='log')"  # the remedy for two clocks
_APART = 2.0  # s; drivers that start and stop one after the other are less apart


def unite(
    magnetic_field: Stream,
    angular_rate: Stream | None,
    acceleration: Stream | None,
    attitude: Stream | None,
    channels: Mapping[str, Stream] | None,
    angular_rate_is: Literal["instant", "interval-mean"],
) -> dict[str, Any]:
    """Return the arguments of a `Recording`, including `notes`; `Recording.from_streams` states the rules.

    Raises:
        MagycError: a stream has the wrong form, or the streams do not overlap in time.
    """
    streams = {"magnetic_field": magnetic_field, "angular_rate": angular_rate}
    first_time, _ = _pair("magnetic_field", magnetic_field)
    clock = _Clock(is_calendar(first_time), origin_of(first_time))
    clean = {k: _stream(k, v, 3, clock) for k, v in streams.items() if v is not None}
    first = max(t[0] for t, _ in clean.values())
    last = min(t[-1] for t, _ in clean.values())
    if "angular_rate" in clean and angular_rate_is == "instant":
        clean["angular_rate"] = _without_held(*clean["angular_rate"])
    if last <= first:
        spans = ", ".join(f"{k} {t[0]:.3f} to {t[-1]:.3f} s" for k, (t, _) in clean.items())
        raise MagycError(f"the sensors' clocks do not overlap ({spans}); {ONE_CLOCK}")
    mag_time, mag = clean["magnetic_field"]
    if all(np.array_equal(t, mag_time) for t, _ in clean.values()):
        time, cut, field = mag_time, 0, mag
        mag_stamped = np.ones(len(time), dtype=bool)
        mag_fresh = mag_stamped.copy()
        mag_fresh[1:] = np.logical_or.reduce([c[1:] != c[:-1] for c in mag.T])
    else:
        inside = [t[(t >= first) & (t <= last)] for t, _ in clean.values()]
        time = given_away(np.unique(np.concatenate(inside)))
        cut = sum(len(t) for t, _ in clean.values()) - sum(len(t) for t in inside)
        held = np.searchsorted(mag_time, time, side="right") - 1
        mag_stamped = mag_time[held] == time
        mag_fresh = mag_stamped.copy()
        mag_fresh[np.flatnonzero(mag_fresh)[1:]] &= (np.diff(mag[held[mag_fresh]], axis=0) != 0).any(axis=1)
        field = given_away(mag[held])
    result: dict[str, Any] = {
        "time": time,
        "magnetic_field": field,
        "magnetic_field_fresh": mag_fresh,
        "magnetic_field_stamped": mag_stamped,
        "angular_rate_fresh": np.ones(len(time), dtype=bool),
        "channels": {},
        "notes": (_left_out(cut),) if cut else (),
    }
    if "angular_rate" in clean:
        result["notes"] += _clocks_apart(mag_time, clean["angular_rate"][0])
    for k, v in named_channels(channels).items():
        channel_time, channel = _stream(f"channel {k!r}", v, None, clock)
        if kinds(k):  # before the interpolation, which would spread a placeholder over its neighbours
            channel, note = without_no_values(k, channel)
            result["notes"] += (note,) if note else ()
            known = np.isfinite(channel).reshape(len(channel), -1).all(axis=1)
            channel_time, channel = channel_time[known], channel[known]
        on_rows = _on_rows(time, channel_time, channel, outside=np.nan)
        known = known_at(time, channel_time)
        if not known.all():
            on_rows = given_away(np.where(known.reshape(-1, *[1] * (on_rows.ndim - 1)), on_rows, np.nan))
        result["channels"][k] = on_rows
    if "angular_rate" in clean:
        gyro_time, gyro = clean["angular_rate"]
        if angular_rate_is == "interval-mean" and time is not mag_time:
            rate = gyro[np.searchsorted(gyro_time, time)]  # the mean holds all the way up to its stamp
        else:
            rate = _on_rows(time, gyro_time, gyro)
        fresh = np.ones(len(time), dtype=bool) if time is mag_time else np.isin(time, gyro_time)
        result |= {"angular_rate": rate, "angular_rate_fresh": fresh}
    if acceleration is not None:
        result["acceleration"] = _on_rows(time, *_stream("acceleration", acceleration, 3, clock))
    if attitude is not None:
        result["attitude"] = _slerp(time, *_stream("attitude", attitude, 4, clock))
    return result


def _without_held(time: Array, rate: Array) -> tuple[Array, Array]:
    """Return the samples of a gyroscope without entries that only repeat the one before, if it is held."""
    samples = fresh_rates(time, rate)
    return (time, rate) if samples.all() else (time[samples], rate[samples])


class _Clock(NamedTuple):
    """The clock that the streams share: whether it gives dates, and which of them, in ns since 1970, is 0 s."""

    calendar: bool
    origin: int


def _pair(name: str, stream: Any) -> tuple[ArrayLike, ArrayLike]:
    """Return the stamps and the values of a stream."""
    if not isinstance(stream, tuple | list) or len(stream) != 2:
        got = f"{len(stream)} things" if isinstance(stream, tuple | list) else f"a {type(stream).__name__}"
        raise MagycError(
            f"{name}: must be the pair (time, values), got {got}; for sensors of one clock use Recording"
        )
    return stream[0], stream[1]


def _left_out(count: int) -> str:
    were = "was" if count == 1 else "were"
    return f"{counted(count, 'sample')} outside the time that both sensors cover {were} left out"


def _clocks_apart(magnetometer: Array, gyroscope: Array) -> tuple[str, ...]:
    """Return a remark if one sensor begins and ends later than the other by the same time, as where clocks differ."""
    begin, end = float(magnetometer[0] - gyroscope[0]), float(magnetometer[-1] - gyroscope[-1])
    if min(abs(begin), abs(end)) <= _APART or abs(begin - end) > _APART:
        return ()
    sensors = {"magnetometer": magnetometer, "gyroscope": gyroscope}
    spans = (f"{name} {time[0]:.1f} to {time[-1]:.1f} s" for name, time in sensors.items())
    both = min(magnetometer[-1], gyroscope[-1]) - max(magnetometer[0], gyroscope[0])
    return (
        f"{CLOCKS_APART} {min(abs(begin), abs(end)):.0f} s apart ({', '.join(spans)}, both {both:.1f} s); if their "
        "clocks differ, use the times of recording, if the log has them (stamps='log')",
    )


def _stream(name: str, stream: Any, width: int | None, clock: _Clock) -> tuple[Array, Array]:
    """Return time (n,) s and value (n, width) of a stream, checked; any number of columns if `width` is None."""
    time, value = _pair(name, stream)
    if is_calendar(time) != clock.calendar:
        kinds_of_stamps = ("numbers", "calendar stamps")
        raise MagycError(
            f"time of {name}: must be {kinds_of_stamps[clock.calendar]} as the magnetometer's, got "
            f"{kinds_of_stamps[not clock.calendar]}, whose offset is unknown; give all sensors the stamps of one clock"
        )
    clean_time = frozen(f"time of {name}", seconds(f"time of {name}", time, clock.origin), (None,))
    if len(clean_time) < 2:
        raise MagycError(f"{name}: {counted(len(clean_time), 'sample')}, at least 2 are needed")
    try:
        check_ascending(clean_time)
    except MagycError as error:
        raise MagycError(f"{name}: {error}") from None
    n = len(clean_time)
    return clean_time, frozen(name, value, (n, ...) if width is None else (n, width))


def interpolated(at: Array, time: Array, value: Array, outside: float | None = None) -> Array:
    """Return columns (n, ...) at other times, linearly interpolated.

    Beyond the stamps they hold the first and last value, or take `outside`.
    """
    result = np.empty((len(at), *value.shape[1:]))
    for to, column in zip(result.reshape(len(at), -1).T, value.reshape(len(time), -1).T, strict=True):
        to[:] = np.interp(at, time, column, left=outside, right=outside)
    return result


def _on_rows(at: Array, time: Array, value: Array, outside: float | None = None) -> Array:
    return value if np.array_equal(at, time) else given_away(interpolated(at, time, value, outside))


def _slerp(at: Array, time: Array, quaternion: Array) -> Array:
    """Interpolate quaternions (n, 4) along the shorter arc; NaN outside the stamps and inside their holes."""
    result = np.full((len(at), 4), np.nan)
    inside = (at >= time[0]) & (at <= time[-1])
    # There is no reference inside a hole of its stamps.
    step = np.diff(time)
    left = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(step) - 1)
    inside &= (step[left] <= max(10 * float(np.median(step)), 0.1)) | np.isin(at, time)
    # Spherical linear interpolation (Shoemake 1985).
    left = np.clip(np.searchsorted(time, at[inside], side="right") - 1, 0, len(time) - 2)
    q = unit_quaternions(quaternion)
    first, second = q[left], q[left + 1]
    cosine = np.einsum("ni,ni->n", first, second)[:, None]
    second = np.where(cosine < 0, -second, second)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    share = ((at[inside] - time[left]) / (time[left + 1] - time[left]))[:, None]
    small = angle < 1e-6  # the sines cancel there
    sine = np.where(small, 1.0, np.sin(angle))
    weight = np.where(small, 1 - share, np.sin((1 - share) * angle) / sine)
    other = np.where(small, share, np.sin(share * angle) / sine)
    result[inside] = unit_quaternions(weight * first + other * second)
    return result
