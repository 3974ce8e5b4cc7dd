"""Assembly of a `Recording` from the samples of each sensor, with integer stamps in nanoseconds as in the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import counted, first_of
from magyc_gtsam.io.request import SENSORS, Request
from magyc_gtsam.io.units import is_counts
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.autopilot import Autopilot
from magyc_gtsam.recording.checks import FIELD_RANGE, given_away, impossible_rates
from magyc_gtsam.recording.time_zero import time_zero_note

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_SECOND = 1_000_000_000  # ns
_ABSENT = 0.05  # share of finite numbers below which an axis is absent; two alternating sensors leave half
_MOST_INVALID = 0.5  # largest share of samples that can be left out as invalid
_LONGEST_PAUSE = 30 * 86400 * _SECOND  # a longer one is a clock without a battery, set to the date while recording
_REPEATED = (
    "use the times of recording if the format has them (stamps='log'), or name one source if two publish on "
    "one topic"
)


@dataclass(frozen=True, eq=False)
class Stream:
    """Samples of one sensor in the order of the file.

    Attributes:
        name: its name in the log (topic, columns, message).
        stamp: (n,) int64, ns.
        value: (n,) or (n, k), SI units.
    """

    name: str
    stamp: Stamps
    value: Array

    def rows(self, rows: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Stream:
        """Return the stream reduced to the given rows."""
        return replace(self, stamp=self.stamp[rows], value=self.value[rows])


def assemble(
    sensors: Mapping[str, Stream],
    channels: Mapping[str, Stream],
    request: Request,
    *,
    name: str,
    notes: tuple[str, ...] = (),
    angular_rate_is: Literal["instant", "interval-mean"] = "instant",
    attitude_is: Literal["independent", "estimate"] = "independent",
    autopilot: Autopilot | None = None,
    repeated: str = _REPEATED,
) -> Recording:
    """Combine streams into one `Recording`; time 0 is the first row of the log.

    Args:
        sensors: "magnetic_field" and optionally "angular_rate", "acceleration", "attitude" (x, y, z, w).
        channels: further streams by name; an unusable one is left out with a note.
        request: for the interval, and for the sensors and units that the caller named.
        name, notes, angular_rate_is, attitude_is, autopilot: of the recording.
        repeated: the remedy if stamps occur twice with different values.

    Raises:
        MagycError: an axis is absent, a clock was set, one stamp has two values, or the streams do not make a valid
            `Recording`.
    """
    remarks = list(notes)
    sensors = {k: _without_spikes(s, remarks) for k, s in sensors.items()}
    main = [
        sensors[k].stamp[0] for k in ("magnetic_field", "angular_rate") if k in sensors and len(sensors[k].stamp)
    ]
    start, end = request.start, request.end
    jumped = any(len(_restarts(s.stamp)) > 0 for s in sensors.values())
    if jumped and (start is not None or end is not None):
        # The stamps are ambiguous, so the interval is measured in the time elapsed along the file.
        sensors = {k: _part(s, max(main), start, end) for k, s in sensors.items()}
        channels = {k: _part(s, max(main), start, end) for k, s in channels.items()}
        start = end = None
    few = [k for k, s in sensors.items() if k in ("acceleration", "attitude") and len(s.stamp) < 2]
    remarks.extend(f"{k} left out: {sensors[k].name} has {len(sensors[k].stamp)} samples" for k in few)
    counts = is_counts("magnetic_field", request.units.get("magnetic_field"))
    clean, usable = {}, {}
    for sensor, stream in sensors.items():
        try:
            if sensor not in few:
                clean[sensor] = _clean(stream, sensor, remarks, repeated, in_tesla=not counts)
        except MagycError as error:
            if sensor in ("magnetic_field", "angular_rate") or request.sensors.get(sensor):
                raise
            remarks.append(f"{sensor} left out: {error}")
    for channel, stream in channels.items():
        try:
            usable[channel] = _clean(stream, channel, remarks, repeated)
        except MagycError as error:
            remarks.append(f"channel left out: {error}")
    zero = max(int(clean[k].stamp[0]) for k in ("magnetic_field", "angular_rate") if k in clean)

    clocks: list[tuple[Stamps, Array]] = []  # sensors with equal stamps share one array of times

    def relative(stream: Stream) -> tuple[Array, Array]:
        time = next((time for stamp, time in clocks if np.array_equal(stamp, stream.stamp)), None)
        if time is None:
            time = given_away((stream.stamp - zero) / 1e9)
            clocks.append((stream.stamp, time))
        return time, given_away(stream.value)

    last = min(int(clean[k].stamp[-1]) for k in ("magnetic_field", "angular_rate") if k in clean)
    for channel in [k for k, s in usable.items() if s.stamp[-1] < zero or s.stamp[0] > last]:
        remarks.append(f"channel left out: {channel} has no sample while the magnetometer was recorded")
        del usable[channel]
    recording = Recording.from_streams(
        relative(clean["magnetic_field"]),
        relative(clean["angular_rate"]) if "angular_rate" in clean else None,
        acceleration=relative(clean["acceleration"]) if "acceleration" in clean else None,
        attitude=relative(clean["attitude"]) if "attitude" in clean else None,
        channels={k: relative(s) for k, s in usable.items()},
        name=name,
        notes=(*first_of(remarks, "notes"), time_zero_note(zero)),
        angular_rate_is=angular_rate_is,
        attitude_is=attitude_is,
        magnetic_field_unit="counts" if counts else "T",
    )
    recording = recording if start is None and end is None else recording.between(start, end)
    return recording if autopilot is None else replace(recording, autopilot=autopilot)


def _clean(stream: Stream, role: str, notes: list[str], repeated: str, in_tesla: bool = True) -> Stream:
    """Return the stream finite, ascending and without duplicates, and note what was changed."""
    stream = _finite(stream, role, notes)
    if role == "magnetic_field":
        stream = _measured(stream, in_tesla, notes)
    if role == "angular_rate" and (damaged := impossible_rates(stream.value)).any():
        count = f"{damaged.sum()} of {len(damaged)} samples"
        notes.append(f"{stream.name}: {count} are beyond what gyroscopes measure and were left out")
        stream = stream.rows(~damaged)
    if len(stream.stamp) < 2:
        raise MagycError(f"{stream.name}: {counted(len(stream.stamp), 'sample')}, at least 2 are needed")
    restarts = _restarts(stream.stamp)
    if len(restarts):
        row = int(restarts[0])
        elapsed = float(_elapsed(stream.stamp)[row])
        step = (int(stream.stamp[row + 1]) - int(stream.stamp[row])) / 1e9
        moved = f"goes back by {-step:.3f} s" if step < 0 else f"jumps ahead by {step / 86400:.0f} days"
        cut = f"{elapsed + 0.5:.1f}"  # in the middle of the second that `_elapsed` puts there
        raise MagycError(
            f"{stream.name}: its clock {moved} after sample {row + 1}, {elapsed:.3f} s "
            f"into the log; read one side of it (end={cut} or start={cut}), or "
            "use the times of recording if the format has them (stamps='log')"
        )
    late = int((np.diff(stream.stamp) < 0).sum())
    if late:
        stream = stream.rows(np.argsort(stream.stamp, kind="stable"))
        notes.append(f"{stream.name}: {counted(late, 'sample')} out of order, sorted by the stamps")
    return _without_repeats(stream, notes, repeated)


def _finite(stream: Stream, role: str, notes: list[str]) -> Stream:
    """Drop the samples that are not finite."""
    finite: NDArray[np.bool_] = np.isfinite(stream.value)
    if finite.all():
        return stream
    finite = finite.reshape(len(finite), -1)
    if role in SENSORS:
        for axis, share in zip("xyz", finite.mean(axis=0), strict=True):
            if share < _ABSENT:
                raise MagycError(
                    f"{stream.name}: axis {axis} is absent (not a number in {1 - share:.0%} of {len(finite)} "
                    "samples); three axes are needed: name another source, or have the driver publish it"
                )
    keep = np.asarray(finite.all(axis=1))
    notes.append(f"{stream.name}: {(~keep).sum()} of {len(keep)} samples are not finite and were left out")
    return stream.rows(keep)


def _measured(stream: Stream, in_tesla: bool, notes: list[str]) -> Stream:
    """Drop the samples that a driver writes in place of a field: zeros, and values beyond any magnetometer's range."""
    limit = FIELD_RANGE if in_tesla else np.inf
    largest = max(stream.value.max(initial=0.0), -stream.value.min(initial=0.0))
    if largest <= limit and not (stream.value == 0).any():
        return stream
    zero: NDArray[np.bool_] = (stream.value == 0).all(axis=1)
    beyond: NDArray[np.bool_] = np.abs(stream.value).max(axis=1) > limit
    for invalid, what in ((zero, "are zero on all axes"), (beyond, f"are beyond {FIELD_RANGE:g} T")):
        # With more invalid samples the unit or the column is wrong, which the checks of `Recording` report.
        if invalid.any() and invalid.mean() < _MOST_INVALID:
            notes.append(f"{stream.name}: {invalid.sum()} of {len(invalid)} samples {what} and were left out")
        else:
            invalid[:] = False
    return stream.rows(~(zero | beyond)) if zero.any() or beyond.any() else stream


