"""Read ArduPilot dataflash logs (.BIN), with the compass correction undone that ArduPilot had applied."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.ardupilot_compass import undo
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Recording

Array = NDArray[np.float64]

_MILLIGAUSS = 1e-7  # T
_AXES = {
    "magnetic_field": ("MAG", ("MagX", "MagY", "MagZ")),
    "angular_rate": ("IMU", ("GyrX", "GyrY", "GyrZ")),
    "acceleration": ("IMU", ("AccX", "AccY", "AccZ")),
}
_COMPASS_FIELDS = ("OfsX", "OfsY", "OfsZ", "MOX", "MOY", "MOZ")
_CHANNELS = ("BAT.Curr", "BAT.Volt", "BARO.Temp", "IMU.T", "CTUN.ThO")
_REPORT_EVERY = 10_000  # messages


@dataclass
class _Samples:
    """The messages of one instance, a row each."""

    time: list[int] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)
    parameters: list[int] = field(default_factory=list)

    def stream(self, name: str, columns: slice | int) -> Stream:
        return Stream(
            name,
            np.array(self.time, dtype=np.int64) * 1000,
            np.array(self.rows, dtype=np.float64)[:, columns],
        )


@dataclass
class _Log:
    """What was read of a log.

    Args:
        samples: by (message, instance).
        fields: the fields of the rows, by message.
        parameters: the sets of parameters that were in force, one after the other.
    """

    samples: dict[tuple[str, int], _Samples]
    fields: dict[str, tuple[str, ...]]
    parameters: list[dict[str, float]]


def read(path: Path, request: Request) -> Recording:
    """As `magyc_gtsam.io.read`, of an ArduPilot log.

    Raises:
        MagycError: pymavlink is not installed, a message is missing, or what was applied cannot be undone.
    """
    request.only("ArduPilot")
    if request.stamps == "log":
        raise MagycError("stamps='log': an ArduPilot log has one clock only")
    asked = tuple(request.channels) if request.channels is not None else _CHANNELS
    if bad := [c for c in asked if "." not in c]:
        raise MagycError(f"channels: {bad[0]!r}; write them as message.field (BAT.Curr), or message[1].field")
    fields: dict[str, tuple[str, ...]] = {"ATT": ("Roll", "Pitch", "Yaw")}
    for name in ("MAG", "MAG2", "MAG3"):
        fields[name] = (*_AXES["magnetic_field"][1], *_COMPASS_FIELDS, "Health")
    for name in ("IMU", "IMU2", "IMU3"):
        fields[name] = (*_AXES["angular_rate"][1], *_AXES["acceleration"][1])
    for channel in asked:
        message, member = channel.split(".", 1)
        kind = message.split("[")[0]
        fields[kind] = tuple(dict.fromkeys((*fields.get(kind, ()), member)))
    log = _load(path, fields, request)
    notes: list[str] = []
    sensors = {"magnetic_field": _magnetometer(log, request, notes)}
    for sensor in ("angular_rate", "acceleration"):
        key = _choose(log, sensor, request, notes if sensor == "angular_rate" else [])
        if key is None:
            notes.append(f"no {sensor}: the log has no IMU messages")
            continue
        columns = _columns(log, key[0], _AXES[sensor][1])
        scale, said = request.scale(sensor)
        notes.extend(said)
        stream = log.samples[key].stream(_label(key), columns)
        sensors[sensor] = Stream(stream.name, stream.stamp, stream.value * scale)
    if "angular_rate" in sensors:
        cutoff = log.parameters[-1].get("INS_GYRO_FILTER")
        delayed = f", and low-pass filtered at {cutoff:g} Hz (INS_GYRO_FILTER)" if cutoff else ""
        notes.append(f"the angular rate is as logged, with INS_GYROFFS_* subtracted in flight{delayed}")
    attitude = _attitude(log, request, notes)
    if attitude is not None:
        sensors["attitude"] = attitude
    return assemble(sensors, _channels(log, asked, request), request, name=path.stem, notes=tuple(notes))


def info(path: Path) -> LogInfo:
    """As `magyc_gtsam.io.info`, of an ArduPilot log; `problem` is left to the caller."""
    reader = _open(path)
    kinds = {
        name: int(reader.counts[number]) for number, name in reader.id_to_name.items() if reader.counts[number]
    }
    timed: dict[str, tuple[str, ...]] = {
        k: () for k in kinds if "TimeUS" in reader.formats[reader.name_to_id[k]].columns
    }
    reader.close()
    log = _load(path, dict(timed), Request())
    sensors = [s for k, s in log.samples.items() if k[0] in ("MAG", "IMU")]
    times = [t for s in sensors for t in (s.time[0], s.time[-1])]
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
            len(s.time),
            ((s.time[0] - first) / 1e6, (s.time[-1] - first) / 1e6),
            serves.get(k[0], ()),
        )
        for k, s in log.samples.items()
    )
    return LogInfo(str(path), "ArduPilot dataflash", (last - first) / 1e6, sources)


def _open(path: Path) -> Any:
    try:
        from pymavlink.DFReader import DFReader_binary
    except ImportError:
        raise MagycError(
            f"{path}: ArduPilot logs need pymavlink; install it with: pip install 'magyc-gtsam[ardupilot]'"
        ) from None
    # Time as the autopilot counts it: pymavlink's other clocks start at the first GPS fix.
    return DFReader_binary(str(path), zero_time_base=True)


def _load(path: Path, fields: dict[str, tuple[str, ...]], request: Request) -> _Log:
    reader = _open(path)
    present = {k: v for k, v in fields.items() if k in reader.name_to_id}
    for kind, members in present.items():
        known = reader.formats[reader.name_to_id[kind]].columns
        present[kind] = tuple(m for m in members if m in known)
    instances: dict[str, str] = {}
    for kind in present:
        form = reader.formats[reader.name_to_id[kind]]
        # Logs without units do not mark the field; in other messages than these "I" is an integral.
        marked = form.instance_field or ("I" if "I" in form.columns and kind in ("MAG", "IMU", "BARO") else None)
        instances |= {kind: marked} if marked else {}
    samples: dict[tuple[str, int], _Samples] = defaultdict(_Samples)
    parameters: list[dict[str, float]] = [{}]
    in_use = False
    count = 0
    while (message := reader.recv_match(type=[*present, "PARM"], strict=True)) is not None:
        kind = message.get_type()
        count += 1
        if count % _REPORT_EVERY == 0:
            request.report(reader.percent / 100)
        if kind == "PARM":
            name, value = message.Name, float(message.Value)
            if name not in parameters[-1]:
                # Parameters are written while sensors already are: the first value held from the start.
                for known_set in parameters:
                    known_set[name] = value
            elif parameters[-1][name] != value:
                if in_use:
                    parameters.append(dict(parameters[-1]))
                    in_use = False
                parameters[-1][name] = value
        if kind not in present:
            continue
        members = present[kind]
        in_use |= kind.startswith("MAG")
        instance = int(getattr(message, instances[kind])) if kind in instances else 0
        if kind[-1:] in ("2", "3") and kind[:-1] in ("MAG", "IMU"):
            kind, instance = kind[:-1], int(kind[-1]) - 1
        rows = samples[kind, instance]
        rows.time.append(int(message.TimeUS))
        rows.rows.append(tuple(getattr(message, m) for m in members))
        rows.parameters.append(len(parameters) - 1)
    reader.close()
    request.report(1.0)
    return _Log(dict(samples), present, parameters)


def _label(key: tuple[str, int]) -> str:
    return f"{key[0]}[{key[1]}]"


def _columns(log: _Log, kind: str, names: tuple[str, ...]) -> slice:
    """The place of consecutive fields in the rows of a message."""
    members = log.fields[kind]
    if any(n not in members for n in names):
        raise MagycError(f"{kind}: has no {', '.join(n for n in names if n not in members)} in this log")
    first = members.index(names[0])
    return slice(first, first + len(names))


def _choose(log: _Log, sensor: str, request: Request, notes: list[str]) -> tuple[str, int] | None:
    kind = _AXES[sensor][0]
    found = sorted(k for k in log.samples if k[0] == kind)
    listed = ", ".join(f"{_label(k)} ({len(log.samples[k].time)} samples)" for k in found)
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
    stream = samples.stream(_label(key), _columns(log, "MAG", _AXES["magnetic_field"][1]))
    corrections = samples.stream(_label(key), _columns(log, "MAG", _COMPASS_FIELDS)).value
    raw, said = undo(
        stream.value,
        corrections[:, :3],
        corrections[:, 3:],
        np.array(samples.parameters),
        log.parameters,
        key[1],
    )
    notes.extend(said)
    scale, asked = request.scale("magnetic_field", _MILLIGAUSS)
    notes.extend(asked)
    stream = Stream(stream.name, stream.stamp, raw * scale)
    if "Health" in log.fields.get("MAG", ()):
        healthy = samples.stream("", log.fields["MAG"].index("Health")).value != 0
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
    stream = log.samples["ATT", 0].stream("ATT", slice(0, 3))
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
        kind = message.split("[")[0]
        found = [k for k in sorted(log.samples) if message in (k[0], _label(k))]
        if found and member in log.fields.get(kind, ()) and len(log.samples[found[0]].time) > 1:
            result[channel] = log.samples[found[0]].stream(channel, log.fields[kind].index(member))
        elif request.channels is not None:
            raise MagycError(f"channels: the log has no {channel!r}; write them as message.field")
    return result
