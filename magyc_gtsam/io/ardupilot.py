"""Read ArduPilot dataflash logs (.BIN), with the compass correction undone that ArduPilot had applied."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import dataflash
from magyc_gtsam.io.ardupilot_compass import undo
from magyc_gtsam.io.dataflash import Dataflash
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Recording

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_MILLIGAUSS = 1e-7  # T
_AXES = {
    "magnetic_field": ("MAG", ("MagX", "MagY", "MagZ")),
    "angular_rate": ("IMU", ("GyrX", "GyrY", "GyrZ")),
    "acceleration": ("IMU", ("AccX", "AccY", "AccZ")),
}
_OFFSETS = (("OfsX", "OfsY", "OfsZ"),)
_MOTORS = (("MOX", "MOY", "MOZ"), ("MOfsX", "MOfsY", "MOfsZ"))  # the latter until 3.6
_CHANNELS = ("BAT.Curr", "BAT.Volt", "BARO.Temp", "IMU.T", "CTUN.ThO")


@dataclass(frozen=True, eq=False)
class _Samples:
    """The messages of one instance: their stamps (n,) ns, columns, and the set of parameters in force."""

    name: str
    stamp: Stamps
    columns: dict[str, Array]
    parameters: NDArray[np.int64]

    def stream(self, *columns: str) -> Stream:
        """Of some columns, (n, k).

        Raises:
            MagycError: the messages have no such column.
        """
        if missing := [c for c in columns if c not in self.columns]:
            raise MagycError(f"{self.name}: has no {', '.join(missing)} in this log")
        return Stream(self.name, self.stamp, np.column_stack([self.columns[c] for c in columns]))

    def first_of(self, *choices: tuple[str, ...]) -> Array:
        """(n, 3) of the first choice of columns that the messages have."""
        found = next((c for c in choices if all(name in self.columns for name in c)), choices[0])
        return self.stream(*found).value


@dataclass
class _Log:
    """What was read of a log.

    Args:
        samples: by (message, instance).
        parameters: the sets of parameters that were in force, one after the other.
        notes: what is wrong with the log.
    """

    samples: dict[tuple[str, int], _Samples]
    parameters: list[dict[str, float]]
    notes: tuple[str, ...]


def read(path: Path, request: Request) -> Recording:
    """As `magyc_gtsam.io.read`, of an ArduPilot log.

    Raises:
        MagycError: a message is missing, or what was applied cannot be undone.
    """
    request.only("ArduPilot")
    if request.stamps == "log":
        raise MagycError("stamps='log': an ArduPilot log has one clock only")
    asked = tuple(request.channels) if request.channels is not None else _CHANNELS
    if bad := [c for c in asked if "." not in c]:
        raise MagycError(f"channels: {bad[0]!r}; write them as message.field (BAT.Curr), or message[1].field")
    fields: dict[str, tuple[str, ...]] = {"ATT": ("Roll", "Pitch", "Yaw")}
    for name in ("MAG", "MAG2", "MAG3"):
        fields[name] = (*_AXES["magnetic_field"][1], *sum((*_OFFSETS, *_MOTORS), ()), "Health")
    for name in ("IMU", "IMU2", "IMU3"):
        fields[name] = (*_AXES["angular_rate"][1], *_AXES["acceleration"][1])
    for channel in asked:
        message, member = channel.split(".", 1)
        kind = message.split("[")[0]
        fields[kind] = tuple(dict.fromkeys((*fields.get(kind, ()), member)))
    log = _load(path, fields, request)
    notes = list(log.notes)
    sensors = {"magnetic_field": _magnetometer(log, request, notes)}
    for sensor in ("angular_rate", "acceleration"):
        key = _choose(log, sensor, request, notes if sensor == "angular_rate" else [])
        if key is None:
            notes.append(f"no {sensor}: the log has no IMU messages")
            continue
        scale, said = request.scale(sensor)
        notes.extend(said)
        stream = log.samples[key].stream(*_AXES[sensor][1])
        sensors[sensor] = Stream(stream.name, stream.stamp, stream.value * scale)
    if "angular_rate" in sensors:
        cutoff = log.parameters[-1].get("INS_GYRO_FILTER")
        delayed = f", and low-pass filtered at {cutoff:g} Hz (INS_GYRO_FILTER)" if cutoff else ""
        notes.append(f"the angular rate is as logged, with INS_GYROFFS_* subtracted in flight{delayed}")
    attitude = _attitude(log, request, notes)
    if attitude is not None:
        sensors["attitude"] = attitude
    return assemble(
        sensors,
        _channels(log, asked, request),
        request,
        name=path.stem,
        notes=tuple(notes),
        attitude_is="estimate",
    )


def info(path: Path) -> LogInfo:
    """As `magyc_gtsam.io.info`, of an ArduPilot log; `problem` is left to the caller."""
    log = _load(path, None, Request())
    sensors = [s for k, s in log.samples.items() if k[0] in ("MAG", "IMU")]
    times = [t for s in sensors for t in (int(s.stamp[0]), int(s.stamp[-1]))]
    first, last = min(times, default=0), max(times, default=0)
    serves: dict[str, tuple[str, ...]] = {"ATT": ("attitude",)}
    for sensor, (kind, _) in _AXES.items():
        for name in (kind, f"{kind}2", f"{kind}3"):
            serves[name] = (*serves.get(name, ()), sensor)
    for channel in _CHANNELS:
        kind = channel.split(".")[0]
        serves[kind] = tuple(dict.fromkeys((*serves.get(kind, ()), "channel")))
    sources = tuple(
        Source(
            _label(k),
            k[0],
            len(s.stamp),
            ((int(s.stamp[0]) - first) / 1e9, (int(s.stamp[-1]) - first) / 1e9),
            serves.get(k[0], ()),
        )
        for k, s in log.samples.items()
    )
    return LogInfo(str(path), "ArduPilot dataflash", (last - first) / 1e9, sources, log.notes)


def _load(path: Path, fields: dict[str, tuple[str, ...]] | None, request: Request) -> _Log:
    """The messages named, with these columns; None for all that have a time, without columns."""
    log = dataflash.load(path)
    request.report(0.3)
    try:
        return _loaded(log, fields, request)
    finally:
        log.close()


def _loaded(log: Dataflash, fields: dict[str, tuple[str, ...]] | None, request: Request) -> _Log:
    notes = []
    if log.skipped:
        notes.append(f"the log is damaged: {log.skipped} bytes are no messages and were left out")
    if fields is None:
        fields = dict.fromkeys(log.kinds, ())
    present = [k for k in fields if k in log.kinds and log.kinds[k].time and log.kinds[k].fields is not None]
    notes += [
        f"{kind} left out: its format does not fit the length of its messages"
        for kind in fields
        if kind in log.kinds and log.kinds[kind].fields is None
    ]
    used = np.sort(np.concatenate([log.places(k) for k in present if k.startswith("MAG")] or [np.empty(0, int)]))
    parameters, changes = _parameters(log, used)
    samples: dict[tuple[str, int], _Samples] = {}
    impossible = 0
    for done, kind in enumerate(present):
        known = log.kinds[kind]
        # Logs without units do not mark the field; in other messages than these "I" is an integral.
        marked = known.instance or ("I" if "I" in known.columns and kind in ("MAG", "IMU", "BARO") else None)
        marked = marked if marked and known.holds(marked, "numbers") else None  # instances by name are no sensors
        places = log.places(kind)
        stamp, possible = log.stamps(kind, places)
        impossible += int((~possible).sum())
        places, stamp = places[possible], stamp[possible]
        instances = log.column(kind, marked, places) if marked else np.zeros(len(places), dtype=np.int64)
        name, shift = (
            (kind[:-1], int(kind[-1]) - 1) if kind[:-1] in ("MAG", "IMU") and kind[-1] in "23" else (kind, 0)
        )
        for instance in np.unique(instances).tolist():
            if not -1 < instance < 256:
                continue
            rows = instances == instance
            key = (name, int(instance) + shift)
            at = places[rows]
            columns = {
                c: log.column(kind, c, at).astype(np.float64) for c in fields[kind] if known.holds(c, "numbers")
            }
            if key not in samples:
                samples[key] = _Samples(_label(key), stamp[rows], columns, np.searchsorted(changes, at))
        request.report(0.3 + 0.7 * (done + 1) / len(present))
    if impossible:
        notes.append(f"{impossible} messages have impossible times and were left out")
    return _Log(samples, parameters, tuple(notes))


def _parameters(log: Dataflash, used: Stamps) -> tuple[list[dict[str, float]], Stamps]:
    """The sets of parameters, and where in the file each but the first begins.

    Args:
        log: its PARM messages.
        used: places of the messages that parameters matter to; one that changes between two of them begins a new set.
    """
    sets: list[dict[str, float]] = [{}]
    changes: list[int] = []
    known = log.kinds.get("PARM")
    if known is None or not (known.holds("Name", "text") and known.holds("Value", "numbers")):
        return sets, np.empty(0, dtype=np.int64)
    names, values = dataflash.names(log.column("PARM", "Name").tolist()), log.column("PARM", "Value").tolist()
    for place, name, value in zip(log.places("PARM").tolist(), names, values, strict=True):
        value = float(value)
        if name not in sets[-1]:
            # Parameters are written while sensors already are: the first value held from the start.
            for one in sets:
                one[name] = value
        elif sets[-1][name] != value:
            since, until = np.searchsorted(used, [changes[-1] if changes else -1, place])
            if until > since:
                sets.append(dict(sets[-1]))
                changes.append(place)
            sets[-1][name] = value
    return sets, np.array(changes, dtype=np.int64)


def _label(key: tuple[str, int]) -> str:
    return f"{key[0]}[{key[1]}]"


def _choose(log: _Log, sensor: str, request: Request, notes: list[str]) -> tuple[str, int] | None:
    kind = _AXES[sensor][0]
    found = sorted(k for k in log.samples if k[0] == kind)
    listed = ", ".join(f"{_label(k)} ({len(log.samples[k].stamp)} samples)" for k in found)
    named = request.named(sensor)
    if named is not None:
        wanted = [k for k in found if named in (_label(k), f"{kind}{k[1] + 1}") or (named == kind and k[1] == 0)]
        if not wanted:
            raise MagycError(f"{sensor}: no message {named!r}; the log has {listed or 'none'}")
        return wanted[0]
    if len(found) > 1:
        notes.append(
            f"{sensor} is from {_label(found[0])}, the first of {listed}; another can be named ({sensor}=)"
        )
    return found[0] if found else None


def _magnetometer(log: _Log, request: Request, notes: list[str]) -> Stream:
    key = _choose(log, "magnetic_field", request, notes)
    if key is None:
        raise MagycError(
            "the log has no MAG messages; have ArduPilot log the compass (LOG_BITMASK, bit 'Compass')"
        )
    samples = log.samples[key]
    stream = samples.stream(*_AXES["magnetic_field"][1])
    raw, said = undo(
        stream.value,
        samples.first_of(*_OFFSETS),
        samples.first_of(*_MOTORS),
        samples.parameters,
        log.parameters,
        key[1],
    )
    notes.extend(said)
    scale, asked = request.scale("magnetic_field", _MILLIGAUSS)
    notes.extend(asked)
    stream = Stream(stream.name, stream.stamp, raw * scale)
    if "Health" in samples.columns:
        healthy = samples.columns["Health"] != 0
        if not healthy.all():
            notes.append(
                f"{stream.name}: {(~healthy).sum()} of {len(healthy)} samples are unhealthy and were left out"
            )
            stream = stream.rows(healthy)
    return stream


def _attitude(log: _Log, request: Request, notes: list[str]) -> Stream | None:
    named = request.named("attitude")
    if named not in (None, "ATT"):
        raise MagycError(f"attitude: {named!r} cannot be read; ATT can")
    if ("ATT", 0) not in log.samples:
        if named:
            raise MagycError("attitude: the log has no ATT messages")
        return None
    stream = log.samples["ATT", 0].stream("Roll", "Pitch", "Yaw")
    quaternion = Rotation.from_euler("ZYX", stream.value[:, ::-1], degrees=True).as_quat()
    trim = [log.parameters[-1].get(f"AHRS_TRIM_{axis}", 0.0) for axis in "XY"]
    turned = f", turned by AHRS_TRIM ({', '.join(f'{np.degrees(t):.1f}°' for t in trim)})" if any(trim) else ""
    notes.append(
        f"attitude is ATT, vehicle (forward, right, down) to north, east, down{turned}; ArduPilot's own "
        "estimate, which the compass took part in"
    )
    return Stream("ATT", stream.stamp, quaternion)


def _channels(log: _Log, asked: tuple[str, ...], request: Request) -> dict[str, Stream]:
    result = {}
    for channel in asked:
        message, member = channel.split(".", 1)
        found = [k for k in sorted(log.samples) if message in (k[0], _label(k))]
        samples = log.samples[found[0]] if found else None
        if samples is not None and member in samples.columns and len(samples.stamp) > 1:
            result[channel] = Stream(channel, samples.stamp, samples.columns[member])
        elif request.channels is not None:
            raise MagycError(f"channels: the log has no {channel!r}; write them as message.field")
    return result