def _without_repeats(stream: Stream, notes: list[str], remedy: str) -> Stream:
    """Drop samples that were recorded twice; a MagycError with the remedy if stamps have two values."""
    repeated = np.flatnonzero(np.diff(stream.stamp) == 0)
    if not len(repeated):
        return stream
    value = stream.value.reshape(len(stream.stamp), -1)
    different = repeated[(value[repeated] != value[repeated + 1]).any(axis=1)]
    if len(different):
        row = int(different[0])
        constant = (
            " (all stamps are the same: was the header never filled in?)" if np.ptp(stream.stamp) == 0 else ""
        )
        raise MagycError(
            f"{stream.name}: {len(different)} stamps occur twice with different values{constant}, "
            f"the first at {stream.stamp[row] / 1e9:.9f} s; {remedy}"
        )
    keep = np.ones(len(stream.stamp), dtype=bool)
    keep[repeated + 1] = False
    notes.append(f"{stream.name}: {len(repeated)} samples were recorded twice and were dropped")
    return stream.rows(keep)


def _without_spikes(stream: Stream, notes: list[str]) -> Stream:
    """Drop samples whose stamp is far from both neighbours, while these are close to each other (flipped bits)."""
    if len(stream.stamp) < 3:
        return stream
    step = np.diff(stream.stamp)
    far = (step > _SECOND) | (step < -_SECOND)
    if not far.any():
        return stream
    across = step[1:] + step[:-1]
    isolated = far[:-1] & far[1:] & (across >= 0) & (across < _SECOND)
    if not isolated.any():
        return stream
    notes.append(f"{stream.name}: {isolated.sum()} samples with a stamp far from its neighbours were left out")
    return stream.rows(np.concatenate([[True], ~isolated, [True]]))


def _restarts(stamp: Stamps) -> NDArray[np.intp]:
    """Return the rows after which the clock was set: back by more than 1 s, as shorter steps are messages out of order,
    or ahead by more than any pause of a recording.
    """
    step = np.diff(stamp)
    return np.flatnonzero((step < -_SECOND) | (step > _LONGEST_PAUSE))


def _elapsed(stamp: Stamps) -> Array:
    """Return the time (n,) s since the first sample along the file; where the clock was set it is a second."""
    step = np.diff(stamp)
    step[_restarts(stamp)] = _SECOND
    return np.concatenate([[0.0], np.cumsum(step) / 1e9])


def _part(stream: Stream, origin: int, start: float | None, end: float | None) -> Stream:
    """Return the samples from `start` to `end`, in s elapsed along the file since `origin` (ns)."""
    if not len(stream.stamp):
        return stream
    offset = (int(stream.stamp[0]) - origin) / 1e9
    # The offset to a stream on another clock has no meaning.
    elapsed = _elapsed(stream.stamp) + (offset if abs(offset) < 10 else 0.0)
    first = -np.inf if start is None else start
    last = np.inf if end is None else end
    return stream.rows((elapsed >= first) & (elapsed <= last))
